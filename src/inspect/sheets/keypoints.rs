//! Draws the keypoints of a frame: those in the photograph, those in its bitmaps, and those in both.
//!
//! In: a frame and its features. Out: a drawing with a circle for each keypoint. The radius is the scale of the
//! keypoint, and a tick shows its direction. Cost: about 180 bytes per keypoint. Source: the figures in chapter 4 of
//! the thesis that hdralign is based on. The colours can be distinguished with colour blindness (after Okabe & Ito
//! 2008).

use super::layout::{Entry, Mark, Page};
use super::photograph::Photograph;
use crate::align::diagnostics::FrameFeatures;
use crate::align::features::Keypoint;
use crate::draw::svg::{Colour, Drawing, Path, Pen};

/// Colour of keypoints that were found only in the photograph: light vermilion.
const PLAIN: Colour = Colour(255, 122, 46);
/// Colour of keypoints that were found only in the bitmaps: sky blue.
const MTB: Colour = Colour(86, 196, 255);
/// Colour of keypoints that were found in both: yellow.
const BOTH: Colour = Colour(250, 236, 60);

/// Smallest radius of a circle, in pixels of the page. A smaller circle would look like a dot, and its direction
/// could not be seen.
const LEAST_RADIUS: f64 = 2.5;

/// Returns three lists of keypoints: those found only in the photograph, those found only in its bitmaps, and those
/// found in both.
pub(crate) fn layers(features: &FrameFeatures) -> [Vec<Keypoint>; 3] {
    let ([plain, mtb], [in_mtb, in_plain]) = (features.keypoints(), features.found_twice());
    let some = |points: &[Keypoint], twice: &[bool], wanted: bool| {
        points.iter().zip(twice).filter(|(_, t)| **t == wanted).map(|(k, _)| *k).collect()
    };
    [some(&plain, &in_mtb, false), some(&mtb, &in_plain, false), some(&mtb, &in_plain, true)]
}

/// Draws the keypoints of `features` on `photograph`.
pub(in crate::inspect) fn draw(
    title: &str,
    photograph: &Photograph,
    features: &FrameFeatures,
) -> Result<Drawing, String> {
    let layers = layers(features);
    let [plain, mtb, both] = layers.each_ref().map(Vec::len);
    let counts = features.counts();
    let entry = |colour, words: String| Entry { mark: Mark::Keypoint, colour, words };
    let legend = [
        entry(PLAIN, format!("photograph only: {plain}")),
        entry(MTB, format!("bitmap (MTB) only: {mtb}")),
        entry(BOTH, format!("in both: {both}")),
    ];
    let (width, height) = features.size();
    let mut notes = format!(
        "Keypoints: {} in the photograph, {} in the threshold bitmaps, {} merged; detected at {width} x {height} pixels. Radius of a circle: scale (sigma) of the keypoint, at least 2.5 px; line in the circle: direction.",
        counts.plain, counts.mtb, counts.merged
    );
    if photograph.brightened {
        notes += " The frame is shown brightened.";
    }
    let mut page = Page::new(title, &legend, photograph.size(), &notes);
    let corner = page.corner;
    let area = photograph.put(&mut page.drawing, corner)?;
    let marks = |points: &[Keypoint]| {
        let mut path = Path::default();
        for k in points {
            let centre = photograph.place(corner, k.x.into(), k.y.into());
            let radius = (f64::from(k.scale) * photograph.scale()).max(LEAST_RADIUS);
            path.circle(centre, radius);
            let (sin, cos) = (libm::sin(k.angle.into()), libm::cos(k.angle.into()));
            path.line(centre, (centre.0 + radius * cos, centre.1 + radius * sin));
        }
        path
    };
    page.drawing.clipped(area, |inside| {
        for (colour, points) in [PLAIN, MTB, BOTH].into_iter().zip(&layers) {
            let path = marks(points);
            // A dark outline makes the colours visible on bright parts.
            inside.stroke(&path, Pen { colour: Colour::INK, width: 2.6, opacity: 0.45 });
            inside.stroke(&path, Pen { colour, width: 1.2, opacity: 1.0 });
        }
    });
    Ok(page.drawing)
}
