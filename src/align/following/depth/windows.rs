//! Windows near jumps: each pixel gets the costs of a window that is on its own surface.
//!
//! In: a [`CostVolume`], the first [`Choice`]s, and the reference. Out: other costs of the pixels near jumps. Cost:
//! about two thousand operations for each of them. Source: shifted windows (Fusiello, Roberto & Trucco, "Efficient
//! Stereo with Multiple Windowing", CVPR 1997), selected by the grey values of the reference.
//!
//! A window across the outline of a near thing has the depth of the near thing, on both sides of the outline. So a
//! pixel takes the window with most pixels like itself, among those that contain it. If nothing can be seen in that
//! window, as in a clipped sky, the pixel keeps its own window, without what the surface on the other side explains. An
//! outline that only the own surface explains remains: that of a bright or black thing without detail.

use crate::align::following::depth::cost_volume::{CostVolume, NOISE, RADIUS, SIDE};
use crate::align::following::depth::jumps;
use crate::align::following::depth::semi_global::Choice;
use crate::plane::Plane;
use rayon::prelude::*;
use std::ops::Range;

/// Windows are selected up to this far from a jump. A jump is displaced by at most the radius of a window.
const REACH: usize = 2 * RADIUS;
/// A pixel counts half if its grey value differs by this.
const LIKE: f32 = 20.0;
/// A window that is one pixel farther away is as good if it has this many pixels more that are like the pixel.
const DISTANCE: f32 = 0.3;
/// The windows on the other side are up to this far away.
const OTHER: usize = SIDE - 1;
/// Side of the square of the centres of windows.
const CENTRES: usize = 2 * OTHER + 1;
/// Side of the square of the pixels of these windows.
const PIXELS: usize = CENTRES + SIDE - 1;
/// Width of the border of a [`Padded`] picture.
const BORDER: usize = PIXELS / 2;
/// Number of rows whose costs are replaced together, at least [`OTHER`].
const ROWS: usize = 32;

/// Replaces the costs of the pixels near jumps.
pub(super) fn select(volume: &mut CostVolume, choices: &Plane<Choice>, grey: &Plane<u8>) {
    let is_near = jumps::around(choices, REACH);
    let (like, padded) = (likeness(), Padded::new(grey));
    let (width, height) = (volume.width, volume.height);
    // The windows of a pixel are at most `OTHER` rows away, so the costs of some rows are replaced when those of the
    // next ones are known.
    let mut before = (0..0, Vec::new());
    for first in (0..height).step_by(ROWS) {
        let rows = first..(first + ROWS).min(height);
        let costs = |y: usize| -> Vec<u8> {
            let near = (0..width).filter(|&x| is_near.at(x, y));
            near.flat_map(|x| Selected::at(x, y, &padded, &like).costs(y * width + x, volume)).collect()
        };
        let here = rows.clone().into_par_iter().map(costs).collect();
        replace(volume, &is_near, std::mem::replace(&mut before, (rows, here)));
    }
    replace(volume, &is_near, before);
}

/// How much a pixel counts that differs by so many grey values.
fn likeness() -> [f32; 256] {
    std::array::from_fn(|d| {
        let square = (d as f32 / LIKE) * (d as f32 / LIKE);
        1.0 / (1.0 + square * square)
    })
}

/// Replaces the costs of the pixels of `rows` that are near jumps.
fn replace(volume: &mut CostVolume, is_near: &Plane<bool>, (rows, costs): (Range<usize>, Vec<Vec<u8>>)) {
    let (width, labels) = (volume.width, volume.labels);
    for (y, costs) in rows.zip(costs) {
        let near = (0..width).filter(|&x| is_near.at(x, y));
        for (x, costs) in near.zip(costs.chunks_exact(labels)) {
            volume.costs[(y * width + x) * labels..][..labels].copy_from_slice(costs);
        }
    }
}

/// The windows of a pixel, by the pixels at their centres.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Selected {
    /// The window with most pixels like the pixel.
    own: usize,
    /// Whether there is detail in it.
    has_detail: bool,
    /// The window with fewest pixels like the pixel.
    other: usize,
}

impl Selected {
    /// Selects the windows of the pixel (x, y). `like` is how much a pixel with a grey value that differs counts.
    fn at(x: usize, y: usize, grey: &Padded, like: &[f32; 256]) -> Self {
        let here = grey.around(x, y, 0)[BORDER];
        // How like the pixel the pixels around it are: sums over the rows of windows, then over windows.
        let along: [[f32; CENTRES]; PIXELS] = std::array::from_fn(|j| {
            let row = grey.around(x, y, j as isize - BORDER as isize);
            let likes: [f32; PIXELS] = std::array::from_fn(|i| like[usize::from(row[i].abs_diff(here))]);
            std::array::from_fn(|i| likes[i] + likes[i + 1] + likes[i + 2] + likes[i + 3] + likes[i + 4])
        });
        let sums: [[f32; CENTRES]; CENTRES] = std::array::from_fn(|j| {
            std::array::from_fn(|i| along[j][i] + along[j + 1][i] + along[j + 2][i] + along[j + 3][i] + along[j + 4][i])
        });
        let (mut own, mut other) = ((f32::MIN, x, y), (f32::MAX, x, y));
        for (j, v) in Padded::centres(y, grey.height) {
            for (i, u) in Padded::centres(x, grey.width) {
                let away = DISTANCE * (u.abs_diff(x) + v.abs_diff(y)) as f32;
                if u.abs_diff(x) <= RADIUS && v.abs_diff(y) <= RADIUS && sums[j][i] - away > own.0 {
                    own = (sums[j][i] - away, u, v);
                }
                if sums[j][i] + away < other.0 {
                    other = (sums[j][i] + away, u, v);
                }
            }
        }
        let index = |u, v| v * grey.width + u;
        let has_detail = grey.variance(own.1, own.2) >= NOISE;
        Selected { own: index(own.1, own.2), has_detail, other: index(other.1, other.2) }
    }

    /// The costs of pixel `i`, which selected these windows.
    fn costs(self, i: usize, volume: &CostVolume) -> Vec<u8> {
        if self.has_detail {
            return volume.at(self.own).to_vec();
        }
        let unknown = volume.unknown();
        let without = |(&own, &other): (&u8, &u8)| own.saturating_add(unknown.saturating_sub(other)).min(unknown);
        volume.at(i).iter().zip(volume.at(self.other)).map(without).collect()
    }
}

/// A picture with a border, in which the pixels at its sides are repeated.
struct Padded {
    /// Size without the border.
    width: usize,
    height: usize,
    plane: Plane<u8>,
}

impl Padded {
    fn new(grey: &Plane<u8>) -> Self {
        let (width, height) = (grey.width(), grey.height());
        let inside = |at: usize, size: usize| at.saturating_sub(BORDER).min(size - 1);
        let plane = Plane::from_rows(width + 2 * BORDER, height + 2 * BORDER, |y, row: &mut [u8]| {
            let from = grey.row(inside(y, height));
            row.iter_mut().enumerate().for_each(|(x, v)| *v = from[inside(x, width)]);
        });
        Padded { width, height, plane }
    }

    /// The pixels from `BORDER` columns before to `BORDER` columns after (x, y + dy).
    #[inline]
    fn around(&self, x: usize, y: usize, dy: isize) -> &[u8] {
        &self.plane.row((y + BORDER).wrapping_add_signed(dy))[x..x + PIXELS]
    }

    /// The centres of windows around the position `at` that do not reach beyond a picture of this `size`: their
    /// numbers, and their positions.
    fn centres(at: usize, size: usize) -> impl Iterator<Item = (usize, usize)> {
        let centre = move |i: usize| Some((i, (at + i).checked_sub(OTHER)?));
        let inside = RADIUS..size.saturating_sub(RADIUS);
        (0..CENTRES).filter_map(centre).filter(move |(_, at)| inside.contains(at))
    }

    /// The variance of the grey values of the window around (x, y).
    fn variance(&self, x: usize, y: usize) -> f32 {
        let (mut sum, mut squares) = (0u32, 0u32);
        for dy in 0..SIDE {
            for &g in &self.around(x, y, dy as isize - RADIUS as isize)[BORDER - RADIUS..=BORDER + RADIUS] {
                sum += u32::from(g);
                squares += u32::from(g) * u32::from(g);
            }
        }
        let mean = sum as f32 / (SIDE * SIDE) as f32;
        squares as f32 / (SIDE * SIDE) as f32 - mean * mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::scene::uniform;

    /// A bright surface with detail right of column 20, and a dark one left of it.
    fn picture(detail: f64) -> Plane<u8> {
        Plane::from_rows(40, 24, |y, row: &mut [u8]| {
            for (x, v) in row.iter_mut().enumerate() {
                let noise = (detail * uniform(2, x as i64, y as i64)) as u8;
                *v = if x < 20 { 40 } else { 180 + noise };
            }
        })
    }

    #[test]
    fn windows_do_not_cross_the_outline() {
        let grey = Padded::new(&picture(20.0));
        for x in 14..26 {
            let found = Selected::at(x, 12, &grey, &likeness());
            let (own, other) = (found.own % 40, found.other % 40);
            // The window of a pixel beside the outline is moved by as much as needed.
            assert_eq!(own, if x < 20 { x.min(17) } else { x.max(22) }, "column {x}");
            if (16..24).contains(&x) {
                // So is that of the other side, which is at most four columns away.
                assert_eq!(other, if x < 20 { (x + 4).min(22) } else { (x - 4).max(17) }, "column {x}");
            }
            assert_eq!(found.has_detail, x >= 20, "column {x}");
        }
    }

    #[test]
    fn outline_belongs_to_the_surface_that_explains_it() {
        let (width, height, labels) = (40, 24, 6);
        let grey = picture(20.0);
        let choices = Plane::from_rows(width, height, |_, row: &mut [Choice]| {
            for (x, c) in row.iter_mut().enumerate() {
                *c = Choice { label: if x < 18 { 1.0 } else { 4.0 }, certainty: 1.0 };
            }
        });
        // The bright surface has label `bright`; windows across the outline have label 4; the dark one says nothing.
        let volume = |bright: usize| {
            let mut volume = CostVolume { width, height, labels, costs: Vec::new(), scale: 40.0 };
            let cost = |i: usize| {
                let explains = match (i / labels) % width {
                    0..18 => false,
                    18..22 => i % labels == 4,
                    _ => i % labels == bright,
                };
                if explains { 100 } else { volume.unknown() }
            };
            volume.costs = (0..width * height * labels).map(cost).collect();
            volume
        };
        let selected = |bright: usize| {
            let mut volume = volume(bright);
            select(&mut volume, &choices, &grey);
            let unknown = volume.unknown();
            let costs = move |x: usize| volume.at(12 * width + x).to_vec();
            (costs, unknown)
        };
        // The bright surface is the near one: what the dark side knows of the outline is due to it.
        let (costs, unknown) = selected(4);
        assert_eq!((costs(18), costs(19)), (vec![unknown; labels], vec![unknown; labels]));
        // The dark surface is the near one: its outline shows its depth, and the bright surface has its own.
        let (costs, unknown) = selected(1);
        assert_eq!((costs(19)[4], costs(19)[1]), (100, unknown));
        assert_eq!((costs(20)[4], costs(20)[1]), (unknown, 100));
    }
}
