//! The scene: what was left out of each frame because it moved, and what the phone did to each frame.
//!
//! In: a [`Page`] and its [`Report`]. Out: HTML. Cost: none.

use crate::draw::image::Picture;
use crate::page::Page;
use crate::page::markup::{file_name, img, percent, signed};
use crate::report::Report;

/// What was left out of each frame; none where movement was not sought.
pub(in crate::page) fn moved(report: &Report) -> Option<String> {
    let ghosts = report.ghosts.as_ref()?;
    let row = |frame: &crate::merge::deghost::GhostFrame| {
        let (name, share) = (file_name(&frame.path), percent(frame.ghost_fraction));
        format!("<tr><th scope=\"row\">{name}</th><td class=\"n\">{share}</td></tr>\n")
    };
    let rows: String = ghosts.frames.iter().map(row).collect();
    Some(format!(
        "<p class=\"intro\">The share of the picture in which each frame was left out in favour of the reference, \
         because it shows something else there; strength {}. Switched on in the viewer, the places should have the \
         shapes of people, leaves and water. Large smooth ones mean frames that do not fit.</p>\n<table \
         class=\"narrow\">\n{rows}</table>\n",
        ghosts.strength
    ))
}

/// What the phone did to each frame; none where it did nothing.
pub(in crate::page) fn processed(page: &Page, report: &Report) -> Option<String> {
    let local = page.local.as_ref()?;
    let found = report.local_processing.as_ref()?;
    let card = |(i, picture): &(usize, Picture)| {
        let path = report.frames.get(*i).map_or("", |frame| frame.path.as_str());
        let range = found.frames.iter().find(|frame| frame.path == path).map_or_else(String::new, |frame| {
            format!(" by {} to {} stops", signed(frame.gain_stops.0, 1), signed(frame.gain_stops.1, 1))
        });
        let image = img(picture, &format!("What the phone did to {path}."));
        let image = image.replacen("<img ", &format!("<img id=\"gain-{i}\" class=\"map\" "), 1);
        format!("<figure>{image}<figcaption><b>{}</b> was multiplied{range}</figcaption></figure>\n", file_name(path))
    };
    let cards: String = local.frames.iter().map(card).collect();
    Some(format!(
        "<p class=\"intro\">By how much each frame was multiplied, place by place, to have the brightness of the reference: \
         <span class=\"key brighter\"></span> \
         the phone had brightened it there, <span class=\"key darker\"></span> it had darkened it. The strongest colours are \
         {:.1} stops. An exposure step \
         came out as {} of itself. Large differences of brightness were expanded by {:.2} on average.</p>\n<div class=\"grid\">\n{cards}</div>\n",
        local.most_stops,
        percent(found.exposure_step_fraction),
        found.expansion
    ))
}
