//! The key figures, the settings, and the time of each stage.
//!
//! In: a [`Report`]. Out: HTML. Cost: none.

use crate::align::{Model, Status};
use crate::draw::markup::file_name;
use crate::merge::local::LocalReport;
use crate::page::markup::{escape, percent, signed};
use crate::report::Report;
use serde_json::Value;
use std::fmt::Write;

/// Returns the key figures: frames, dynamic range, motion, error, size, time.
pub(in crate::page) fn facts(report: &Report) -> String {
    let count = |status| report.frames.iter().filter(|f| f.alignment.status == status).count();
    let aligned = count(Status::Aligned);
    let words = [
        (aligned, "aligned"),
        (count(Status::Unmoved), "unmoved"),
        (count(Status::Assumed), "position assumed"),
        (count(Status::Rejected), "rejected"),
        (count(Status::Excluded) + count(Status::Flash), "excluded"),
    ];
    let became: Vec<String> = words.iter().filter(|(n, _)| *n > 0).map(|(n, word)| format!("{n} {word}")).collect();
    let mut facts = vec![("Frames", report.frames.len().to_string(), became.join(", "))];
    if let Some(stops) = report.radiance.as_ref().and_then(|merged| merged.range_stops) {
        let range = format!("{stops:.1} stops");
        facts.push(("Dynamic range", range, "of the result, between the noise floor and clipping".into()));
    }
    let shift = |f: &crate::report::FrameReport| f.alignment.shift_px.map_or(0.0, |[x, y]| (x * x + y * y).sqrt());
    let most = report.frames.iter().map(shift).fold(0.0, f64::max);
    let turned = report.frames.iter().filter_map(|f| f.alignment.rotation_deg).map(f64::abs).fold(0.0, f64::max);
    if aligned > 0 {
        let turn = if turned >= 0.005 { format!("and a rotation of {turned:.2}°") } else { "no rotation".to_owned() };
        facts.push(("Largest motion", format!("{most:.1} px"), turn));
    }
    let errors = report.frames.iter().filter(|f| f.alignment.status != Status::Reference);
    if let Some(worst) = errors.filter_map(|f| f.alignment.error_px).reduce(f64::max) {
        facts.push(("Alignment error", format!("{worst:.2} px"), "estimated, in the worst frame".into()));
    }
    if let Some((least, most)) = report.local_processing.as_ref().and_then(LocalReport::range_stops) {
        let range = format!("{} to {} stops", signed(least, 1), signed(most, 1));
        facts.push(("Local gain", range, "in frames that the camera tone-mapped".into()));
    }
    let crop = &report.crop;
    facts.push(("Result", format!("{} × {}", crop.width_px, crop.height_px), "pixels".into()));
    facts.push(("Time", format!("{:.1} s", report.time_s.total), "for all stages".into()));
    let item = |(name, value, note): &(&str, String, String)| {
        format!("<div><dt>{name}</dt><dd><b>{}</b><span>{}</span></dd></div>\n", escape(value), escape(note))
    };
    format!("<dl class=\"facts\">\n{}</dl>\n", facts.iter().map(item).collect::<String>())
}

/// Returns the files written, and the settings.
pub(in crate::page) fn settings(report: &Report) -> String {
    let mut out = String::new();
    if !report.outputs.is_empty() {
        let item = |path: &String| format!("<li><code>{}</code></li>\n", escape(path));
        let items: String = report.outputs.iter().map(item).collect();
        out += &format!("<h3>Files written</h3>\n<ul class=\"files\">\n{items}</ul>\n");
    }
    out += "<h3>Settings</h3>\n<dl class=\"numbers\">\n";
    let mut rows: Vec<_> = options(report).into_iter().map(|(name, value)| (named(&name), value)).collect();
    // The parameters of the tone mapping operator are sorted behind its name.
    rows.sort_by_key(|((at, words, option), ..)| (*at, *option == "--tmo-set", words.clone()));
    for ((_, words, option), value) in rows {
        let option = if option.is_empty() { String::new() } else { format!(" <code>{option}</code>") };
        let _ = writeln!(out, "<div><dt>{}{option}</dt><dd>{}</dd></div>", escape(&words), escape(&value));
    }
    out + "</dl>\n"
}

/// Options: key in the report, name on the page, spelling on the command line.
const NAMES: [(&str, &str, &str); 24] = [
    ("reference", "Reference frame", "--reference"),
    ("operator, name", "Tone mapping", "--tmo"),
    ("adjust, white balance", "White balance", "--white-balance"),
    ("white", "White point", ""),
    ("adjust, brightness", "Brightness, EV", "--brightness"),
    ("adjust, contrast", "Contrast", "--contrast"),
    ("adjust, saturation", "Saturation", "--saturation"),
    ("adjust, shadows", "Shadows", "--shadows"),
    ("adjust, highlights", "Highlights", "--highlights"),
    ("crop", "Crop", "--crop"),
    ("resize", "Picture size", "--resize"),
    ("bit depth", "Picture bit depth", "--bit-depth"),
    ("picture colour", "Picture colour space", "--picture-colour"),
    ("deghost strength", "Removal of movement, strength", "--deghost"),
    ("align", "Alignment", "--align"),
    ("transforms from", "Alignment read from", "--transforms"),
    ("exposures", "Exposures", "--exposures"),
    ("response model", "Camera response", "--response-model"),
    ("response file", "Camera response file", "--response"),
    ("flare", "Lens flare removal", "--flare"),
    ("colour", "Colour space", "--colour"),
    ("weight", "Weighting function", "--weight"),
    ("max rotation deg", "Largest rotation, degrees", "--max-rotation"),
    ("robust", "Robust estimator for feature matches", "--robust"),
];

/// Returns the position in the list, the name on the page and the command line option for the report key `name`.
fn named(name: &str) -> (usize, String, &'static str) {
    let known = NAMES.iter().position(|(key, ..)| *key == name);
    match (known, name.strip_prefix("operator, ")) {
        (Some(at), _) => (at, NAMES[at].1.to_owned(), NAMES[at].2),
        // A parameter of the tone mapping operator gets the position of the operator's name in `NAMES`, which is 1.
        (None, Some(key)) => (1, format!("Tone mapping, {key}"), "--tmo-set"),
        (None, None) => (NAMES.len(), name.to_owned(), ""),
    }
}

/// Returns a table with the time of each stage; `page_s` is the time for this page in seconds.
pub(in crate::page) fn times(report: &Report, page_s: f64) -> String {
    let mut out = String::from("<table class=\"times\">\n");
    let times = &report.time_s;
    let stages = [
        ("Load", times.load),
        ("Align", times.align),
        ("Response", times.response),
        ("Merge", times.merge),
        ("Tone-map", times.tonemap),
        ("Write", times.write),
        ("This page", Some(page_s)),
        ("Total", Some(times.total)),
    ];
    for (name, time) in stages.iter().filter_map(|(n, t)| t.map(|t| (n, t))) {
        let share = (100.0 * time / times.total.max(1e-9)).min(100.0);
        let _ = writeln!(
            out,
            "<tr><th scope=\"row\">{name}</th><td class=\"n\">{time:.2} s</td><td class=\"bar\"><i \
             style=\"width:{share:.1}%\"></i></td></tr>"
        );
    }
    out + "</table>\n"
}

/// Returns the reference frame, every option with its value as in the report, and the measured settings.
fn options(report: &Report) -> Vec<(String, String)> {
    let mut rows = vec![("reference".to_owned(), file_name(&report.reference))];
    rows.extend(report.transforms_from.iter().map(|path| ("transforms from".to_owned(), path.clone())));
    let all = report.options.as_ref().and_then(|options| serde_json::to_value(options).ok());
    flatten("", all.as_ref().unwrap_or(&Value::Null), &mut rows);
    rows.extend(report.white_balance.map(|light| ("white".to_owned(), light.to_string())));
    if let Some(calibration) = &report.calibration {
        rows.push(("Luminance of relative radiance 1, cd/m²".into(), format!("{:.4}", calibration.cd_m2_per_unit)));
    }
    if let Some(flare) = &report.flare {
        rows.push(("Flare found".into(), percent(flare.scattered_fraction).replace("&lt;", "<")));
    }
    rows
}

/// Appends `value` to `rows` as pairs of name and text; options that are not set (null) are skipped.
fn flatten(name: &str, value: &Value, rows: &mut Vec<(String, String)>) {
    let words = match value {
        Value::Null => return,
        Value::Object(fields) => {
            for (key, value) in fields {
                let key = key.replace('_', " ");
                flatten(&if name.is_empty() { key } else { format!("{name}, {key}") }, value, rows);
            }
            return;
        }
        Value::Bool(yes) => if *yes { "yes" } else { "no" }.to_owned(),
        Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    rows.push((name.to_owned(), words));
}

/// Describes the motion of a frame in a few words.
pub(in crate::page) fn motion(frame: &crate::report::FrameReport) -> String {
    let place = &frame.alignment;
    match (place.status, place.shift_px, place.rotation_deg) {
        (Status::Reference, ..) => "the other frames are aligned to it".into(),
        (Status::Unmoved, ..) => "none: same position as the reference".into(),
        (Status::Assumed, ..) if place.model == Some(Model::Unmoved) => {
            "assumed: same position as the reference".into()
        }
        (Status::Rejected, ..) => "could not be aligned".into(),
        (Status::Excluded, ..) => "excluded by the user".into(),
        (Status::Flash, ..) => "excluded: the flash fired".into(),
        (status, Some([dx, dy]), Some(angle)) => {
            let assumed = if status == Status::Assumed { "assumed: " } else { "" };
            format!("{assumed}{}, {} px; {}°", signed(dx, 1), signed(dy, 1), signed(angle, 2))
        }
        (Status::Aligned | Status::Assumed, ..) => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_rows_and_unset_ones_are_omitted() {
        let value =
            serde_json::json!({"align": "auto", "operator": {"name": "x", "key": 0.18, "white": null}, "flare": false});
        let mut rows = Vec::new();
        flatten("", &value, &mut rows);
        let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
        rows.sort();
        assert_eq!(
            rows,
            [pair("align", "auto"), pair("flare", "no"), pair("operator, key", "0.18"), pair("operator, name", "x")]
        );
    }
}
