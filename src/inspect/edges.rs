//! Edges: those of the reference and those of a frame in two colours that add up to white, before and after alignment.
//!
//! In: two frames and a warp. Out: a drawing: the whole picture on either side, and below it places with edges at twice their size, where
//! half a pixel is seen. Cost: two passes over the pictures at the size they are drawn. Exposures are made alike by the logarithm of
//! the grey levels and by the share of the strongest edges.

use super::drawing::{Anchor, Area, Colour, Drawing, Pen};
use super::page::{Entry, Mark, Page, TEXT};
use super::picture::{png_rgb, reduce};
use crate::align::resample::{OUTSIDE, resample_rows};
use crate::align::warp::{Warp, map};
use crate::bracket::Frame;
use crate::plane::Plane;

/// The two colours add up to white.
const REFERENCE: Colour = Colour(255, 140, 0);
const FRAME: Colour = Colour(0, 115, 255);

/// One side, in pixels of the page at the most.
const SIDE: (usize, usize) = (780, 780);
/// Paper between the sides and the details.
const GAP: f64 = 16.0;
const DETAIL_GAP: f64 = 8.0;
/// Room for the words above each side.
const NAMES: f64 = 26.0;
/// Details in a row below each side, and how many pixels of the page one of theirs takes.
const DETAILS: usize = 3;
const MAGNIFIED: usize = 2;

/// Two frames, and where the one lies in the other.
pub(super) struct Couple<'a> {
    pub(super) reference: &'a Frame,
    pub(super) frame: &'a Frame,
    pub(super) reference_grey: &'a Plane<u8>,
    pub(super) frame_grey: &'a Plane<u8>,
    /// Reference pixel -> frame pixel; none where the frame was rejected.
    pub(super) warp: Option<Warp>,
}

/// The edges of the couple.
pub(super) fn draw(title: &str, couple: &Couple) -> Result<Drawing, String> {
    let whole = reduce(couple.reference_grey, SIDE);
    let magnified = (SIDE.0 / whole.width()).min(SIDE.1 / whole.height()).max(1) as f64;
    let size = (whole.width() as f64 * magnified, whole.height() as f64 * magnified);
    let reference = edges(&whole);
    let moving = reduce(couple.frame_grey, SIDE);
    let after = couple.warp.map(|warp| laid(&moving, &warp, couple.reference));
    let views = [Some(edges(&moving)), after.as_ref().map(edges)];
    let boxes = details(&reference, views[1].as_ref().or(views[0].as_ref()), size, couple);

    let legend = [
        Entry { mark: Mark::Patch, colour: REFERENCE, words: "edges of the reference".into() },
        Entry { mark: Mark::Patch, colour: FRAME, words: "edges of the frame".into() },
        Entry { mark: Mark::Patch, colour: Colour::WHITE, words: "both".into() },
    ];
    let below = boxes.first().map_or(0.0, |b| DETAIL_GAP + (b.height * MAGNIFIED) as f64);
    let sides = if couple.warp.is_some() { 2.0 } else { 1.0 };
    let room = (sides * size.0 + (sides - 1.0) * GAP, NAMES + size.1 + below);
    let mut notes = format!("Details: {MAGNIFIED} px for one of the photograph's.");
    if couple.warp.is_none() {
        notes += " The frame was left out: there is no after.";
    }
    let mut page = Page::new(title, &legend, room, &notes);
    for (k, view) in views.iter().enumerate() {
        let Some(view) = view else { continue };
        let warp = if k == 0 { Warp::Identity } else { couple.warp.unwrap_or(Warp::Identity) };
        let corner = (page.corner.0 + k as f64 * (size.0 + GAP), page.corner.1 + NAMES);
        let words = if k == 0 { "before: as photographed" } else { "after: aligned" };
        page.drawing.text((corner.0, corner.1 - 8.0), TEXT, Anchor::Start, Colour::INK, words);
        let area = Area { x: corner.0, y: corner.1, width: size.0, height: size.1 };
        page.drawing.picture(area, &png_rgb(&two_colours(&reference, view))?);
        for (i, detail) in boxes.iter().enumerate() {
            let frame = detail.on_page(corner, size, couple.reference);
            page.drawing.outline(frame, Pen { colour: Colour::WHITE, width: 1.2, opacity: 1.0 });
            let (width, height) = ((detail.width * MAGNIFIED) as f64, (detail.height * MAGNIFIED) as f64);
            let at = Area {
                x: corner.0 + i as f64 * (width + DETAIL_GAP),
                y: corner.1 + size.1 + DETAIL_GAP,
                width,
                height,
            };
            let [still, moved] =
                [(couple.reference, Warp::Identity), (couple.frame, warp)].map(|(f, w)| edges(&detail.grey(f, &w)));
            page.drawing.picture(at, &png_rgb(&two_colours(&still, &moved))?);
        }
    }
    Ok(page.drawing)
}

/// A part of the reference, in its pixels.
struct Detail {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
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

    /// Grey levels of `frame` there, resampled as merging does.
    fn grey(&self, frame: &Frame, warp: &Warp) -> Plane<u8> {
        let (columns, rows) = (self.x..self.x + self.width, self.y..self.y + self.height);
        let mut codes = vec![[0.0f32; 3]; self.width * self.height];
        resample_rows(frame, warp, columns, rows, &mut codes);
        let grey = |p: &[f32; 3]| ((54.0 * p[0] + 183.0 * p[1] + 19.0 * p[2]) / 256.0).clamp(0.0, 255.0) as u8;
        let codes = codes.iter().map(|p| if p[0] == OUTSIDE { 0 } else { grey(p) }).collect();
        Plane::from_vec(self.width, self.height, codes)
    }
}

/// In each of the picture's upright thirds the place where both have most edges; none where the photograph is hardly larger than that.
fn details(reference: &Plane<u8>, view: Option<&Plane<u8>>, size: (f64, f64), couple: &Couple) -> Vec<Detail> {
    let (full_w, full_h) = (couple.reference.width(), couple.reference.height());
    let width = ((size.0 - (DETAILS - 1) as f64 * DETAIL_GAP) / (DETAILS * MAGNIFIED) as f64) as usize;
    let height = width * 4 / 5;
    let Some(view) = view else { return Vec::new() };
    if width < 16 || full_w < DETAILS * width || full_h < height {
        return Vec::new();
    }
    let scale = reference.width() as f64 / full_w as f64;
    let (w, h) = (((width as f64 * scale) as usize).max(1), ((height as f64 * scale) as usize).max(1));
    let common = |x: usize, y: usize| -> u64 {
        let row = |v: usize| (x..(x + w).min(reference.width())).map(move |u| (u, v));
        (y..(y + h).min(reference.height()))
            .flat_map(row)
            .map(|(u, v)| u64::from(reference.at(u, v).min(view.at(u, v))))
            .sum()
    };
    let third = reference.width() / DETAILS;
    (0..DETAILS)
        .map(|i| {
            let columns = (i * third..=((i + 1) * third).saturating_sub(w).max(i * third)).step_by((w / 4).max(1));
            let places = columns
                .flat_map(|x| (0..=reference.height().saturating_sub(h)).step_by((h / 4).max(1)).map(move |y| (x, y)));
            // Of equals the first.
            let rated = places.map(|(x, y)| (common(x, y), x, y));
            let (_, x, y) = rated.reduce(|a, b| if b.0 > a.0 { b } else { a }).unwrap_or((0, 0, 0));
            let at = |v: usize, most: usize| ((v as f64 / scale) as usize).min(most);
            Detail { x: at(x, full_w - width), y: at(y, full_h - height), width, height }
        })
        .collect()
}

/// `small`, a reduced frame, on the reference's grid reduced alike; black where it does not reach.
fn laid(small: &Plane<u8>, warp: &Warp, reference: &Frame) -> Plane<u8> {
    let (width, height) = (small.width(), small.height());
    let h = warp.matrix(reference.width(), reference.height());
    let (sx, sy) = (reference.width() as f64 / width as f64, reference.height() as f64 / height as f64);
    Plane::from_rows(width, height, |y, row| {
        for (x, out) in row.iter_mut().enumerate() {
            let (u, v) = map(&h, (x as f64 + 0.5) * sx - 0.5, (y as f64 + 0.5) * sy - 0.5);
            let (u, v) = ((u + 0.5) / sx - 0.5, (v + 0.5) / sy - 0.5);
            let inside = u >= 0.0 && v >= 0.0 && u <= width as f64 - 1.0 && v <= height as f64 - 1.0;
            if inside {
                let (left, top) = (u as usize, v as usize);
                let (fx, fy) = (u - left as f64, v - top as f64);
                let (next, below) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
                let at = |x: usize, y: usize| f64::from(small.at(x, y));
                let upper = at(left, top) * (1.0 - fx) + at(next, top) * fx;
                let lower = at(left, below) * (1.0 - fx) + at(next, below) * fx;
                *out = (upper * (1.0 - fy) + lower * fy).round() as u8;
            }
        }
    })
}

/// Noise of codes near black is no edge: so many codes are added before the logarithm.
const BLACK: f64 = 8.0;
/// Smoothing before the differences are taken, in pixels.
const SMOOTHING: f64 = 0.8;
/// The share of the pixels whose edges are shown in full.
const STRONGEST: f64 = 0.02;

/// How strong the edge is at each pixel, 0..=255: Sobel's gradient of log(code), on the scale of the picture's strongest.
fn edges(grey: &Plane<u8>) -> Plane<u8> {
    let (width, height) = (grey.width(), grey.height());
    let levels: [f32; 256] = std::array::from_fn(|v| libm::log(v as f64 + BLACK) as f32);
    let log = Plane::from_rows(width, height, |y, row| {
        for (v, g) in row.iter_mut().zip(grey.row(y)) {
            *v = levels[usize::from(*g)];
        }
    });
    let smooth = crate::pyramid::gaussian(&log, SMOOTHING);
    let strength = Plane::from_rows(width, height, |y, row: &mut [f32]| {
        // At the border there is nothing to compare with.
        if y == 0 || y + 1 >= height || width < 3 {
            return;
        }
        let [above, here, below] = [y - 1, y, y + 1].map(|v| smooth.row(v));
        for x in 1..width - 1 {
            let across = |r: &[f32]| r[x + 1] - r[x - 1];
            let gx = across(above) + 2.0 * across(here) + across(below);
            let gy = below[x - 1] + 2.0 * below[x] + below[x + 1] - above[x - 1] - 2.0 * above[x] - above[x + 1];
            row[x] = (gx * gx + gy * gy).sqrt();
        }
    });
    let mut sorted = strength.as_slice().to_vec();
    sorted.sort_by(f32::total_cmp);
    let full = sorted[((sorted.len() - 1) as f64 * (1.0 - STRONGEST)) as usize].max(0.05);
    Plane::from_rows(width, height, |y, row| {
        for (v, s) in row.iter_mut().zip(strength.row(y)) {
            *v = (255.0 * (s / full).min(1.0)).round() as u8;
        }
    })
}

/// The edges of the reference and of the frame, each in its colour, added.
fn two_colours(reference: &Plane<u8>, frame: &Plane<u8>) -> Plane<[u8; 3]> {
    let (a, b) = ([REFERENCE.0, REFERENCE.1, REFERENCE.2], [FRAME.0, FRAME.1, FRAME.2]);
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
    use crate::align::scene::{Scene, Shot, rigid};

    fn mean_min(a: &Plane<u8>, b: &Plane<u8>) -> f64 {
        let pairs = a.as_slice().iter().zip(b.as_slice());
        pairs.map(|(x, y)| f64::from(*x.min(y))).sum::<f64>() / a.as_slice().len() as f64
    }

    #[test]
    fn edges_are_alike_in_two_exposures_and_coincide_once_aligned() {
        let (size, scene, truth) = ((360, 240), Scene::new(3), rigid(14.0, -9.0, 1.0));
        let reference = edges(&scene.photograph(size, &Warp::Identity, Shot::at(0.0)));
        let grey = scene.photograph(size, &truth, Shot::at(-2.0));
        let samples = crate::bracket::Samples::Eight(vec![0; 3 * size.0 * size.1]);
        let exposure = crate::bracket::exposure::Exposure::given(0.0).unwrap();
        let frame = Frame::new("x".into(), size.0, size.1, samples, exposure);
        let after = mean_min(&reference, &edges(&laid(&grey, &truth, &frame)));
        let (before, most) = (mean_min(&reference, &edges(&grey)), mean_min(&reference, &reference));
        assert!(after > 1.5 * before && after > 0.6 * most, "{before} {after} {most}");
    }

    #[test]
    fn the_colours_add_up_to_white() {
        let (none, full) = (Plane::filled(1, 1, 0u8), Plane::filled(1, 1, 255u8));
        assert_eq!(two_colours(&full, &full).at(0, 0), [255; 3]);
        assert_eq!(two_colours(&full, &none).at(0, 0), [255, 140, 0]);
        assert_eq!(two_colours(&none, &full).at(0, 0), [0, 115, 255]);
    }

    #[test]
    fn a_flat_picture_has_no_edges() {
        assert!(edges(&Plane::filled(20, 20, 3u8)).as_slice().iter().all(|v| *v == 0));
    }
}
