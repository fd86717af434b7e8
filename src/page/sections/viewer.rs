//! The viewer: the result and every frame at the same position and zoom, with optional overlays.
//!
//! In: a [`Page`] and its [`Report`]. Out: HTML for `viewer.js`; without scripts it shows the result, and the overlays
//! still work. Cost: none: the script places the pictures of the frame cards over the result.

use super::photographs::stops_over_reference;
use crate::align::Status;
use crate::draw::image::Picture;
use crate::draw::markup;
use crate::page::markup::{escape, file_name, img, percent, signed};
use crate::page::{Page, frame_css};
use crate::report::Report;
use std::fmt::Write;

/// Largest number of buttons that each show a region of movement.
const REGIONS: usize = 5;

/// Returns the viewer of the `result`, or of the frames if there is no result.
pub(in crate::page) fn viewer(page: &Page, report: &Report, result: Option<&Picture>) -> String {
    let crop = &report.crop;
    let ratio = crop.width_px as f64 / crop.height_px.max(1) as f64;
    let (hidden, picture, to_result) = match result {
        Some(picture) => ("", img(picture, "The result."), ", R result"),
        None => (" hidden", String::new(), ""),
    };
    let (layers, switches) = overlays(page, report);
    // `held` is the picture that defines the zoom: at 100 %, one pixel of it is one pixel of the screen.
    let held = result.or(page.frames.first().map(|frame| &frame.photograph));
    let width = held.map_or(crop.width_px, |picture| picture.width);
    format!(
        "<figure class=\"viewer\" id=\"viewer\" style=\"--ratio:{ratio:.4}\" data-width=\"{width}\"{hidden}>\n\
         <div class=\"tools\" hidden>\n{}{}</div>\n\
         <div class=\"stage\" tabindex=\"0\" role=\"group\" aria-label=\"Picture: the arrow keys move it, F fits it, \
         1 and 2 show 100 and 200 percent, N and P the next and the previous frame{to_result}\">\n\
         <div class=\"canvas\">\n{picture}\n{layers}</div>\n</div>\n\
         <p class=\"shows\" hidden><span role=\"status\"></span> <span class=\"hint\">Click or tap to zoom, drag to move.\
         <span class=\"keyed\"> Keys: F fit, 1 and 2 zoom, N and P frames{to_result}.</span></span></p>\n{switches}<figcaption>{}</figcaption>\n</figure>\n",
        choices(report, result.is_some()),
        ZOOMS,
        caption(page, report, result)
    )
}

const ZOOMS: &str = "<fieldset class=\"pills\"><legend>Zoom</legend>\n\
    <label><input type=\"radio\" name=\"zoom\" value=\"0\" checked><span>Fit</span></label>\n\
    <label><input type=\"radio\" name=\"zoom\" value=\"1\"><span>100\u{a0}%</span></label>\n\
    <label><input type=\"radio\" name=\"zoom\" value=\"2\"><span>200\u{a0}%</span></label>\n</fieldset>\n";

/// Returns the buttons that select the picture to show: the result, or one of the frames, labelled with its exposure.
fn choices(report: &Report, has_result: bool) -> String {
    let mut out = String::from("<fieldset class=\"pills shown\"><legend>Show</legend>\n");
    if has_result {
        out += "<label><input type=\"radio\" name=\"shown\" value=\"result\" checked><span>Result</span></label>\n";
    }
    out += "<span class=\"word\">Frames, EV</span>\n";
    let stops = stops_over_reference(report);
    for (i, frame) in report.frames.iter().enumerate() {
        let colour = frame_css(i, report.frames.len());
        let name = file_name(&frame.path);
        let checked = if !has_result && frame.alignment.status == Status::Reference { " checked" } else { "" };
        let _ = writeln!(
            out,
            "<label title=\"{name}\" style=\"--own:{colour}\"><input type=\"radio\" name=\"shown\" \
             value=\"{i}\"{checked} aria-label=\"{name}, {ev} EV\"><span>{ev}</span></label>",
            ev = short(stops[i])
        );
    }
    out + "</fieldset>\n"
}

/// Formats stops with one decimal, or without decimals if the decimal is 0.
fn short(stops: f64) -> String {
    let words = signed(stops, 1);
    words.strip_suffix(".0").map_or_else(|| words.clone(), str::to_owned)
}

/// Returns the overlays of the picture, and their switches.
fn overlays(page: &Page, report: &Report) -> (String, String) {
    let (mut layers, mut switches) = (String::new(), String::new());
    let layer = |picture: &Picture, class: &str, alt: &str| {
        img(picture, alt).replacen("<img ", &format!("<img class=\"over {class}\" "), 1) + "\n"
    };
    let switch = |class: &str, name: &str, words: &str| {
        format!(
            "<div class=\"switch\"><label><input type=\"checkbox\" name=\"{class}\"> <b>{name}</b></label> <span \
             class=\"legend-{class}\">{words}</span></div>\n"
        )
    };
    if let (Some(picture), Some(ghosts)) = (&page.movement, &report.ghosts) {
        layers += &layer(picture, "movement", "Overlay: where something moved.");
        let reference = report.frames.iter().find(|frame| frame.alignment.status == Status::Reference);
        let reference = reference.map_or_else(String::new, |frame| file_name(&frame.path));
        let mut words = format!(
            "<span class=\"key moved\"></span> something moved ({} of the picture): here the result shows {reference}, and frames \
             that differ from it are not used.",
            percent(ghosts.ghost_fraction)
        );
        let (width, height) = (report.crop.width_px.max(1) as f64, report.crop.height_px.max(1) as f64);
        let go = |(i, region): (usize, &crate::merge::deghost::GhostRegion)| {
            let x = (region.x_px as f64 + 0.5 * region.width_px as f64) / width;
            let y = (region.y_px as f64 + 0.5 * region.height_px as f64) / height;
            format!(
                "<button type=\"button\" data-x=\"{x:.4}\" data-y=\"{y:.4}\" aria-label=\"Go to movement {n}\">{n}</button> ",
                n = i + 1
            )
        };
        let places: String = ghosts.regions.iter().take(REGIONS).enumerate().map(go).collect();
        let _ = write!(words, " <span class=\"places\" hidden>Go to: {places}</span>");
        switches += &switch("movement", "Movement", &words);
    }
    if let Some((local, (frame, picture))) = page.local.as_ref().and_then(|l| Some((l, l.frames.get(l.strongest)?))) {
        layers += &layer(picture, "gain", "Overlay: where the phone brightened and darkened the frame.");
        let words = format!(
            "<span class=\"key brighter\"></span> brightened by the phone, <span class=\"key darker\"></span> \
             darkened, by up to {:.1} stops relative to the reference. Over the result, the overlay of {} is shown.",
            local.most_stops,
            report.frames.get(*frame).map_or_else(String::new, |frame| file_name(&frame.path))
        );
        switches += &switch("gain", "Phone processing", &words);
    }
    match switches.is_empty() {
        true => (layers, switches),
        false => (
            layers,
            format!("<fieldset class=\"switches\"><legend>Show on the picture</legend>\n{switches}</fieldset>\n"),
        ),
    }
}

/// Describes how the size of the pictures on the page differs from that of the result (before `--resize`).
fn caption(page: &Page, report: &Report, result: Option<&Picture>) -> String {
    let crop = &report.crop;
    let mut words = String::new();
    if let Some(result) = result {
        let file = |path: &&String| [".png", ".jpg", ".jpeg"].iter().any(|end| path.to_lowercase().ends_with(end));
        let open = report.outputs.iter().find(file).map_or_else(String::new, |path| {
            format!(" Open <code>{}</code> to judge sharpness.", escape(&markup::file_name(path)))
        });
        let is_resized = report.options.as_ref().is_some_and(|options| options.resize.is_some());
        let shown = if is_resized { "result before <code>--resize</code>" } else { "result" };
        words += &match result.width == crop.width_px {
            true => {
                format!("This page contains the {shown} at full size, {} × {} pixels.", crop.width_px, crop.height_px)
            }
            false => format!(
                "To keep the page small, the {shown} is reduced here to {} × {} pixels. Its full size is {} × {} pixels. \
                 <b>A zoom of 100\u{a0}% shows it at {:.0}\u{a0}% of its full size.</b>{open}",
                result.width,
                result.height,
                crop.width_px,
                crop.height_px,
                100.0 * result.width as f64 / crop.width_px as f64
            ),
        };
    }
    let held = page.frames.first().map(|frame| &frame.photograph).filter(|frame| frame.width < crop.width_px);
    if let Some(frame) = held.filter(|frame| result.is_none_or(|result| frame.width < result.width)) {
        let _ =
            write!(words, " The frames are shown at {} × {} pixels, so they look softer.", frame.width, frame.height);
    }
    words
}
