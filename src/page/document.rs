//! The document: head, style, the sections in their order, script.
//!
//! In: a [`Page`] and its [`Report`]. Out: HTML. Cost: none.

use super::Page;
use super::markup::escape;
use super::sections::{advice, light, photographs, scene, summary, viewer, words};
use crate::draw::image::Picture;
use crate::draw::markup::file_name;
use crate::report::Report;

const STYLE: [&str; 2] = [include_str!("style.css"), include_str!("viewer.css")];
const SCRIPT: [&str; 2] = [include_str!("viewer.js"), include_str!("compare.js")];

/// Content Security Policy: only data inside the page may be loaded.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; \
                      base-uri 'none'; form-action 'none'";

/// Returns the complete document.
pub(super) fn html(page: &Page, report: &Report, result: Option<&Picture>) -> String {
    let title = escape(&bracket_name(report));
    let kind = if report.radiance.is_some() { "merged" } else { "aligned" };
    let software = escape(report.software);
    let sections = [
        ("frames", "Frames", photographs::frames(page, report)),
        ("settings", "Files and settings", summary::settings(report)),
        ("details", "Details", details(page, report)),
    ];
    let section = |(id, name, body): &(&str, &str, String)| {
        format!("<section id=\"{id}\" aria-labelledby=\"{id}-h\">\n<h2 id=\"{id}-h\">{name}</h2>\n{body}</section>\n")
    };
    let bodies: String = sections.iter().map(section).collect();
    let (viewer, facts) = (viewer::viewer(page, report, result), summary::facts(report));
    let (warnings, done) = (advice::warnings(report), words::done(report));
    let [style, script] = [STYLE, SCRIPT].map(|parts| parts.concat());
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{POLICY}\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <meta name=\"generator\" content=\"{software}\">\n<title>{title}: {kind} by hdralign</title>\n\
         <style>\n{style}</style>\n</head>\n<body>\n<a class=\"skip\" href=\"#main\">To the report</a>\n\
         <header>\n<h1>{title}</h1>\n<p class=\"kind\">bracket {kind} by {software}</p>\n\
         <nav aria-label=\"Sections\">\n<a href=\"#main\">Picture</a>\n<a href=\"#frames\">Frames</a>\n\
         <a href=\"#settings\">Settings</a>\n<a href=\"#details\">Details</a>\n</nav>\n</header>\n\
         <main id=\"main\">\n<div class=\"first\">\n{viewer}<section class=\"story\" aria-labelledby=\"story-h\">\n\
         <h2 id=\"story-h\">What was done</h2>\n{warnings}{done}</section>\n</div>\n{facts}{bodies}</main>\n\
         <footer><p>Made by {software}. This page is self-contained: it loads nothing and sends nothing. For \
         the same data as JSON use <code>--report FILE.json</code>, for the drawings at full size <code>hdralign inspect</code>.</p></footer>\n\
         <script>\n{script}</script>\n</body>\n</html>\n"
    )
}

/// Returns the technical details, collapsed.
fn details(page: &Page, report: &Report) -> String {
    let parts = [
        ("alignment", "Alignment, frame by frame", Some(photographs::moved(page, report))),
        ("bitmaps", "Median threshold bitmaps", Some(photographs::bitmaps(page, report))),
        ("movement", "Movement, frame by frame", scene::moved(report)),
        ("local", "What the phone did to each frame", scene::processed(page, report)),
        ("light", "Brightness range and camera response", light::scene(page, report)),
        ("shares", "Contribution of each frame", light::shares(page, report)),
        ("run", "Time", Some(summary::times(report, page.time_s))),
    ];
    let part = |(id, name, body): (&str, &str, Option<String>)| {
        let body = body?;
        Some(format!("<details class=\"part\" id=\"{id}\">\n<summary><h3>{name}</h3></summary>\n{body}</details>\n"))
    };
    parts.into_iter().filter_map(part).collect()
}

/// Returns the names of the first and the last frame, without extensions, as the name of the bracket.
fn bracket_name(report: &Report) -> String {
    let mut names: Vec<String> = report.frames.iter().map(|f| file_name(&f.path)).collect();
    // Shorter names come first, so that photograph 9 comes before photograph 10.
    names.sort_by_key(|name| (name.len(), name.clone()));
    let stem = |name: &String| name.rsplit_once('.').map_or_else(|| name.clone(), |(stem, _)| stem.to_owned());
    match (names.first(), names.last()) {
        (Some(first), Some(last)) if first != last => format!("{} – {}", stem(first), stem(last)),
        (Some(one), _) => stem(one),
        _ => String::new(),
    }
}
