//! The document: head, style, the sections in their order, script.
//!
//! In: a [`Page`] and its [`Report`]. Out: HTML. Cost: none.

use super::encoded::Picture;
use super::markup::{escape, figure};
use super::{Page, light, photographs, summary};
use crate::inspect::text::file_name;
use crate::report::Report;

const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("compare.js");

/// What a browser may load for the page: what is in it.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; \
                      base-uri 'none'; form-action 'none'";

/// The whole of it.
pub(super) fn html(page: &Page, report: &Report, result: Option<&Picture>) -> String {
    let title = escape(&bracket_name(report));
    let mut sections = vec![("frames", "Frames", photographs::frames(page, report))];
    let moved = photographs::moved(page, report);
    sections.push(("moved", "What moved", moved));
    sections.push(("bitmaps", "Bitmaps", photographs::bitmaps(page, report)));
    if let Some(body) = light::scene(page, report) {
        sections.push(("light", "Light", body));
    }
    if let Some(body) = light::shares(page, report) {
        sections.push(("shares", "Who gave what", body));
    }
    sections.push(("run", "The run", summary::run(report, page.time_s)));
    let links: String = sections.iter().map(|(id, name, _)| format!("<a href=\"#{id}\">{name}</a>\n")).collect();
    let bodies: String = sections
        .iter()
        .map(|(id, name, body)| {
            format!(
                "<section id=\"{id}\" aria-labelledby=\"{id}-h\">\n<h2 id=\"{id}-h\">{name}</h2>\n{body}</section>\n"
            )
        })
        .collect();
    let lead = result.map_or_else(String::new, |picture| lead(picture, report));
    let (facts, warnings) = (summary::facts(report), summary::warnings(report));
    let kind = if report.radiance.is_some() { "merged" } else { "aligned" };
    let software = escape(report.software);
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <meta name=\"generator\" content=\"{software}\">\n<title>{title}: {kind} by hdralign</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n<a class=\"skip\" href=\"#main\">To the report</a>\n\
         <header>\n<p class=\"kind\">{software} · {kind} bracket</p>\n<h1>{title}</h1>\n</header>\n\
         <main id=\"main\">\n{lead}{facts}{warnings}<nav aria-label=\"Sections\">\n{links}</nav>\n{bodies}</main>\n\
         <footer><p>Made by {software}. This page is whole in itself: it loads nothing, and sends nothing. The same facts for \
         programs: <code>--report FILE.json</code>. Every drawing at full size: <code>hdralign inspect</code>.</p></footer>\n\
         <script>\n{SCRIPT}</script>\n</body>\n</html>\n"
    )
}

/// The first and the last of the frames by name, without what comes after the dot.
fn bracket_name(report: &Report) -> String {
    let mut names: Vec<String> = report.frames.iter().map(|f| file_name(&f.path)).collect();
    // 9 before 10.
    names.sort_by_key(|name| (name.len(), name.clone()));
    let stem = |name: &String| name.rsplit_once('.').map_or_else(|| name.clone(), |(stem, _)| stem.to_owned());
    match (names.first(), names.last()) {
        (Some(first), Some(last)) if first != last => format!("{} – {}", stem(first), stem(last)),
        (Some(one), _) => stem(one),
        _ => String::new(),
    }
}

/// The picture that it is all about.
fn lead(picture: &Picture, report: &Report) -> String {
    let crop = &report.crop;
    let reduced = if picture.width == crop.width_px {
        String::new()
    } else {
        format!(", shown at {} × {}", picture.width, picture.height)
    };
    let cut = (report.width_px * report.height_px).saturating_sub(crop.width_px * crop.height_px);
    let cut = match 100.0 * cut as f64 / (report.width_px * report.height_px).max(1) as f64 {
        share if share < 0.05 => "the whole of the reference".to_owned(),
        share => format!("the part of the reference that all placed frames cover; {share:.1}\u{a0}% is cut off"),
    };
    let caption = format!(
        "<b>The picture</b>, tone-mapped from the merged radiance: {} × {} pixels{reduced}; {cut}. Look for double edges (a frame lies \
         wrong), for people and leaves that show through (<code>--deghost=1</code>), and for grey patches in the sky (nothing held it).",
        crop.width_px, crop.height_px
    );
    let figure = figure(picture, "The tone-mapped result of the bracket.", &caption);
    figure.replacen("<figure>", "<figure class=\"lead\">", 1)
}
