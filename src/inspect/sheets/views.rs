//! Views: the edges of the reference frame and of another frame in one picture, one view before alignment and one
//! after. The two frames have different colours, which add up to white where both have an edge.
//!
//! In: two frames and a transform. Out: [`Views`] with the whole picture and some details at twice their size, in
//! which an offset of half a pixel is visible; and their drawing for a file. Cost: one pass over both pictures,
//! and some passes at the drawn size.

use super::edges::{Edges, Grey, laid};
use super::layout::{Entry, Mark, Page, TEXT};
use crate::align::Motion;
use crate::align::resampling::{OUTSIDE, resample_rows, rows_under};
use crate::bracket::Frame;
use crate::draw::image::png_rgb;
use crate::draw::scale::reduce;
use crate::draw::svg::{Anchor, Area, Colour, Drawing, Pen};
use crate::plane::Plane;

/// Colour of the edges of the reference frame. [`REFERENCE`] and [`FRAME`] add up to white.
const REFERENCE: Colour = Colour(255, 140, 0);
/// Colour of the edges of the other frame.
const FRAME: Colour = Colour(0, 115, 255);

/// Colour of the boxes around the details.
pub(super) const BOX: Colour = Colour(255, 240, 0);

/// Largest width and height of one view (before or after alignment), in pixels of the page.
const SIDE: (usize, usize) = (780, 780);
/// Distance between the view before alignment and the view after alignment, in pixels.
const GAP: f64 = 16.0;
/// Distance between a view and its details, and between two details, in pixels.
pub(super) const DETAIL_GAP: f64 = 8.0;
/// Height of the text above each view, in pixels.
const NAMES: f64 = 26.0;
/// Number of details in the row below each of the two views.
const DETAILS: usize = 3;
/// Magnification of a detail: pixels of the page for each pixel of the photograph.
pub(super) const MAGNIFIED: usize = 2;
/// Details should be far apart. From this distance on, given as a fraction of the diagonal, a larger distance is no
/// further advantage.
const APART: f64 = 0.35;
/// Gradients are shown at full strength only if they are at least this large, so that noise is faint in a picture
/// without contrast.
pub(super) const LEAST_FULL: f32 = 0.05;
/// In a detail (an enlarged area), gradients are shown at full strength only if they are at least this fraction of
/// the gradient that has full strength in the view of the whole picture.
const FAINT_DETAIL: f32 = 0.6;

/// The reference frame and another frame, with the motion between them.
pub(in crate::inspect) struct Couple<'a> {
    pub(in crate::inspect) reference: &'a Frame,
    pub(in crate::inspect) frame: &'a Frame,
    pub(in crate::inspect) reference_grey: &'a Plane<u8>,
    pub(in crate::inspect) frame_grey: &'a Plane<u8>,
    /// The motion of the other frame; `None` if that frame is rejected or excluded.
    pub(in crate::inspect) motion: Option<Motion>,
}

/// The edges of a [`Couple`] before and after alignment.
pub(super) struct Views<'a> {
    couple: &'a Couple<'a>,
    pub(super) reference: Edges,
    /// The edges of the frame before alignment and, unless it is rejected or excluded, after alignment. Each element
    /// also contains the motion with which the frame was resampled.
    pub(super) frame: Vec<(Motion, Edges)>,
    /// Width and height of the whole picture on the page, in pixels of the page.
    pub(super) size: (f64, f64),
    /// The areas that are also drawn magnified.
    pub(super) details: Vec<Detail>,
}

impl<'a> Views<'a> {
    /// Returns the edges of `couple`, in pictures of at most `most` pixels in width and height. If `may_grow` is
    /// true, a small picture is magnified by an integer factor on the page.
    pub(super) fn new(couple: &'a Couple, most: (usize, usize), may_grow: bool) -> Self {
        let whole = reduce(couple.reference_grey, most);
        let times = (most.0 / whole.width()).min(most.1 / whole.height()).max(1);
        let times = if may_grow { times as f64 } else { 1.0 };
        let size = (whole.width() as f64 * times, whole.height() as f64 * times);
        let reference = Grey::whole(whole).edges(LEAST_FULL);
        let moving = reduce(couple.frame_grey, most);
        let edges = |motion: &Motion| laid(&moving, motion).edges(LEAST_FULL);
        let after = couple.motion.as_ref().map(|motion| (motion.clone(), edges(motion)));
        let before = (still(couple.reference), Grey::whole(moving).edges(LEAST_FULL));
        let frame: Vec<_> = [Some(before), after].into_iter().flatten().collect();
        let last = frame.last().map(|(_, edges)| &edges.strength);
        let details = last.map_or_else(Vec::new, |last| details(&reference.strength, last, size, couple));
        Views { couple, reference, frame, size, details }
    }

    /// Returns the strengths of the edges in `detail`: first for the reference frame, then for the other frame in view
    /// `k` (0 is before alignment, 1 is after).
    pub(super) fn strengths(&self, detail: &Detail, k: usize) -> Result<[Plane<u8>; 2], String> {
        let (motion, view) = &self.frame[k];
        let still = detail.grey(self.couple.reference, &still(self.couple.reference))?;
        let moved = detail.grey(self.couple.frame, motion)?;
        let ends = [(still, self.reference.full), (moved, view.full)];
        Ok(ends.map(|(grey, full)| grey.edges(FAINT_DETAIL * full).strength))
    }
}

/// The motion of a frame that is not aligned.
fn still(frame: &Frame) -> Motion {
    Motion::unmoved((frame.width(), frame.height()))
}

/// Draws the edges of the two frames in `couple`, before and after alignment.
pub(in crate::inspect) fn draw(title: &str, couple: &Couple) -> Result<Drawing, String> {
    let views = Views::new(couple, SIDE, true);
    let (size, boxes) = (views.size, &views.details);
    let entry = |colour, words: &str| Entry { mark: Mark::Patch, colour, words: words.into() };
    let legend =
        [entry(REFERENCE, "edges of the reference"), entry(FRAME, "edges of the frame"), entry(Colour::WHITE, "both")];
    let below = boxes.first().map_or(0.0, |b| DETAIL_GAP + (b.height * MAGNIFIED) as f64);
    let sides = views.frame.len() as f64;
    let room = (sides * size.0 + (sides - 1.0) * GAP, NAMES + size.1 + below);
    let mut notes =
        "An edge may have the colour of only one frame even after alignment. Then the other frame does not cover this place, or is clipped, black or noisy there; or something moved; or the alignment is wrong there."
            .to_owned();
    if !boxes.is_empty() {
        notes += &format!(" Below: the marked areas, enlarged: {MAGNIFIED} px for each pixel of the photograph.");
    }
    if couple.motion.is_none() {
        notes += " The frame is rejected or excluded, so there is no view after alignment.";
    }
    let mut page = Page::new(title, &legend, room, &notes);
    for (k, ((_, view), words)) in views.frame.iter().zip(["before: as photographed", "after: aligned"]).enumerate() {
        let corner = (page.corner.0 + k as f64 * (size.0 + GAP), page.corner.1 + NAMES);
        page.drawing.text((corner.0, corner.1 - 8.0), TEXT, Anchor::Start, Colour::INK, words);
        let area = Area { x: corner.0, y: corner.1, width: size.0, height: size.1 };
        page.drawing.picture(area, &png_rgb(&two_colours(&views.reference.strength, &view.strength))?);
        for (i, detail) in boxes.iter().enumerate() {
            let place = detail.on_page(corner, size, couple.reference);
            page.drawing.outline(place, Pen { colour: BOX, width: 1.6, opacity: 1.0 });
            let (width, height) = ((detail.width * MAGNIFIED) as f64, (detail.height * MAGNIFIED) as f64);
            let (x, y) = (corner.0 + i as f64 * (width + DETAIL_GAP), corner.1 + size.1 + DETAIL_GAP);
            let [still, moved] = views.strengths(detail, k)?;
            page.drawing.picture(Area { x, y, width, height }, &png_rgb(&two_colours(&still, &moved))?);
        }
    }
    Ok(page.drawing)
}

/// A rectangular area, in pixels of the reference frame.
pub(super) struct Detail {
    pub(super) x: usize,
    pub(super) y: usize,
    pub(super) width: usize,
    pub(super) height: usize,
}

impl Detail {
    fn on_page(&self, corner: (f64, f64), size: (f64, f64), reference: &Frame) -> Area {
        let (sx, sy) = (size.0 / reference.width() as f64, size.1 / reference.height() as f64);
        Area {
            x: corner.0 + self.x as f64 * sx,
            y: corner.1 + self.y as f64 * sy,
            width: self.width as f64 * sx,
            height: self.height as f64 * sy,
        }
    }

    /// Returns the grey values of `frame` in this area, resampled with the method of the merge.
    fn grey(&self, frame: &Frame, motion: &Motion) -> Result<Grey, String> {
        let (columns, rows) = (self.x..self.x + self.width, self.y..self.y + self.height);
        let mut codes = vec![[0.0f32; 3]; self.width * self.height];
        let under = rows_under(motion, &columns, &rows);
        let window = frame.window(under).map_err(|e| e.to_string())?;
        resample_rows(&window, motion, columns, rows, &mut codes);
        let grey = |p: &[f32; 3]| ((54.0 * p[0] + 183.0 * p[1] + 19.0 * p[2]) / 256.0).clamp(0.0, 255.0) as u8;
        let outside: Vec<bool> = codes.iter().map(|p| p[0] == OUTSIDE).collect();
        let levels = codes.iter().map(grey).collect();
        let plane = |values| Plane::from_vec(self.width, self.height, values);
        Ok(Grey { levels: plane(levels), outside: Some(Plane::from_vec(self.width, self.height, outside)) })
    }
}

/// Selects [`DETAILS`] areas that have many edges in both `reference` and `view` and are far from each other. Returns
/// them from left to right. Returns none if the photograph is hardly larger than the details.
fn details(reference: &Plane<u8>, view: &Plane<u8>, size: (f64, f64), couple: &Couple) -> Vec<Detail> {
    let (full_w, full_h) = (couple.reference.width(), couple.reference.height());
    let width = ((size.0 - (DETAILS - 1) as f64 * DETAIL_GAP) / (DETAILS * MAGNIFIED) as f64) as usize;
    let height = width * 4 / 5;
    if width < 16 || full_w < DETAILS * width || full_h < 2 * height {
        return Vec::new();
    }
    let (across, down) = (reference.width(), reference.height());
    let scale = across as f64 / full_w as f64;
    let (w, h) = (((width as f64 * scale) as usize).max(1), ((height as f64 * scale) as usize).max(1));
    let common = |x: usize, y: usize| -> u64 {
        let inside = (y..(y + h).min(down)).flat_map(|v| (x..(x + w).min(across)).map(move |u| (u, v)));
        inside.map(|(u, v)| u64::from(reference.at(u, v).min(view.at(u, v)))).sum()
    };
    let columns = (0..=across.saturating_sub(w)).step_by((w / 3).max(1));
    let places = columns.flat_map(|x| (0..=down.saturating_sub(h)).step_by((h / 3).max(1)).map(move |y| (x, y)));
    let rated: Vec<(f64, (usize, usize))> = places.map(|(x, y)| (common(x, y) as f64, (x, y))).collect();
    // A distance of more than `far` is no further advantage.
    let far = APART * ((across * across + down * down) as f64).sqrt();
    let mut chosen: Vec<(usize, usize)> = Vec::new();
    while chosen.len() < DETAILS {
        let apart = |a: (usize, usize), b: (usize, usize)| {
            let (dx, dy) = (a.0 as f64 - b.0 as f64, a.1 as f64 - b.1 as f64);
            ((dx * dx + dy * dy).sqrt() / far).min(1.0)
        };
        let merit = |(edges, at): (f64, (usize, usize))| chosen.iter().fold(edges, |m, c| m * apart(at, *c));
        // If several areas have the same merit, the first is chosen.
        let best = rated.iter().copied().reduce(|a, b| if merit(b) > merit(a) { b } else { a });
        chosen.push(best.map_or((0, 0), |b| b.1));
    }
    chosen.sort_unstable();
    let at = |v: usize, most: usize| ((v as f64 / scale) as usize).min(most);
    let detail = |(x, y)| Detail { x: at(x, full_w - width), y: at(y, full_h - height), width, height };
    chosen.into_iter().map(detail).collect()
}

/// Returns the sum of two pictures: the edges of the reference frame in one colour and the edges of the other frame
/// in another colour.
pub(super) fn two_colours(reference: &Plane<u8>, frame: &Plane<u8>) -> Plane<[u8; 3]> {
    let (a, b) = (REFERENCE.rgb(), FRAME.rgb());
    Plane::from_rows(reference.width(), reference.height(), |y, row| {
        for ((p, &r), &f) in row.iter_mut().zip(reference.row(y)).zip(frame.row(y)) {
            let share = |c: usize| (u32::from(r) * u32::from(a[c]) + u32::from(f) * u32::from(b[c])) / 255;
            *p = [0, 1, 2].map(|c| share(c).min(255) as u8);
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_colours_add_up_to_white() {
        let (none, full) = (Plane::filled(1, 1, 0u8), Plane::filled(1, 1, 255u8));
        assert_eq!(two_colours(&full, &full).at(0, 0), [255; 3]);
        assert_eq!(two_colours(&full, &none).at(0, 0), [255, 140, 0]);
        assert_eq!(two_colours(&none, &full).at(0, 0), [0, 115, 255]);
    }
}
