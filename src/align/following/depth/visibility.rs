//! Visibility: which pixels of the reference something nearer hides in a frame.
//!
//! In: the depth of each pixel, the cameras, and the frames on one level. Out: for each frame, the [`Visibility`] of
//! each pixel. Cost: some twenty operations for each pixel and frame. Source: the depth buffer (Catmull, "A Subdivision
//! Algorithm for Computer Display of Curved Surfaces", 1974).
//!
//! Two pixels of the reference that a frame would show at the same position are a conflict: the frame shows only the
//! nearer one. Displacements alone do not tell which of two depths is nearer, but the conflicts do: the frame has the
//! grey value of the nearer pixel.

use crate::align::following::depth::cost_volume::is_usable;
use crate::align::motion::camera::Camera;
use crate::align::motion::relief::Visibility;
use crate::align::photometric::IntensityMap;
use crate::plane::Plane;
use crate::pyramid::cells::grown_by;

/// Pixels of the reference at a greater distance than this from each other that a frame shows within 1.5 pixels are on
/// different surfaces. In pixels of the level.
const APART: f32 = 3.0;
/// Largest difference of grey values that counts in a conflict; larger ones count as much.
const MOST_DIFFERENCE: f32 = 30.0;
/// The pixels around hidden ones show a little of both surfaces. This is the width of the area around hidden pixels in
/// which pixels count as mixed, in pixels of the level.
const MARGIN: usize = 2;
/// One of this many pixels is a sample for the intensity map of a frame.
const EVERY: usize = 16;
/// Number of a pixel of the frame that shows no pixel of the reference.
const NONE: u32 = u32::MAX;

/// Returns for each frame that has a camera how it shows the pixels of the reference. `greys` are the frames. Where the
/// reference is black or clipped, its depth is a guess, so no pixel counts as hidden.
pub(super) fn of(
    depths: &Plane<f32>,
    reference: &Plane<u8>,
    greys: &[&Plane<u8>],
    cameras: &[Option<Camera>],
) -> Vec<Option<Plane<Visibility>>> {
    // The tables of a frame are computed twice, because those of all frames would take much memory.
    let score = |(camera, grey): (&Option<Camera>, &&Plane<u8>)| {
        camera.as_ref().map(|camera| Shown::new(depths, camera).score(reference, grey))
    };
    let is_high_near = cameras.iter().zip(greys).filter_map(score).sum::<f64>() >= 0.0;
    let visibility = |camera: &Option<Camera>| {
        camera.as_ref().map(|camera| Shown::new(depths, camera).visibility(camera, depths, reference, is_high_near))
    };
    cameras.iter().map(visibility).collect()
}

/// The pixel of a frame of `size` that shows the pixel (x, y) of the reference with relative depth `q`; none outside.
fn shown_at(camera: &Camera, x: usize, y: usize, q: f32, size: (usize, usize)) -> Option<(usize, usize)> {
    let (u, v) = camera.position(x as f64, y as f64, f64::from(q));
    let (u, v) = (u + 0.5, v + 0.5);
    let is_inside = u >= 0.0 && v >= 0.0 && u < size.0 as f64 && v < size.1 as f64;
    is_inside.then_some((u as usize, v as usize))
}

/// The pixels of the reference that a frame shows.
struct Shown {
    /// Width and height of the reference and of the frame.
    size: (usize, usize),
    /// For each pixel of the frame, the pixels of the reference with the lowest and with the highest depth.
    from: [Vec<u32>; 2],
}

impl Shown {
    fn new(depths: &Plane<f32>, camera: &Camera) -> Self {
        let size = (depths.width(), depths.height());
        let depth = |i: u32| depths.as_slice()[i as usize];
        let mut from = [vec![NONE; size.0 * size.1], vec![NONE; size.0 * size.1]];
        for (y, row) in depths.as_slice().chunks_exact(size.0).enumerate() {
            for (x, &q) in row.iter().enumerate() {
                let Some((u, v)) = shown_at(camera, x, y, q, size) else { continue };
                let [low, high] = from.each_mut().map(|from| &mut from[v * size.0 + u]);
                let i = (y * size.0 + x) as u32;
                if *low == NONE || q < depth(*low) {
                    *low = i;
                }
                if *high == NONE || q > depth(*high) {
                    *high = i;
                }
            }
        }
        Shown { size, from }
    }

    /// Whether the pixels `a` and `b` of the reference are on different surfaces, if the frame shows both within 1.5
    /// pixels.
    fn are_apart(&self, a: u32, b: u32) -> bool {
        let of = |i: u32| ((i as usize % self.size.0) as f32, (i as usize / self.size.0) as f32);
        let (a, b) = (of(a), of(b));
        (a.0 - b.0) * (a.0 - b.0) + (a.1 - b.1) * (a.1 - b.1) > APART * APART
    }

    /// By how much better the pixels with the higher depth explain the grey values of the `frame` where there are
    /// conflicts.
    fn score(&self, reference: &Plane<u8>, frame: &Plane<u8>) -> f64 {
        let (reference, frame) = (reference.as_slice(), frame.as_slice());
        let [low, high] = &self.from;
        let (mut conflicts, mut pairs) = (Vec::new(), Vec::new());
        for p in (0..frame.len()).filter(|&p| low[p] != NONE) {
            if self.are_apart(low[p], high[p]) {
                conflicts.push(p);
            } else if p.is_multiple_of(EVERY) {
                pairs.push((reference[high[p] as usize], frame[p]));
            }
        }
        let map = IntensityMap::from_samples(&pairs);
        let difference = |p: usize, from: &[u32]| {
            let expected = map.at(f32::from(reference[from[p] as usize]));
            (expected - f32::from(frame[p])).abs().min(MOST_DIFFERENCE)
        };
        conflicts.iter().map(|&p| f64::from(difference(p, low) - difference(p, high))).sum()
    }

    /// How the frame shows the pixels of the reference.
    fn visibility(
        &self,
        camera: &Camera,
        depths: &Plane<f32>,
        reference: &Plane<u8>,
        is_high_near: bool,
    ) -> Plane<Visibility> {
        let (width, height) = self.size;
        let (near, sign) = (&self.from[usize::from(is_high_near)], if is_high_near { 1.0 } else { -1.0 });
        let depth = |i: u32| sign * depths.as_slice()[i as usize];
        let hidden = Plane::from_rows(width, height, |y, row| {
            for (x, is_hidden) in row.iter_mut().enumerate() {
                let i = (y * width + x) as u32;
                let at = shown_at(camera, x, y, depths.at(x, y), self.size);
                let Some((u, v)) = at.filter(|_| is_usable(reference.at(x, y))) else { continue };
                let around = (v.saturating_sub(1)..(v + 2).min(height))
                    .flat_map(|v| (u.saturating_sub(1)..(u + 2).min(width)).map(move |u| v * width + u));
                *is_hidden = around.map(|p| near[p]).any(|j| j != NONE && depth(j) > depth(i) && self.are_apart(i, j));
            }
        });
        let is_beside = grown_by(&hidden, MARGIN);
        Plane::from_rows(width, height, |y, row| {
            for (x, visibility) in row.iter_mut().enumerate() {
                *visibility = match (hidden.at(x, y), is_beside.at(x, y)) {
                    (true, _) => Visibility::Hidden,
                    (false, true) => Visibility::Mixed,
                    (false, false) => Visibility::Shown,
                };
            }
        })
    }
}
