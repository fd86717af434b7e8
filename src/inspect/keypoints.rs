//! Keypoints on a frame: those of the plain picture, those of its bitmap, and those that are both.
//!
//! In: a frame and its features. Out: a drawing with a circle for each keypoint, its radius the scale, and a tick in its direction. Cost:
//! some 70 bytes a keypoint. Source: the thesis's figures of chapter 4, in colours that the colour-blind tell apart (after Okabe & Ito 2008).

use super::drawing::{Colour, Drawing, Path, Pen};
use super::page::{Entry, Mark, Page};
use super::picture::Photograph;
use crate::align::diagnostics::FrameFeatures;
use crate::align::features::Keypoint;

/// Keypoints of the plain picture alone: vermilion, lightened.
const PLAIN: Colour = Colour(255, 122, 46);
/// ... of the bitmap alone: sky blue.
const MTB: Colour = Colour(86, 196, 255);
/// ... of both: yellow.
const BOTH: Colour = Colour(250, 236, 60);

/// A smaller circle would be a dot without a direction, in pixels of the page.
const LEAST_RADIUS: f64 = 2.5;

/// The keypoints of `features` on `photograph`.
pub(super) fn draw(title: &str, photograph: &Photograph, features: &FrameFeatures) -> Result<Drawing, String> {
    let [plain, mtb] = features.keypoints();
    let [in_mtb, in_plain] = features.found_twice();
    let counts = features.counts();
    let entry = |colour, words: String| Entry { mark: Mark::Keypoint, colour, words };
    let twice = in_plain.iter().filter(|t| **t).count();
    let legend = [
        entry(PLAIN, format!("plain picture only: {}", in_mtb.iter().filter(|t| !**t).count())),
        entry(MTB, format!("bitmap (MTB) only: {}", counts.mtb - twice)),
        entry(BOTH, format!("in both: {twice}")),
    ];
    let (width, height) = features.size();
    let mut notes = format!(
        "{} keypoints plain, {} on the bitmap, {} merged, sought on {width} x {height} pixels. Radius: scale (sigma); tick: direction.",
        counts.plain, counts.mtb, counts.merged
    );
    if photograph.brightened {
        notes += " The frame is shown brighter than it is.";
    }
    let mut page = Page::new(title, &legend, photograph.size(), &notes);
    let corner = page.corner;
    let area = photograph.put(&mut page.drawing, corner)?;
    let marks = |points: &[Keypoint], wanted: &dyn Fn(usize) -> bool| {
        let mut path = Path::default();
        for (_, k) in points.iter().enumerate().filter(|(i, _)| wanted(*i)) {
            let centre = photograph.place(corner, k.x.into(), k.y.into());
            let radius = (f64::from(k.scale) * photograph.scale()).max(LEAST_RADIUS);
            path.circle(centre, radius);
            let (sin, cos) = (libm::sin(k.angle.into()), libm::cos(k.angle.into()));
            path.line(centre, (centre.0 + radius * cos, centre.1 + radius * sin));
        }
        path
    };
    let layers = [
        (PLAIN, marks(&plain, &|i| !in_mtb[i])),
        (MTB, marks(&mtb, &|i| !in_plain[i])),
        (BOTH, marks(&mtb, &|i| in_plain[i])),
    ];
    page.drawing.clipped(area, |inside| {
        for (colour, path) in &layers {
            // A dark edge, so that the colours are seen on what is bright.
            inside.stroke(path, Pen { colour: Colour::INK, width: 2.6, opacity: 0.45 });
            inside.stroke(path, Pen { colour: *colour, width: 1.2, opacity: 1.0 });
        }
    });
    Ok(page.drawing)
}
