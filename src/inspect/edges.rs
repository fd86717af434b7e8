//! Edges: those of the reference and those of a frame in two colours that add up to white, before and after alignment.
//!
//! In: two frames and a warp. Out: a drawing: the whole picture on either side, and below it places with edges at twice their size, where
//! half a pixel is seen. Cost: two passes over the pictures at the size they are drawn. Exposures are made alike by the logarithm of
//! the grey levels and by the share of the strongest edges.

use super::drawing::{Anchor, Area, Colour, Drawing, Pen};
use super::page::{Entry, Mark, Page, TEXT};
use super::picture::{png_rgb, reduce};
use crate::align::Transform;
use crate::align::resampling::{OUTSIDE, resample_rows, rows_under};
use crate::align::transform::map;
use crate::bracket::Frame;
use crate::plane::Plane;
use crate::pyramid::gaussian;

/// The two colours add up to white.
const REFERENCE: Colour = Colour(255, 140, 0);
const FRAME: Colour = Colour(0, 115, 255);

/// Around what is shown larger.
pub(super) const BOX: Colour = Colour(255, 240, 0);

/// One side, in pixels of the page at the most.
pub(super) const SIDE: (usize, usize) = (780, 780);
/// Paper between the sides and the details.
const GAP: f64 = 16.0;
pub(super) const DETAIL_GAP: f64 = 8.0;
/// Room for the words above each side.
const NAMES: f64 = 26.0;
/// Details in a row below each side, and how many pixels of the page one of theirs takes.
const DETAILS: usize = 3;
pub(super) const MAGNIFIED: usize = 2;

/// Two frames, and where the one lies in the other.
pub(super) struct Couple<'a> {
    pub(super) reference: &'a Frame,
    pub(super) frame: &'a Frame,
    pub(super) reference_grey: &'a Plane<u8>,
    pub(super) frame_grey: &'a Plane<u8>,
    /// Reference pixel -> frame pixel; none where the frame was rejected.
    pub(super) warp: Option<Transform>,
}

/// The edges of the couple.
pub(super) fn draw(title: &str, couple: &Couple) -> Result<Drawing, String> {
    let whole = reduce(couple.reference_grey, SIDE);
    let magnified = (SIDE.0 / whole.width()).min(SIDE.1 / whole.height()).max(1) as f64;
    let size = (whole.width() as f64 * magnified, whole.height() as f64 * magnified);
    let reference = Grey::whole(whole).edges(LEAST_FULL);
    let moving = reduce(couple.frame_grey, SIDE);
    let after =
        couple.warp.map(|warp| (warp, "after: aligned", laid(&moving, &warp, couple.reference).edges(LEAST_FULL)));
    let before = (Transform::Identity, "before: as photographed", Grey::whole(moving).edges(LEAST_FULL));
    let views: Vec<(Transform, &str, Edges)> = [Some(before), after].into_iter().flatten().collect();
    let boxes =
        views.last().map_or_else(Vec::new, |(_, _, view)| details(&reference.strength, &view.strength, size, couple));

    let legend = [
        Entry { mark: Mark::Patch, colour: REFERENCE, words: "edges of the reference".into() },
        Entry { mark: Mark::Patch, colour: FRAME, words: "edges of the frame".into() },
        Entry { mark: Mark::Patch, colour: Colour::WHITE, words: "both".into() },
    ];
    let below = boxes.first().map_or(0.0, |b| DETAIL_GAP + (b.height * MAGNIFIED) as f64);
    let sides = views.len() as f64;
    let room = (sides * size.0 + (sides - 1.0) * GAP, NAMES + size.1 + below);
    let mut notes =
        "An edge in one colour alone: the other frame is burnt out or black there, or something moved.".to_owned();
    if !boxes.is_empty() {
        notes += &format!(" Below, the places that are boxed: {MAGNIFIED} px for one of the photograph's.");
    }
    if couple.warp.is_none() {
        notes += " The frame was left out: there is no after.";
    }
    let mut page = Page::new(title, &legend, room, &notes);
    for (k, (warp, words, view)) in views.iter().enumerate() {
        let corner = (page.corner.0 + k as f64 * (size.0 + GAP), page.corner.1 + NAMES);
        page.drawing.text((corner.0, corner.1 - 8.0), TEXT, Anchor::Start, Colour::INK, words);
        let area = Area { x: corner.0, y: corner.1, width: size.0, height: size.1 };
        page.drawing.picture(area, &png_rgb(&two_colours(&reference.strength, &view.strength))?);
        for (i, detail) in boxes.iter().enumerate() {
            let place = detail.on_page(corner, size, couple.reference);
            page.drawing.outline(place, Pen { colour: BOX, width: 1.6, opacity: 1.0 });
            let (width, height) = ((detail.width * MAGNIFIED) as f64, (detail.height * MAGNIFIED) as f64);
            let (x, y) = (corner.0 + i as f64 * (width + DETAIL_GAP), corner.1 + size.1 + DETAIL_GAP);
            let still =
                detail.grey(couple.reference, &Transform::Identity)?.edges(FAINT_DETAIL * reference.full).strength;
            let moved = detail.grey(couple.frame, warp)?.edges(FAINT_DETAIL * view.full).strength;
            page.drawing.picture(Area { x, y, width, height }, &png_rgb(&two_colours(&still, &moved))?);
        }
    }
    Ok(page.drawing)
}

/// A part of the reference, in its pixels.
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

    /// Grey levels of `frame` there, resampled as merging does.
    pub(super) fn grey(&self, frame: &Frame, warp: &Transform) -> Result<Grey, String> {
        let (columns, rows) = (self.x..self.x + self.width, self.y..self.y + self.height);
        let mut codes = vec![[0.0f32; 3]; self.width * self.height];
        let under = rows_under(warp, (frame.width(), frame.height()), &columns, &rows);
        let window = frame.window(under).map_err(|e| e.to_string())?;
        resample_rows(&window, warp, columns, rows, &mut codes);
        let grey = |p: &[f32; 3]| ((54.0 * p[0] + 183.0 * p[1] + 19.0 * p[2]) / 256.0).clamp(0.0, 255.0) as u8;
        let outside: Vec<bool> = codes.iter().map(|p| p[0] == OUTSIDE).collect();
        let levels = codes.iter().map(grey).collect();
        let plane = |values| Plane::from_vec(self.width, self.height, values);
        Ok(Grey { levels: plane(levels), outside: Some(Plane::from_vec(self.width, self.height, outside)) })
    }
}

/// Places with many edges in both, far from each other, from left to right; none where the photograph is hardly larger than they are.
pub(super) fn details(reference: &Plane<u8>, view: &Plane<u8>, size: (f64, f64), couple: &Couple) -> Vec<Detail> {
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
    // Beyond this, distance is no merit.
    let far = APART * ((across * across + down * down) as f64).sqrt();
    let mut chosen: Vec<(usize, usize)> = Vec::new();
    while chosen.len() < DETAILS {
        let apart = |a: (usize, usize), b: (usize, usize)| {
            let (dx, dy) = (a.0 as f64 - b.0 as f64, a.1 as f64 - b.1 as f64);
            ((dx * dx + dy * dy).sqrt() / far).min(1.0)
        };
        let merit = |(edges, at): (f64, (usize, usize))| chosen.iter().fold(edges, |m, c| m * apart(at, *c));
        // Of equals the first.
        let best = rated.iter().copied().reduce(|a, b| if merit(b) > merit(a) { b } else { a });
        chosen.push(best.map_or((0, 0), |b| b.1));
    }
    chosen.sort_unstable();
    let at = |v: usize, most: usize| ((v as f64 / scale) as usize).min(most);
    let detail = |(x, y)| Detail { x: at(x, full_w - width), y: at(y, full_h - height), width, height };
    chosen.into_iter().map(detail).collect()
}

/// Details this share of the diagonal apart are as far apart as need be.
const APART: f64 = 0.35;

/// `small`, a reduced frame, on the reference's grid reduced alike.
pub(super) fn laid(small: &Plane<u8>, warp: &Transform, reference: &Frame) -> Grey {
    let (width, height) = (small.width(), small.height());
    let h = warp.matrix(reference.width(), reference.height());
    let (sx, sy) = (reference.width() as f64 / width as f64, reference.height() as f64 / height as f64);
    let place = |x: usize, y: usize| {
        let (u, v) = map(&h, (x as f64 + 0.5) * sx - 0.5, (y as f64 + 0.5) * sy - 0.5);
        let (u, v) = ((u + 0.5) / sx - 0.5, (v + 0.5) / sy - 0.5);
        let inside = u >= 0.0 && v >= 0.0 && u <= width as f64 - 1.0 && v <= height as f64 - 1.0;
        inside.then_some((u, v))
    };
    let level = |(u, v): (f64, f64)| {
        let (left, top) = (u as usize, v as usize);
        let (fx, fy) = (u - left as f64, v - top as f64);
        let (next, below) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
        let at = |x: usize, y: usize| f64::from(small.at(x, y));
        let upper = at(left, top) * (1.0 - fx) + at(next, top) * fx;
        let lower = at(left, below) * (1.0 - fx) + at(next, below) * fx;
        (upper * (1.0 - fy) + lower * fy).round() as u8
    };
    let levels = Plane::from_rows(width, height, |y, row| {
        row.iter_mut().enumerate().for_each(|(x, out)| *out = place(x, y).map_or(0, level));
    });
    let outside = Plane::from_rows(width, height, |y, row| {
        row.iter_mut().enumerate().for_each(|(x, out)| *out = place(x, y).is_none());
    });
    Grey { levels, outside: Some(outside) }
}

/// A grey picture, and where it has nothing to show.
pub(super) struct Grey {
    levels: Plane<u8>,
    outside: Option<Plane<bool>>,
}

/// Noise of codes near black is no edge: so many codes are added before the logarithm.
const BLACK: f64 = 8.0;
/// Smoothing before the differences are taken, in pixels.
const SMOOTHING: f64 = 0.8;
/// The share of the pixels whose edges are shown in full.
const STRONGEST: f64 = 0.02;
/// In a picture without contrast noise stays faint: so much is shown in full at the least.
pub(super) const LEAST_FULL: f32 = 0.05;

/// In a detail the same, as a share of what is shown in full in the whole.
pub(super) const FAINT_DETAIL: f32 = 0.6;

/// How strong the edge is at each pixel.
pub(super) struct Edges {
    /// 0..=255.
    pub(super) strength: Plane<u8>,
    /// Sobel's gradient of log(code) that is shown as 255.
    pub(super) full: f32,
}

/// So many pixels about what is outside, what was smoothed and compared reaches it.
const REACH: usize = 3;

impl Grey {
    pub(super) fn whole(levels: Plane<u8>) -> Self {
        Grey { levels, outside: None }
    }

    /// The edges, those that are as strong as `least` or as the picture's strongest shown in full, whichever is more.
    pub(super) fn edges(&self, least: f32) -> Edges {
        let (width, height) = (self.levels.width(), self.levels.height());
        let logarithms: [f32; 256] = std::array::from_fn(|v| libm::log(v as f64 + BLACK) as f32);
        let log = Plane::from_rows(width, height, |y, row| {
            for (v, g) in row.iter_mut().zip(self.levels.row(y)) {
                *v = logarithms[usize::from(*g)];
            }
        });
        let smooth = gaussian(&log, SMOOTHING);
        let strength = Plane::from_rows(width, height, |y, row: &mut [f32]| {
            // At the border there is nothing to compare with.
            if y == 0 || y + 1 >= height || width < 3 {
                return;
            }
            let [above, here, below] = [y - 1, y, y + 1].map(|v| smooth.row(v));
            for x in (1..width - 1).filter(|&x| self.is_inside(x, y)) {
                let across = |r: &[f32]| r[x + 1] - r[x - 1];
                let gx = across(above) + 2.0 * across(here) + across(below);
                let gy = below[x - 1] + 2.0 * below[x] + below[x + 1] - above[x - 1] - 2.0 * above[x] - above[x + 1];
                row[x] = (gx * gx + gy * gy).sqrt();
            }
        });
        let mut sorted = strength.as_slice().to_vec();
        sorted.sort_unstable_by(f32::total_cmp);
        let full = sorted[((sorted.len() - 1) as f64 * (1.0 - STRONGEST)) as usize].max(least);
        let strength = Plane::from_rows(width, height, |y, row| {
            for (v, s) in row.iter_mut().zip(strength.row(y)) {
                *v = (255.0 * (s / full).min(1.0)).round() as u8;
            }
        });
        Edges { strength, full }
    }

    /// Whether nothing outside the frame is near.
    fn is_inside(&self, x: usize, y: usize) -> bool {
        let Some(outside) = &self.outside else { return true };
        let near = |v: usize, n: usize| v.saturating_sub(REACH)..(v + REACH + 1).min(n);
        let columns = near(x, outside.width());
        near(y, outside.height()).all(|row| outside.row(row)[columns.clone()].iter().all(|o| !o))
    }
}

/// The edges of the reference and of the frame, each in its colour, added.
pub(super) fn two_colours(reference: &Plane<u8>, frame: &Plane<u8>) -> Plane<[u8; 3]> {
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
        let reference =
            Grey::whole(scene.photograph(size, &Transform::Identity, Shot::at(0.0))).edges(LEAST_FULL).strength;
        let grey = scene.photograph(size, &truth, Shot::at(-2.0));
        let samples = crate::bracket::Samples::Eight(vec![0; 3 * size.0 * size.1]);
        let exposure = crate::bracket::exposure::Exposure::given(0.0).unwrap();
        let frame = Frame::new("x".into(), size.0, size.1, samples, exposure);
        let after = laid(&grey, &truth, &frame).edges(LEAST_FULL).strength;
        // The edge of what was photographed is no edge of the scene.
        // With 14 px to the right and 1 deg it lies at columns 343 to 347.
        assert!((0..size.1).all(|y| after.row(y)[345..].iter().all(|v| *v == 0)));
        let after = mean_min(&reference, &after);
        let (before, most) =
            (mean_min(&reference, &Grey::whole(grey).edges(LEAST_FULL).strength), mean_min(&reference, &reference));
        // What is left is noise, resampling, and a strip of 14 of 360 px that the frame does not reach.
        assert!(most - after < 0.5 * (most - before), "{before} {after} {most}");
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
        assert!(Grey::whole(Plane::filled(20, 20, 3u8)).edges(LEAST_FULL).strength.as_slice().iter().all(|v| *v == 0));
    }
}
