//! Agreement: whether a warp is right, tile by tile, by a measure that no stage before has optimised.
//!
//! In: two frames at a common exposure and a warp. Out: how many tiles of the picture bear it out, how many contradict it, and by how much
//! those that bear it out are off. Cost: some twenty correlations of each tile, of three multiply-adds a pixel. Source: normalised
//! cross-correlation (Lewis, "Fast Normalized Cross-Correlation", Vision Interface 1995), blind to gain and offset, within a few pixels
//! about the place.

use crate::align::photometric::CommonExposure;
use crate::align::transform::map;
use crate::plane::Plane;
use crate::simd::{Loops, vectorised};
use nalgebra::Matrix3;
use rayon::prelude::*;

/// Tiles along the long side.
const TILES: usize = 16;
/// Least side of a tile, in pixels: a narrower picture has none, and nothing can be said of it.
pub(crate) const LEAST_SIDE: usize = 8;
/// How far around its place a tile is sought, in pixels.
const REACH: isize = 3;
/// A tile says something where its trusted pixels' standard deviation is at least so many grey levels.
const LEAST_CONTRAST: f32 = 2.5;
/// ... and at least so many can be trusted: a lamp in the night is enough.
const LEAST_TRUSTED: f32 = 64.0;
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

impl Survey {
    /// How much more the tiles that speak in both speak for this than for `other`, in nats: each gives the logarithm of the ratio of what
    /// the two leave unexplained of its pattern. Positive for this, negative for the other.
    pub fn against(&self, other: &Survey) -> f64 {
        let left = |c: f32| f64::from(1.0 - c.max(0.0) * c.max(0.0)) + UNEXPLAINED;
        let both = self.correlations.iter().zip(&other.correlations).filter_map(|(a, b)| Some(((*a)?, (*b)?)));
        both.map(|(a, b)| libm::log(left(b) / left(a))).sum()
    }
}

/// What noise leaves unexplained of a tile's pattern even where it is right.
const UNEXPLAINED: f64 = 0.05;

/// A tile that says where it lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Displaced {
    /// Its centre in the reference, in pixels of the planes.
    pub centre: [f64; 2],
    /// Minus the second derivatives of its correlation about the best match, [xx, xy, yy], per pixel^2: how sharply it is placed, each way.
    pub sharpness: [f64; 3],
    /// `sharpness` times how far it lies from where the warp puts it, in the reference's directions. (Along an edge neither is known.)
    pub pull: [f64; 2],
}

/// What the tiles say of a warp, all together and each by itself.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Survey {
    /// All together.
    pub agreement: Agreement,
    /// The correlation of each, as the warp puts it; none where it is silent.
    pub correlations: Vec<Option<f32>>,
    /// Of those that confirm, all whose best match does not lie at the rim of what was tried.
    pub displaced: Vec<Displaced>,
}

/// How far the two frames agree under `h`, reference -> frame, in pixels of the planes.
pub fn survey(both: &CommonExposure, h: &Matrix3<f64>) -> Survey {
    let (width, height) = (both.reference.width(), both.reference.height());
    let warped = laid_on_reference(&both.frame, h, (width, height));
    // Of a strip that is longer than so many squares the whole width.
    let side = width.max(height).div_ceil(TILES).min(width.min(height)).max(LEAST_SIDE);
    let (columns, rows) = (width / side, height / side);
    let judged = |i| judge(both, &warped, i % columns * side, i / columns * side, side);
    let tiles: Vec<Tile> = (0..rows * columns).into_par_iter().map(judged).collect();
    let mut sum = Agreement::default();
    let mut displaced = Vec::new();
    let mut each = Vec::with_capacity(tiles.len());
    let mut offsets = Vec::new();
    let mut correlations = 0.0;
    let mut parts = [false; 9];
    for (i, tile) in tiles.iter().enumerate() {
        each.push(match *tile {
            Tile::Silent => None,
            Tile::Confirms { correlation, .. } | Tile::Contradicts { correlation } => Some(correlation),
        });
        match *tile {
            Tile::Silent => sum.silent += 1,
            Tile::Confirms { offset, correlation, peak } => {
                sum.confirm += 1;
                let middle = |at: usize| (at * side) as f64 + (side as f64 - 1.0) / 2.0;
                displaced.extend(peak.map(|p| p.about([middle(i % columns), middle(i / columns)])));
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
    Survey { agreement: sum, correlations: each, displaced }
}

#[derive(Debug, Clone, Copy)]
enum Tile {
    Silent,
    Confirms { offset: f32, correlation: f32, peak: Option<Peak> },
    Contradicts { correlation: f32 },
}

/// The paraboloid about the best of a tile's correlations.
#[derive(Debug, Clone, Copy)]
struct Peak {
    at: Shift,
    gradient: [f64; 2],
    sharpness: [f64; 3],
}

impl Peak {
    /// It lies at `at` + S^-1 g, so S times that is S `at` + g.
    fn about(&self, centre: [f64; 2]) -> Displaced {
        let [xx, xy, yy] = self.sharpness;
        let (x, y) = (self.at.0 as f64, self.at.1 as f64);
        let pull = [xx * x + xy * y + self.gradient[0], xy * x + yy * y + self.gradient[1]];
        Displaced { centre, sharpness: self.sharpness, pull }
    }
}

/// The frame on the reference's grid, [`REACH`] pixels of nothing (NaN) around it, and nothing where the frame does not reach.
fn laid_on_reference(frame: &Plane<f32>, h: &Matrix3<f64>, (width, height): (usize, usize)) -> Plane<f32> {
    let margin = REACH as usize;
    let (right, bottom) = (frame.width() as f64 - 1.0, frame.height() as f64 - 1.0);
    let mut laid = Plane::filled(width + 2 * margin, height + 2 * margin, f32::NAN);
    laid.fill_rows(|row_at, row| {
        let Some(y) = row_at.checked_sub(margin).filter(|&y| y < height) else { return };
        // Over a few pixels a projective map is a straight line to within a ten-thousandth of a pixel.
        for (start, piece) in row[margin..margin + width].chunks_mut(PIECE).enumerate().map(|(i, p)| (i * PIECE, p)) {
            let from = map(h, start as f64, y as f64);
            let to = map(h, (start + PIECE) as f64, y as f64);
            let step = ((to.0 - from.0) / PIECE as f64, (to.1 - from.1) / PIECE as f64);
            for (i, v) in piece.iter_mut().enumerate() {
                let (u, w) = (from.0 + step.0 * i as f64, from.1 + step.1 * i as f64);
                if u >= 0.0 && w >= 0.0 && u < right && w < bottom {
                    let (x, y) = (u as usize, w as usize);
                    let (fx, fy) = ((u - x as f64) as f32, (w - y as f64) as f32);
                    let (upper, lower) = (&frame.row(y)[x..x + 2], &frame.row(y + 1)[x..x + 2]);
                    let (top, bottom) = (upper[0] + fx * (upper[1] - upper[0]), lower[0] + fx * (lower[1] - lower[0]));
                    *v = top + fy * (bottom - top);
                }
            }
        }
    });
    laid
}

/// Pixels of a row that are placed by one straight line.
const PIECE: usize = 16;

/// A tile's trusted pixels of the reference, less their mean; 0 elsewhere.
struct Pattern {
    left: usize,
    top: usize,
    side: usize,
    /// By rows.
    values: Vec<f32>,
    /// 1 where a pixel is trusted, 0 elsewhere.
    mask: Vec<f32>,
    /// How many are trusted.
    count: f32,
    /// The sum of the squares of `values`.
    energy: f32,
}

impl Pattern {
    /// The pattern of a tile; none where it says nothing.
    fn new(both: &CommonExposure, left: usize, top: usize, side: usize) -> Option<Self> {
        let mut values = Vec::with_capacity(side * side);
        let mut mask = Vec::with_capacity(side * side);
        for y in top..top + side {
            for &v in &both.reference.row(y)[left..left + side] {
                let counts = both.tones.trust(v) >= TRUSTED;
                values.push(if counts { v } else { 0.0 });
                mask.push(if counts { 1.0 } else { 0.0 });
            }
        }
        let count: f32 = mask.iter().sum();
        if count < LEAST_TRUSTED {
            return None;
        }
        let mean = values.iter().sum::<f32>() / count;
        let mut energy = 0.0;
        for (v, m) in values.iter_mut().zip(&mask) {
            *v -= m * mean;
            energy += *v * *v;
        }
        let speaks = energy >= LEAST_CONTRAST * LEAST_CONTRAST * count;
        speaks.then_some(Pattern { left, top, side, values, mask, count, energy })
    }

    /// The correlation with what lies (dx, dy) beside the place; not a number where the frame does not reach.
    fn correlation(&self, laid: &Plane<f32>, shift: Shift) -> f32 {
        let (sums, squares, products) = vectorised(Moments { pattern: self, laid, shift });
        let total = |lanes: [f32; LANES]| lanes.iter().sum::<f32>();
        let sum = total(sums);
        let variance = total(squares) - sum * sum / self.count;
        // A frame without structure where the reference has some agrees with nothing.
        if variance.is_nan() {
            f32::NAN
        } else {
            total(products) / (self.energy * variance.max(0.25 * self.count)).sqrt()
        }
    }
}

/// The sums that a correlation is made of, over what lies `shift` beside a pattern's place.
struct Moments<'a> {
    pattern: &'a Pattern,
    laid: &'a Plane<f32>,
    shift: Shift,
}

impl Loops for Moments<'_> {
    /// The sums of the frame's levels, of their squares, and of their products with the pattern.
    type Output = ([f32; LANES], [f32; LANES], [f32; LANES]);

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Moments { pattern, laid, shift: (dx, dy) } = self;
        let (mut sums, mut squares, mut products) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
        let left = (pattern.left as isize + REACH + dx) as usize;
        let rows = pattern.values.chunks_exact(pattern.side).zip(pattern.mask.chunks_exact(pattern.side));
        for (y, (values, mask)) in rows.enumerate() {
            let frame = &laid.row(((pattern.top + y) as isize + REACH + dy) as usize)[left..left + pattern.side];
            let eights = |r: &[f32]| r.len() / LANES * LANES;
            let whole = eights(values);
            for ((v, m), f) in values[..whole]
                .chunks_exact(LANES)
                .zip(mask[..whole].chunks_exact(LANES))
                .zip(frame[..whole].chunks_exact(LANES))
            {
                for i in 0..LANES {
                    let counted = m[i] * f[i];
                    sums[i] += counted;
                    squares[i] += counted * f[i];
                    products[i] += v[i] * f[i];
                }
            }
            for ((v, m), f) in values[whole..].iter().zip(&mask[whole..]).zip(&frame[whole..]) {
                sums[0] += m * f;
                squares[0] += m * f * f;
                products[0] += v * f;
            }
        }
        (sums, squares, products)
    }
}

/// Sums that are kept side by side, to be computed together.
const LANES: usize = 8;

/// Whole pixels to the right and down.
type Shift = (isize, isize);

/// The correlations of a tile at the shifts within [`REACH`] that were asked for.
struct Correlations<'a> {
    pattern: &'a Pattern,
    laid: &'a Plane<f32>,
    known: [[Option<f32>; SPAN]; SPAN],
}

/// Shifts along an axis.
const SPAN: usize = 2 * REACH as usize + 1;

impl Correlations<'_> {
    /// The correlation at a shift; not a number beyond reach.
    fn at(&mut self, (dx, dy): Shift) -> f32 {
        if dx.abs() > REACH || dy.abs() > REACH {
            return f32::NAN;
        }
        let known = &mut self.known[(dy + REACH) as usize][(dx + REACH) as usize];
        *known.get_or_insert_with(|| self.pattern.correlation(self.laid, (dx, dy)))
    }

    /// The top of the hill on which `start` lies.
    fn climb(&mut self, start: Shift) -> (f32, Shift) {
        let mut best = (self.at(start), start);
        loop {
            let (x, y) = best.1;
            for dy in -1..=1 {
                for dx in -1..=1 {
                    let c = self.at((x + dx, y + dy));
                    if c > best.0 {
                        best = (c, (x + dx, y + dy));
                    }
                }
            }
            if best.1 == (x, y) {
                return best;
            }
        }
    }

    /// The vertex of the parabola through `at` and its neighbours along an axis, -1/2..=1/2.
    fn vertex(&mut self, (x, y): Shift, (dx, dy): Shift) -> f32 {
        let (before, here, after) = (self.at((x - dx, y - dy)), self.at((x, y)), self.at((x + dx, y + dy)));
        let bend = before - 2.0 * here + after;
        if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 }
    }
}

impl Correlations<'_> {
    /// The paraboloid through `at` and its eight neighbours; none where one of them is not known.
    fn peak(&mut self, (x, y): Shift) -> Option<Peak> {
        let mut c = [[0.0f64; 3]; 3];
        for (j, row) in (-1..).zip(&mut c) {
            for (i, v) in (-1..).zip(row) {
                *v = f64::from(self.at((x + i, y + j)));
            }
        }
        let gradient = [0.5 * (c[1][2] - c[1][0]), 0.5 * (c[2][1] - c[0][1])];
        let xx = 2.0 * c[1][1] - c[1][0] - c[1][2];
        let yy = 2.0 * c[1][1] - c[0][1] - c[2][1];
        let xy = -0.25 * (c[2][2] - c[2][0] - c[0][2] + c[0][0]);
        // A ridge that is not quite straight may turn up along its crest: it says nothing there.
        let limit = 0.95 * (xx * yy).max(0.0).sqrt();
        let known = c.iter().flatten().all(|v| v.is_finite()) && xx >= 0.0 && yy >= 0.0;
        known.then(|| Peak { at: (x, y), gradient, sharpness: [xx, xy.clamp(-limit, limit), yy] })
    }
}

fn judge(both: &CommonExposure, laid: &Plane<f32>, left: usize, top: usize, side: usize) -> Tile {
    let Some(pattern) = Pattern::new(both, left, top, side) else { return Tile::Silent };
    let mut correlations = Correlations { pattern: &pattern, laid, known: [[None; SPAN]; SPAN] };
    let here = correlations.at((0, 0));
    if here.is_nan() {
        return Tile::Silent;
    }
    let mut best = correlations.climb((0, 0));
    // Smoothed planes correlate smoothly: other hills within reach show at its rim.
    for start in RIM {
        if correlations.at(start) > best.0 {
            best = correlations.climb(start);
        }
    }
    let (dx, dy) = (best.1.0 as f32, best.1.1 as f32);
    let away = (dx * dx + dy * dy).sqrt();
    if here < LEAST_CORRELATION || (away > 1.5 && best.0 > here + 0.05) {
        let is_faint = pattern.energy < 4.0 * LEAST_CONTRAST * LEAST_CONTRAST * pattern.count;
        return if best.0 < LEAST_CORRELATION && is_faint {
            Tile::Silent
        } else {
            Tile::Contradicts { correlation: here }
        };
    }
    let (x, y) = (dx + correlations.vertex(best.1, (1, 0)), dy + correlations.vertex(best.1, (0, 1)));
    Tile::Confirms { offset: (x * x + y * y).sqrt(), correlation: here, peak: correlations.peak(best.1) }
}

/// Where other hills are sought.
const RIM: [Shift; 8] = [(-3, -3), (0, -3), (3, -3), (-3, 0), (3, 0), (-3, 3), (0, 3), (3, 3)];

/// A tile that correlates less does not agree.
const LEAST_CORRELATION: f32 = 0.4;

#[cfg(test)]
mod tests;
