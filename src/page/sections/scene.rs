//! Movement in the scene, and local tone mapping by the phone, for each frame.
//!
//! In: a [`Page`] and its [`Report`]. Out: HTML. Cost: none.

use crate::draw::image::Picture;
use crate::page::Page;
use crate::page::markup::{file_name, img, percent, signed};
use crate::report::Report;

/// Returns, for each frame, the share of the picture where the frame is not used because something moved; `None`
/// without deghosting.
pub(in crate::page) fn moved(report: &Report) -> Option<String> {
    let ghosts = report.ghosts.as_ref()?;
    let row = |frame: &crate::merge::deghost::GhostFrame| {
        let (name, share) = (file_name(&frame.path), percent(frame.ghost_fraction));
        format!("<tr><th scope=\"row\">{name}</th><td class=\"n\">{share}</td></tr>\n")
    };
    let rows: String = ghosts.frames.iter().map(row).collect();
    Some(format!(
        "<p class=\"intro\">The fraction of the picture where a frame was not used because it differs from the \
         reference; deghosting strength {}. Switch on Movement in the viewer: the areas should have the shapes of \
         people, leaves or water. Large smooth areas mean that the frames do not match.</p>\n<table \
         class=\"narrow\">\n{rows}</table>\n",
        ghosts.strength
    ))
}

/// Returns the local gain of each frame; `None` if the frames were not locally processed.
pub(in crate::page) fn processed(page: &Page, report: &Report) -> Option<String> {
    let local = page.local.as_ref()?;
    let found = report.local_processing.as_ref()?;
    let card = |(i, picture): &(usize, Picture)| {
        let path = report.frames.get(*i).map_or("", |frame| frame.path.as_str());
        let range = found.frames.iter().find(|frame| frame.path == path).map_or_else(String::new, |frame| {
            format!(" by {} to {} stops", signed(frame.gain_stops.0, 1), signed(frame.gain_stops.1, 1))
        });
        let image = img(picture, &format!("Local gain of {path}."));
        let image = image.replacen("<img ", &format!("<img id=\"gain-{i}\" class=\"map\" "), 1);
        format!("<figure>{image}<figcaption><b>{}</b> was multiplied{range}</figcaption></figure>\n", file_name(path))
    };
    let cards: String = local.frames.iter().map(card).collect();
    Some(format!(
        "<p class=\"intro\">The factor by which each frame was multiplied to match the brightness of the reference: \
         <span class=\"key brighter\"></span> \
         brightened by the phone, <span class=\"key darker\"></span> darkened by it. The strongest colours are \
         {:.1} stops. Exposure steps appear \
         in the pixels at {} of their size. On average, one stop in a frame stands for {:.2} stops in the scene.</p>\n<div class=\"grid\">\n{cards}</div>\n",
        local.most_stops,
        percent(found.exposure_step_fraction),
        found.expansion
    ))
}
