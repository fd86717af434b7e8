//! Agreement: whether a warp is right, tile by tile, by a measure that no stage before has optimised.
//!
//! In: two frames at a common exposure and a warp. Out: how many tiles of the picture bear it out, how many contradict it, and by how much
//! those that bear it out are off. Cost: 49 multiply-adds a pixel. Source: normalised cross-correlation (Lewis, "Fast Normalized
//! Cross-Correlation", Vision Interface 1995), blind to gain and offset, within a few pixels about the place.

use super::intensity_map::CommonExposure;
use super::refine::cubic;
use super::warp::map;
use crate::plane::{Plane, map_bands};
use nalgebra::Matrix3;

/// Tiles along the long side.
const TILES: usize = 16;
/// How far around its place a tile is sought, in pixels.
const REACH: isize = 3;
/// A tile says something where its trusted pixels' standard deviation is at least so many grey levels.
const LEAST_CONTRAST: f32 = 2.5;
/// ... and at least so many can be trusted: a lamp in the night is enough.
const LEAST_TRUSTED: usize = 64;
/// Trust below which a pixel does not count.
const TRUSTED: f32 = 0.01;

/// What the tiles say of a warp.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Agreement {
    /// Tiles whose best match is where the warp puts it.
    pub confirm: usize,
    /// Tiles with as much structure that match elsewhere, or nowhere.
    pub contradict: usize,
    /// Tiles too plain, too dark, too bright, or outside the frame.
    pub silent: usize,
    /// Of the nine parts of the picture (three by three), those in which a tile confirms.
    pub parts: usize,
    /// The median distance by which the confirming tiles are off, in pixels of the planes.
    pub offset: f64,
    /// The mean correlation of those that are not silent, -1..=1.
    pub correlation: f64,
}

impl Agreement {
    /// The share of the outspoken tiles that confirm, as if five more had spoken of which one and a half confirm: few voices are little.
    pub fn share(&self) -> f64 {
        (self.confirm as f64 + 1.5) / ((self.confirm + self.contradict) as f64 + 5.0)
    }

    /// How far the confirming tiles stand for the whole picture, 1/2..=1.
    pub fn coverage(&self) -> f64 {
        0.5 + 0.5 * self.parts.min(ENOUGH_PARTS) as f64 / ENOUGH_PARTS as f64
    }
}

/// Where tiles confirm in fewer parts of the picture than this, what lies in the others is only inferred.
const ENOUGH_PARTS: usize = 4;

/// How far the two frames agree under `h`, reference -> frame, in pixels of the planes.
pub fn measure(both: &CommonExposure, h: &Matrix3<f64>) -> Agreement {
    let (width, height) = (both.reference.width(), both.reference.height());
    let warped = Plane::from_rows(width, height, |y, row| {
        for (x, v) in row.iter_mut().enumerate() {
            let (u, w) = map(h, x as f64, y as f64);
            *v = cubic(&both.frame, u, w).unwrap_or(f32::NAN);
        }
    });
    let side = width.max(height).div_ceil(TILES).max(8);
    let (columns, rows) = (width / side, height / side);
    // One task a tile; bands of one row each serve as the indexed map.
    let tiles: Vec<Tile> = map_bands(rows * columns, |range| {
        range.map(|i| judge(both, &warped, i % columns * side, i / columns * side, side)).collect::<Vec<_>>()
    })
    .concat();
    let mut sum = Agreement::default();
    let mut offsets = Vec::new();
    let mut correlations = 0.0;
    let mut parts = [false; 9];
    for (i, tile) in tiles.iter().enumerate() {
        match *tile {
            Tile::Silent => sum.silent += 1,
            Tile::Confirms { offset, correlation } => {
                sum.confirm += 1;
                parts[i / columns * 3 / rows * 3 + i % columns * 3 / columns] = true;
                offsets.push(offset);
                correlations += f64::from(correlation);
            }
            Tile::Contradicts { correlation } => {
                sum.contradict += 1;
                correlations += f64::from(correlation);
            }
        }
    }
    sum.parts = parts.iter().filter(|&&p| p).count();
    offsets.sort_by(f32::total_cmp);
    sum.offset = offsets.get(offsets.len() / 2).copied().map_or(0.0, f64::from);
    sum.correlation = correlations / (sum.confirm + sum.contradict).max(1) as f64;
    sum
}

#[derive(Debug, Clone, Copy)]
enum Tile {
    Silent,
    Confirms { offset: f32, correlation: f32 },
    Contradicts { correlation: f32 },
}

fn judge(both: &CommonExposure, warped: &Plane<f32>, left: usize, top: usize, side: usize) -> Tile {
    let (width, height) = (warped.width() as isize, warped.height() as isize);
    // The tile's trusted pixels, less their mean.
    let mut pixels = Vec::with_capacity(side * side);
    for y in top..top + side {
        for x in left..left + side {
            let v = both.reference.at(x, y);
            if both.trust(v) >= TRUSTED {
                pixels.push((x as isize, y as isize, v));
            }
        }
    }
    if pixels.len() < LEAST_TRUSTED {
        return Tile::Silent;
    }
    let n = pixels.len() as f32;
    let mean = pixels.iter().map(|p| p.2).sum::<f32>() / n;
    pixels.iter_mut().for_each(|p| p.2 -= mean);
    let energy: f32 = pixels.iter().map(|p| p.2 * p.2).sum();
    if energy < LEAST_CONTRAST * LEAST_CONTRAST * n {
        return Tile::Silent;
    }
    // Correlation at every shift; none where the frame does not reach.
    const SPAN: usize = 2 * REACH as usize + 1;
    let mut correlation = [[f32::NAN; SPAN]; SPAN];
    for (j, row) in correlation.iter_mut().enumerate() {
        for (i, c) in row.iter_mut().enumerate() {
            let (dx, dy) = (i as isize - REACH, j as isize - REACH);
            let (mut sum, mut squares, mut product) = (0.0f32, 0.0f32, 0.0f32);
            for &(x, y, v) in &pixels {
                let (u, w) = (x + dx, y + dy);
                if u < 0 || w < 0 || u >= width || w >= height {
                    sum = f32::NAN;
                    break;
                }
                let f = warped.at(u as usize, w as usize);
                sum += f;
                squares += f * f;
                product += v * f;
            }
            let variance = squares - sum * sum / n;
            // A frame without structure where the reference has some agrees with nothing.
            *c = if variance.is_nan() { f32::NAN } else { product / (energy * variance.max(0.25 * n)).sqrt() };
        }
    }
    let centre = REACH as usize;
    let here = correlation[centre][centre];
    if here.is_nan() {
        return Tile::Silent;
    }
    let (mut best, mut at) = (here, (centre, centre));
    for (j, row) in correlation.iter().enumerate() {
        for (i, &c) in row.iter().enumerate() {
            if c > best {
                (best, at) = (c, (i, j));
            }
        }
    }
    let (dx, dy) = (at.0 as f32 - centre as f32, at.1 as f32 - centre as f32);
    let away = (dx * dx + dy * dy).sqrt();
    if here < 0.4 || (away > 1.5 && best > here + 0.05) {
        return if best < 0.4 && energy < 4.0 * LEAST_CONTRAST * LEAST_CONTRAST * n {
            Tile::Silent
        } else {
            Tile::Contradicts { correlation: here }
        };
    }
    let (dx, dy) = (vertex(&correlation, at, true), vertex(&correlation, at, false));
    let offset_x = at.0 as f32 - centre as f32 + dx;
    let offset_y = at.1 as f32 - centre as f32 + dy;
    Tile::Confirms { offset: (offset_x * offset_x + offset_y * offset_y).sqrt(), correlation: here }
}

/// The vertex of the parabola through the best and its neighbours along one axis, -1/2..=1/2.
fn vertex<const N: usize>(c: &[[f32; N]; N], at: (usize, usize), along_x: bool) -> f32 {
    let get = |d: isize| -> f32 {
        let (x, y) = if along_x { (at.0 as isize + d, at.1 as isize) } else { (at.0 as isize, at.1 as isize + d) };
        if x < 0 || y < 0 || x >= N as isize || y >= N as isize { f32::NAN } else { c[y as usize][x as usize] }
    };
    let (a, b, d) = (get(-1), get(0), get(1));
    let bend = a - 2.0 * b + d;
    if bend < 0.0 { (0.5 * (a - d) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

#[cfg(test)]
mod tests;
