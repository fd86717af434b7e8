//! The summary: the numbers that matter, what the user should know, and how the run went.
//!
//! In: a [`Report`]. Out: HTML. Cost: none.

use super::markup::{escape, percent, signed};
use crate::align::{Model, Status};
use crate::inspect::text::file_name;
use crate::merge::local::LocalReport;
use crate::report::Report;
use serde_json::Value;
use std::fmt::Write;

/// The numbers that matter.
pub(super) fn facts(report: &Report) -> String {
    let count = |status| report.frames.iter().filter(|f| f.alignment.status == status).count();
    let aligned = count(Status::Aligned);
    let words = [
        (aligned, "moved and aligned"),
        (count(Status::Unmoved), "unmoved"),
        (count(Status::Assumed), "assumed"),
        (count(Status::Rejected), "left out"),
        (count(Status::Excluded) + count(Status::Flash), "excluded"),
    ];
    let became: Vec<String> = words.iter().filter(|(n, _)| *n > 0).map(|(n, word)| format!("{n} {word}")).collect();
    let mut facts = vec![("Frames", report.frames.len().to_string(), became.join(", "))];
    if let Some(stops) = report.radiance.as_ref().and_then(|merged| merged.range_stops) {
        let range = format!("{stops:.1} stops");
        facts.push(("Dynamic range", range, "of the scene, above the noise and below clipping".into()));
    }
    let shift = |f: &crate::report::FrameReport| f.alignment.shift_px.map_or(0.0, |[x, y]| (x * x + y * y).sqrt());
    let most = report.frames.iter().map(shift).fold(0.0, f64::max);
    let turned = report.frames.iter().filter_map(|f| f.alignment.rotation_deg).map(f64::abs).fold(0.0, f64::max);
    if aligned > 0 {
        facts.push(("Largest motion", format!("{most:.1} px"), format!("and a turn of {turned:.2}°")));
    }
    let errors = report.frames.iter().filter(|f| f.alignment.status != Status::Reference);
    if let Some(worst) = errors.filter_map(|f| f.alignment.error_px).reduce(f64::max) {
        facts.push(("Error left", format!("{worst:.2} px"), "our own estimate for the worst frame".into()));
    }
    if let Some((least, most)) = report.local_processing.as_ref().and_then(LocalReport::range_stops) {
        let range = format!("{} to {} stops", signed(least, 1), signed(most, 1));
        facts.push(("Local gain", range, "of frames that the camera tone-mapped".into()));
    }
    let crop = &report.crop;
    facts.push(("Result", format!("{} × {}", crop.width_px, crop.height_px), "pixels".into()));
    facts.push(("Time", format!("{:.1} s", report.time_s.total), "all stages together".into()));
    let item = |(name, value, note): &(&str, String, String)| {
        format!("<div><dt>{name}</dt><dd><b>{}</b><span>{}</span></dd></div>\n", escape(value), escape(note))
    };
    format!("<dl class=\"facts\">\n{}</dl>\n", facts.iter().map(item).collect::<String>())
}

/// What the user should know, in words.
pub(super) fn warnings(report: &Report) -> String {
    if report.warnings.is_empty() {
        return "<p class=\"calm\">No warnings: every frame has its place, exposures are known, and nothing had to be guessed.</p>\n"
            .into();
    }
    let item = |w: &crate::report::WarningReport| {
        let (class, word) = if w.degrades { ("grave", "Have a look") } else { ("mild", "Good to know") };
        format!("<li class=\"{class}\"><b>{word}.</b> {}</li>\n", escape(&w.message))
    };
    let items: String = report.warnings.iter().map(item).collect();
    format!("<div class=\"warnings\" role=\"note\" aria-label=\"Warnings\">\n<ul>\n{items}</ul>\n</div>\n")
}

/// Times, options, and files.
pub(super) fn run(report: &Report, page_s: f64) -> String {
    let mut out = String::from("<div class=\"columns\">\n<div>\n<h3>Time</h3>\n<table class=\"times\">\n");
    let times = &report.time_s;
    let stages = [
        ("Load", times.load),
        ("Align", times.align),
        ("Response", times.response),
        ("Merge", times.merge),
        ("Tone-map", times.tonemap),
        ("Write", times.write),
        ("This page", Some(page_s)),
        ("All", Some(times.total)),
    ];
    for (name, time) in stages.iter().filter_map(|(n, t)| t.map(|t| (n, t))) {
        let share = (100.0 * time / times.total.max(1e-9)).min(100.0);
        let _ = writeln!(
            out,
            "<tr><th scope=\"row\">{name}</th><td class=\"n\">{time:.2} s</td><td class=\"bar\"><i style=\"width:{share:.1}%\"></i></td></tr>"
        );
    }
    out += "</table>\n";
    if !report.outputs.is_empty() {
        out += "<h3>Files written</h3>\n<ul class=\"files\">\n";
        report.outputs.iter().for_each(|path| {
            let _ = writeln!(out, "<li><code>{}</code></li>", escape(path));
        });
        out += "</ul>\n";
    }
    out += "</div>\n<div>\n<h3>Options used</h3>\n<table class=\"options\">\n";
    for (name, value) in options(report) {
        let _ = writeln!(out, "<tr><th scope=\"row\">{}</th><td>{}</td></tr>", escape(&name), escape(&value));
    }
    out += "</table>\n</div>\n</div>\n";
    out
}

/// Every option and its value, as the report has them, and the reference.
fn options(report: &Report) -> Vec<(String, String)> {
    let mut rows = vec![("reference".to_owned(), file_name(&report.reference))];
    rows.extend(report.transforms_from.iter().map(|path| ("transforms from".to_owned(), path.clone())));
    let all = report.options.as_ref().and_then(|options| serde_json::to_value(options).ok());
    flatten("", all.as_ref().unwrap_or(&Value::Null), &mut rows);
    if let Some(calibration) = &report.calibration {
        rows.push(("cd/m² of radiance 1".into(), format!("{:.4}", calibration.cd_m2_per_unit)));
    }
    if let Some(flare) = &report.flare {
        rows.push(("flare found".into(), percent(flare.scattered_fraction).replace("&lt;", "<")));
    }
    rows
}

/// `value` as rows of names and words; what is not set is left out.
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

/// How a frame lies, in a few words.
pub(super) fn motion(frame: &crate::report::FrameReport) -> String {
    let place = &frame.alignment;
    match (place.status, place.shift_px, place.rotation_deg) {
        (Status::Reference, ..) => "the others are laid on it".into(),
        (Status::Unmoved, ..) => "lies as the reference does".into(),
        (Status::Assumed, ..) if place.model == Some(Model::Unmoved) => "assumed to lie as the reference does".into(),
        (Status::Assumed, Some([dx, dy]), Some(angle)) => {
            format!("assumed: {}, {} px; {}°", signed(dx, 1), signed(dy, 1), signed(angle, 2))
        }
        (Status::Rejected, ..) => "could not be placed".into(),
        (Status::Excluded, ..) => "excluded by the user".into(),
        (Status::Flash, ..) => "excluded: the flash fired".into(),
        (Status::Aligned, Some([dx, dy]), Some(angle)) => {
            format!("{}, {} px; {}°", signed(dx, 1), signed(dy, 1), signed(angle, 2))
        }
        (Status::Aligned | Status::Assumed, ..) => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_rows_and_what_is_not_set_is_none() {
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
