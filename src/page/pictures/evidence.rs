//! What shows the quality of the alignment on the page: overlay, bitmaps, XOR curves, keypoints and matches.
//!
//! In: an [`Inspection`]. Out: pictures and SVG. Cost: the inspection's overlays and some small pictures. Source: Ward
//! 2003, section 2 (bitmaps); Lowe 2004 (keypoints); the figures of chapter 4 of the thesis that hdralign is based on.

use crate::align::diagnostics::{Curve, FrameBitmaps, Matching, XorCurves};
use crate::align::features::Keypoint;
use crate::align::{Alignment, Placement};
use crate::bracket::Bracket;
use crate::draw::image::{Picture, grey_jpeg, jpeg, paletted};
use crate::draw::plot::Axis;
use crate::draw::scale::within;
use crate::inspect::Inspection;
use crate::inspect::sheets::keypoints::layers;
use crate::page::markup::{escape, signed};
use crate::page::plot::Figure;
use crate::page::{COARSE, DRAWING, is_searched};
use crate::plane::Plane;
use std::fmt::Write;

/// Largest width of an overlay in pixels, and the largest number of frames whose overlays have this width. If there are
/// more frames, the overlays are smaller, so that together they have as many pixels, but they are at least
/// [`LEAST_OVERLAY`] wide.
const OVERLAY: (usize, usize) = (680, 3);
/// Smallest width of an overlay, in pixels.
const LEAST_OVERLAY: usize = 360;
/// JPEG quality of an overlay.
const EDGES: u8 = 58;
/// Largest number of lines between matches; more lines would hide each other.
const LINES: usize = 120;
/// Resolution of drawings of keypoints and matches: number of drawing units per pixel of the photograph. With two units
/// per pixel, positions can differ by half a pixel.
const UNITS: usize = 2;

/// Colours (red, green, blue, opacity) of the dark, bright and excluded pixels of a bitmap.
const BITMAP: [[u8; 4]; 3] = [[28, 33, 40, 255], [238, 241, 244, 255], [214, 142, 48, 255]];

/// What shows the quality of the alignment of one frame.
#[derive(Debug, Clone)]
pub(in crate::page) struct Evidence {
    pub bitmap: Picture,
    /// Threshold of the bitmap, as a percentile and as a grey value, and the fraction of excluded pixels.
    pub threshold: (u8, u8, f64),
    /// Difference from the bitmap of the reference frame; `None` for the reference frame.
    pub xor: Option<Xor>,
    pub overlay: Option<Overlay>,
    /// SVG of the keypoints, and three numbers of keypoints: only in the photograph, only in its bitmaps, and in both.
    /// `None` if features were not needed.
    pub keypoints: Option<(String, [usize; 3])>,
    /// SVG of the matches, the number of matches, and the number of inliers. `None` if features were not needed.
    pub matches: Option<(String, usize, usize)>,
    /// Whether the photograph behind the keypoints and matches is brightened.
    pub brightened: bool,
}

/// How much the bitmap of a frame differs from that of the reference frame. `before` and `after` are the share of the
/// compared pixels that differ before and after alignment, 0..=1. The `plots` show this share for different rotations,
/// shifts to the right, and shifts down.
#[derive(Debug, Clone)]
pub(in crate::page) struct Xor {
    pub before: f64,
    pub after: f64,
    pub plots: [String; 3],
}

/// The edges of a frame, drawn over the edges of the reference.
#[derive(Debug, Clone)]
pub(in crate::page) struct Overlay {
    pub before: Picture,
    pub after: Option<Picture>,
    pub has_details: bool,
}

/// Returns whether features were needed to align frame `i`, or to align another frame to it if it is the reference.
pub(in crate::page) fn needs_features(alignment: &Alignment, i: usize) -> bool {
    match alignment.placements[i] {
        Placement::Reference => alignment.features.iter().any(|found| found.keypoints.is_some()),
        _ => alignment.features[i].keypoints.is_some(),
    }
}

/// Returns the [`Evidence`] of all frames.
pub(in crate::page) fn gather(
    inspection: &Inspection,
    alignment: &Alignment,
    bracket: &Bracket,
) -> Result<Vec<Evidence>, String> {
    let placements = &alignment.placements;
    let base = bracket.reference_index();
    let overlaid = placements.iter().filter(|placement| is_searched(placement.status())).count().max(1);
    let share = (OVERLAY.1 as f64 / overlaid as f64).min(1.0).sqrt();
    let across = ((OVERLAY.0 as f64 * share) as usize).max(LEAST_OVERLAY);
    let needed = |i: usize| needs_features(alignment, i);
    let of = |i: usize| -> Result<Evidence, String> {
        let bitmaps = inspection.bitmaps(i);
        let is_placed = placements[i].transform().is_some();
        let (grey, brightened) = inspection.photograph(i, (DRAWING, DRAWING));
        let scale = grey.width() as f64 / bracket.width() as f64;
        let photograph = || grey_jpeg(&grey, COARSE);
        let layers = || layers(inspection.features(i));
        let keypoints =
            needed(i).then(|| photograph().map(|behind| keypoints(&layers(), &behind, scale))).transpose()?;
        let matches = match inspection.matching(i).filter(|_| needed(i)) {
            None => None,
            Some(matching) => {
                let (reference, _) = inspection.photograph(base, (DRAWING, DRAWING));
                let both = [grey_jpeg(&reference, COARSE)?, photograph()?];
                Some((matched(matching, &both, scale), matching.pairs.len(), matching.inliers()))
            }
        };
        let overlay = match is_searched(placements[i].status()) {
            true => inspection.overlay(i, across)?,
            false => None,
        };
        let overlay = overlay.map(|o| -> Result<Overlay, String> {
            let has_details = o.before.height() > o.whole_rows;
            let after = o.after.map(|after| jpeg(&after, EDGES, None)).transpose()?;
            Ok(Overlay { before: jpeg(&o.before, EDGES, None)?, after, has_details })
        });
        Ok(Evidence {
            bitmap: paletted(&three_levels(bitmaps), &BITMAP)?,
            threshold: (
                bitmaps.percentile.percent(),
                inspection.tables().frames[i].mtb.threshold_level,
                bitmaps.excluded_share(),
            ),
            xor: inspection.xor(i).map(|curves| xor(curves, is_placed)),
            overlay: overlay.transpose()?,
            keypoints,
            matches,
            brightened,
        })
    };
    (0..placements.len()).map(of).collect()
}

/// Returns a reduced picture of the bitmaps, with 0 for dark, 1 for bright and 2 for excluded pixels. Each value is
/// copied from the bitmap pixel in the middle of the reduced pixel.
fn three_levels(bitmaps: &FrameBitmaps) -> Plane<u8> {
    let (threshold, exclusion) = (&bitmaps.bitmaps.threshold, &bitmaps.bitmaps.exclusion);
    let full = (threshold.width(), threshold.height());
    let (across, down) = within(full, DRAWING);
    Plane::from_rows(across, down, |y, row: &mut [u8]| {
        for (x, v) in row.iter_mut().enumerate() {
            let (x, y) = ((2 * x + 1) * full.0 / (2 * across), (2 * y + 1) * full.1 / (2 * down));
            *v = if !exclusion.get(x, y) { 2 } else { u8::from(threshold.get(x, y)) };
        }
    })
}

/// Draws three plots with the same vertical scale: the difference as a function of rotation, of shift to the right, and
/// of shift down.
fn xor(curves: &XorCurves, is_placed: bool) -> Xor {
    let [dx, dy, angle] = curves.centre;
    let all = [&curves.by_angle, &curves.by_dx, &curves.by_dy];
    let most = all.iter().flat_map(|c| &c.share).copied().fold(curves.before.max(0.005), f64::max);
    let up = Axis::round(0.0, 100.0 * most, 5, "differing pixels, %");
    let plot = |curve: &Curve, name: &str, at: f64, unit: &str, decimals: usize| {
        let (first, last) = (curve.at.first().copied().unwrap_or(0.0), curve.at.last().copied().unwrap_or(1.0));
        let mut plot = Figure::new((380.0, 250.0), 0.0, Axis::within(first, last, 5, name), up.clone());
        plot.curve("accent", curve.at.iter().zip(&curve.share).map(|(&at, &share)| (at, 100.0 * share)));
        let found = signed(at, decimals);
        plot.mark(at, &format!("{found}{unit}"));
        let what = if is_placed { "the alignment" } else { "the best match of the bitmaps" };
        plot.finish(
            "",
            &format!("Percentage of differing bitmap pixels, plotted over {name}; {what} is at {found}{unit}."),
        )
    };
    Xor {
        before: curves.before,
        after: curves.after,
        plots: [
            plot(&curves.by_angle, "rotation, degrees", angle, "°", 3),
            plot(&curves.by_dx, "shift to the right, px", dx, " px", 1),
            plot(&curves.by_dy, "shift down, px", dy, " px", 1),
        ],
    }
}

/// Returns SVG path data that draw a dot at each of `points`, in units of the drawing. A dot is a stroke of length 0
/// with round ends.
fn dots(points: impl Iterator<Item = (f64, f64)>) -> String {
    let mut path = String::new();
    for (x, y) in points {
        let _ = write!(path, "M{:.0} {:.0}h0", x + 0.0, y + 0.0);
    }
    path
}

/// Returns the start tag of an SVG drawing of `w` x `h` units, with the description `words` for screen readers.
fn opened((w, h): (usize, usize), words: &str) -> String {
    let (ratio, words) = (w as f64 / h as f64, escape(words));
    format!(
        "<svg class=\"marks\" style=\"--ratio:{ratio:.4}\" viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"{words}\">"
    )
}

/// Returns the SVG element that draws `photograph` as the background, with its left edge at x = `left`.
fn behind(photograph: &Picture, left: usize) -> String {
    let (w, h) = (UNITS * photograph.width, UNITS * photograph.height);
    format!(r#"<image href="{}" x="{left}" width="{w}" height="{h}" preserveAspectRatio="none"/>"#, photograph.address)
}

/// Draws the keypoints in `layers` on `photograph`, which has `scale` pixels per pixel of the frame. Returns the SVG
/// and the number of keypoints in each layer.
fn keypoints(layers: &[Vec<Keypoint>; 3], photograph: &Picture, scale: f64) -> (String, [usize; 3]) {
    let counts = layers.each_ref().map(Vec::len);
    let words = format!(
        "{} keypoints only in the photograph, {} only in its bitmaps, {} in both.",
        counts[0], counts[1], counts[2]
    );
    let mut svg = opened((UNITS * photograph.width, UNITS * photograph.height), &words);
    svg += &behind(photograph, 0);
    for (class, points) in ["plain", "bitmap", "both"].iter().zip(layers) {
        let path = dots(points.iter().map(|k| (units(k.x.into(), scale), units(k.y.into(), scale))));
        let _ = write!(svg, r#"<path class="dots {class}" d="{path}"/>"#);
    }
    (svg + "</svg>\n", counts)
}

/// Returns the distance in drawing units from the left or upper edge of a drawing to the middle of the frame's pixel
/// `at`.
fn units(at: f64, scale: f64) -> f64 {
    (at + 0.5) * scale * UNITS as f64
}

/// Draws the matches between two photographs side by side, with the reference on the left. Both photographs have
/// `scale` pixels per pixel of a frame.
fn matched(matching: &Matching, [reference, frame]: &[Picture; 2], scale: f64) -> String {
    let (w, h) = (UNITS * reference.width, UNITS * reference.height.max(frame.height));
    let gap = 8 * UNITS;
    let right = w + gap;
    let all = right + UNITS * frame.width;
    let inliers = matching.inliers();
    let words =
        format!("{} matches with the reference; {inliers} of these matches agree on one motion.", matching.pairs.len());
    let mut svg = opened((all, h), &words);
    svg += &behind(reference, 0);
    svg += &behind(frame, right);
    let place = |p: [f64; 2], left: f64| (left + units(p[0], scale), units(p[1], scale));
    let stride = matching.pairs.len().div_ceil(LINES).max(1);
    // Outliers are drawn first, so that they do not hide inliers.
    for (wanted, class) in [(false, "outlier"), (true, "inlier")] {
        let mut lines = String::new();
        let mut ends = Vec::new();
        for (k, (a, b)) in matching.pairs.iter().enumerate().filter(|(k, _)| matching.inlier[*k] == wanted) {
            let (from, to) = (place(*a, 0.0), place(*b, right as f64));
            if k % stride == 0 {
                let _ = write!(lines, "M{:.0} {:.0}L{:.0} {:.0}", from.0 + 0.0, from.1 + 0.0, to.0, to.1 + 0.0);
            }
            ends.extend([from, to]);
        }
        let _ = write!(svg, r#"<path class="line {class}" d="{lines}"/>"#);
        let _ = write!(svg, r#"<path class="dots small {class}" d="{}"/>"#, dots(ends.into_iter()));
    }
    svg + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_few_and_dots_are_all() {
        let photograph = Picture { address: "data:,".into(), width: 200, height: 100 };
        let pairs = (0..361).map(|i| ([f64::from(i), 5.0], [f64::from(i), 9.0])).collect();
        let matching = Matching { pairs, inlier: (0..361).map(|i| i % 2 == 0).collect(), transform: None };
        let svg = matched(&matching, &[photograph.clone(), photograph], 0.5);
        // Every fourth match has a line; every match has two dots.
        assert_eq!((svg.matches('L').count(), svg.matches("h0").count()), (91, 722));
        assert!(svg.contains("361 matches") && svg.contains("181 of these matches"));
        // The first match is at x = (0 + 1/2) * 0.5 * 2 = 0.5 units, which is rounded to the even number 0. The frame
        // begins at 416 units.
        assert!(svg.contains("M0 6L416 10"), "{}", &svg[..900]);
    }
}
