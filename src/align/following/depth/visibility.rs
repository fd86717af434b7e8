//! Visibility: which pixels of the reference something nearer hides in a frame.
//!
//! In: the depth of each pixel, the cameras, and the frames on one level. Out: for each frame, the [`Visibility`] of
//! each pixel. Cost: some twenty operations for each pixel and frame. Source: the depth buffer (Catmull, "A Subdivision
//! Algorithm for Computer Display of Curved Surfaces", 1974).
//!
//! Two pixels of the reference that a frame would show at the same position are a conflict: the frame shows only the
//! nearer one. Displacements alone do not tell which of two depths is nearer, but the conflicts do: the frame has the
//! grey value of the nearer pixel. A frame that has the grey value of the farther pixel as well hides nothing that can
//! be seen: depths of surfaces without detail are guesses, and so are their conflicts.

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
/// Grey values that differ by no more than this are the same, because of noise and of the intensity map. Measured: 4
/// to 16 differ by less than 0.1 dB in the merge.
const SAME_GREY: f32 = 8.0;
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
    let visibility = |(camera, grey): (&Option<Camera>, &&Plane<u8>)| {
        let camera = camera.as_ref()?;
        Some(Shown::new(depths, camera).visibility(camera, depths, [reference, grey], is_high_near))
    };
    cameras.iter().zip(greys).map(visibility).collect()
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

    /// The pixels of the frame at which pixels on different surfaces are in conflict.
    fn conflicts(&self) -> impl Iterator<Item = usize> {
        let [low, high] = &self.from;
        (0..low.len()).filter(|&p| low[p] != NONE && self.are_apart(low[p], high[p]))
    }

    /// Grey values of the reference to those of the `frame`, from some pixels without conflicts.
    fn intensity_map(&self, reference: &Plane<u8>, frame: &Plane<u8>) -> IntensityMap {
        let [low, high] = &self.from;
        let agree = |&p: &usize| low[p] != NONE && !self.are_apart(low[p], high[p]);
        let pair = |p: usize| (reference.as_slice()[high[p] as usize], frame.as_slice()[p]);
        let pairs: Vec<(u8, u8)> = (0..low.len()).step_by(EVERY).filter(agree).map(pair).collect();
        IntensityMap::from_samples(&pairs)
    }

    /// By how much better the pixels with the higher depth explain the grey values of the `frame` where there are
    /// conflicts.
    fn score(&self, reference: &Plane<u8>, frame: &Plane<u8>) -> f64 {
        let [low, high] = &self.from;
        let map = self.intensity_map(reference, frame);
        let difference = |p: usize, from: &[u32]| {
            let expected = map.at(f32::from(reference.as_slice()[from[p] as usize]));
            f64::from((expected - f32::from(frame.as_slice()[p])).abs().min(MOST_DIFFERENCE))
        };
        self.conflicts().map(|p| difference(p, low) - difference(p, high)).sum()
    }

    /// How the frame shows the pixels of the reference.
    fn visibility(
        &self,
        camera: &Camera,
        depths: &Plane<f32>,
        [reference, frame]: [&Plane<u8>; 2],
        is_high_near: bool,
    ) -> Plane<Visibility> {
        let (width, height) = self.size;
        let map = self.intensity_map(reference, frame);
        let (near, sign) = (&self.from[usize::from(is_high_near)], if is_high_near { 1.0 } else { -1.0 });
        let depth = |i: u32| sign * depths.as_slice()[i as usize];
        let hidden = Plane::from_rows(width, height, |y, row| {
            for (x, is_hidden) in row.iter_mut().enumerate() {
                let i = (y * width + x) as u32;
                let grey = reference.at(x, y);
                let differs =
                    |&(u, v): &(usize, usize)| (map.at(f32::from(grey)) - f32::from(frame.at(u, v))).abs() > SAME_GREY;
                let at = shown_at(camera, x, y, depths.at(x, y), self.size).filter(|_| is_usable(grey));
                let Some((u, v)) = at.filter(differs) else { continue };
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3x4;

    /// Width of the square of the test: it covers the columns 40 to 59 in the reference and moves 10 to the right.
    const MOVED: usize = 10;

    /// How many pixels of the reference are hidden, and how many are mixed, if a square of brightness `near` moves
    /// before a scene with brightness 100 and a little noise.
    fn hidden_and_mixed(near: u8) -> (usize, usize) {
        let size = 100;
        let plane = |left: usize| {
            Plane::from_rows(size, size, |y, row: &mut [u8]| {
                for (x, grey) in row.iter_mut().enumerate() {
                    let is_near = (left..left + 20).contains(&x) && (40..60).contains(&y);
                    *grey = if is_near { near } else { 100 } + ((7 * x + 3 * y) % 5) as u8;
                }
            })
        };
        let depths = Plane::from_rows(size, size, |y, row| {
            for (x, q) in row.iter_mut().enumerate() {
                *q = f32::from(u8::from((40..60).contains(&x) && (40..60).contains(&y)));
            }
        });
        let (reference, frame) = (plane(40), plane(40 + MOVED));
        let by = MOVED as f64;
        let camera = Camera::new(Matrix3x4::new(1.0, 0.0, 0.0, by, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0));
        let found = of(&depths, &reference, &[&frame], &[Some(camera)]).remove(0).unwrap();
        let count = |v: Visibility| found.as_slice().iter().filter(|&&w| w == v).count();
        (count(Visibility::Hidden), count(Visibility::Mixed))
    }

    #[test]
    fn what_has_another_grey_value_hides_what_is_behind_it() {
        let (hidden, mixed) = hidden_and_mixed(180);
        // The frame shows the square 10 columns to the right of its edge in the reference; one pixel more may be
        // hidden on each side, because a conflict is within 1.5 pixels.
        assert!((MOVED * 20..=(MOVED + 1) * 22).contains(&hidden), "{hidden}");
        assert!(mixed > 40, "{mixed}");
        assert_eq!(hidden_and_mixed(100), (0, 0));
    }
}
