//! The check of one tile: its best correlation within a few pixels around its position.
//!
//! In: two frames at a common exposure, the second warped to the reference's grid, and a tile. Out: whether the tile
//! agrees, and the paraboloid of its correlations. Cost: some twenty correlations, with three multiply-adds per pixel.
//! Source: Lewis 1995 (see [`agreement`](crate::align::agreement)).

use crate::align::agreement::{REACH, TileDisplacement};
use crate::align::photometric::CommonExposure;
use crate::plane::Plane;
use crate::simd::{Loops, vectorised};

/// Least standard deviation of a tile's weighted pixels for it to be decided, in grey values.
const LEAST_CONTRAST: f32 = 2.5;

/// Fewest pixels with weight for a tile to be decided: a lamp at night is enough.
const LEAST_PIXELS: f32 = 64.0;

/// Weight below which a pixel is ignored.
const LEAST_WEIGHT: f32 = 0.01;

/// The result for one tile: `correlation` at its position, `offset` of the best match in pixels.
#[derive(Debug, Clone, Copy)]
pub(super) enum Tile {
    Undecided,
    Agrees { offset: f32, correlation: f32, peak: Option<Peak> },
    Disagrees { correlation: f32 },
}

impl Tile {
    /// The correlation at its position; none where it is undecided.
    pub(super) fn correlation(&self) -> Option<f32> {
        match *self {
            Tile::Undecided => None,
            Tile::Agrees { correlation, .. } | Tile::Disagrees { correlation } => Some(correlation),
        }
    }
}

/// The paraboloid around the best correlation of a tile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Peak {
    at: Shift,
    gradient: [f64; 2],
    sharpness: [f64; 3],
}

impl Peak {
    /// The displacement of the tile with this centre. The peak is at `at` + S^-1 g, so the pull is S `at` + g.
    pub(super) fn about(&self, centre: [f64; 2]) -> TileDisplacement {
        let [xx, xy, yy] = self.sharpness;
        let (x, y) = (self.at.0 as f64, self.at.1 as f64);
        let pull = [xx * x + xy * y + self.gradient[0], xy * x + yy * y + self.gradient[1]];
        TileDisplacement { centre, sharpness: self.sharpness, pull }
    }
}

/// The pixels of a tile in the reference minus their mean; 0 where the weight is too small.
struct Pattern {
    left: usize,
    top: usize,
    side: usize,
    /// By rows.
    values: Vec<f32>,
    /// 1 where a pixel has enough weight, 0 elsewhere.
    mask: Vec<f32>,
    /// Number of pixels with enough weight.
    count: f32,
    /// The sum of the squares of `values`.
    energy: f32,
}

impl Pattern {
    /// The pattern of a tile; none where it has too little contrast.
    fn new(both: &CommonExposure, left: usize, top: usize, side: usize) -> Option<Self> {
        let mut values = Vec::with_capacity(side * side);
        let mut mask = Vec::with_capacity(side * side);
        for y in top..top + side {
            for &v in &both.reference.row(y)[left..left + side] {
                let counts = both.tones.weight(v) >= LEAST_WEIGHT;
                values.push(if counts { v } else { 0.0 });
                mask.push(if counts { 1.0 } else { 0.0 });
            }
        }
        let count: f32 = mask.iter().sum();
        if count < LEAST_PIXELS {
            return None;
        }
        let mean = values.iter().sum::<f32>() / count;
        let mut energy = 0.0;
        for (v, m) in values.iter_mut().zip(&mask) {
            *v -= m * mean;
            energy += *v * *v;
        }
        let has_contrast = energy >= LEAST_CONTRAST * LEAST_CONTRAST * count;
        has_contrast.then_some(Pattern { left, top, side, values, mask, count, energy })
    }

    /// The correlation with the frame shifted by `shift`; NaN outside the frame.
    fn correlation(&self, warped: &Plane<f32>, shift: Shift) -> f32 {
        let (sums, squares, products) = vectorised(Moments { pattern: self, warped, shift });
        let total = |lanes: [f32; LANES]| lanes.iter().sum::<f32>();
        let sum = total(sums);
        let variance = total(squares) - sum * sum / self.count;
        // The least variance keeps the correlation low where the frame has no structure.
        if variance.is_nan() {
            f32::NAN
        } else {
            total(products) / (self.energy * variance.max(0.25 * self.count)).sqrt()
        }
    }
}

/// Computes the sums of a correlation of a pattern with the frame shifted by `shift`.
struct Moments<'a> {
    pattern: &'a Pattern,
    warped: &'a Plane<f32>,
    shift: Shift,
}

impl Loops for Moments<'_> {
    /// The sums of the frame's grey values, of their squares, and of their products with the pattern.
    type Output = ([f32; LANES], [f32; LANES], [f32; LANES]);

    #[inline(always)]
    fn run(self) -> Self::Output {
        let Moments { pattern, warped, shift: (dx, dy) } = self;
        let (mut sums, mut squares, mut products) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
        let left = (pattern.left as isize + REACH + dx) as usize;
        let rows = pattern.values.chunks_exact(pattern.side).zip(pattern.mask.chunks_exact(pattern.side));
        for (y, (values, mask)) in rows.enumerate() {
            let frame = &warped.row(((pattern.top + y) as isize + REACH + dy) as usize)[left..left + pattern.side];
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

/// Partial sums that are computed side by side.
const LANES: usize = 8;

/// Whole pixels to the right and down.
type Shift = (isize, isize);

/// The correlations of a tile at the shifts within [`REACH`], each computed on first use.
struct Correlations<'a> {
    pattern: &'a Pattern,
    warped: &'a Plane<f32>,
    known: [[Option<f32>; SPAN]; SPAN],
}

/// Shifts along an axis.
const SPAN: usize = 2 * REACH as usize + 1;

impl Correlations<'_> {
    /// The correlation at a shift; NaN beyond [`REACH`].
    fn at(&mut self, (dx, dy): Shift) -> f32 {
        if dx.abs() > REACH || dy.abs() > REACH {
            return f32::NAN;
        }
        let known = &mut self.known[(dy + REACH) as usize][(dx + REACH) as usize];
        *known.get_or_insert_with(|| self.pattern.correlation(self.warped, (dx, dy)))
    }

    /// Climbs from `start` to the next local maximum.
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

    /// The paraboloid through a shift and its eight neighbours; none where one of them is NaN.
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
        // A curved ridge may rise along its crest, where it has no maximum: limits the cross term.
        let limit = 0.95 * (xx * yy).max(0.0).sqrt();
        let known = c.iter().flatten().all(|v| v.is_finite()) && xx >= 0.0 && yy >= 0.0;
        known.then(|| Peak { at: (x, y), gradient, sharpness: [xx, xy.clamp(-limit, limit), yy] })
    }
}

/// Checks the tile of `side` x `side` pixels whose top-left pixel is (`left`, `top`).
pub(super) fn check_tile(both: &CommonExposure, warped: &Plane<f32>, left: usize, top: usize, side: usize) -> Tile {
    let Some(pattern) = Pattern::new(both, left, top, side) else { return Tile::Undecided };
    let mut correlations = Correlations { pattern: &pattern, warped, known: [[None; SPAN]; SPAN] };
    let here = correlations.at((0, 0));
    if here.is_nan() {
        return Tile::Undecided;
    }
    let mut best = correlations.climb((0, 0));
    // Smoothed planes have smooth correlations: other maxima within reach are visible from the edge.
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
            Tile::Undecided
        } else {
            Tile::Disagrees { correlation: here }
        };
    }
    let (x, y) = (dx + correlations.vertex(best.1, (1, 0)), dy + correlations.vertex(best.1, (0, 1)));
    Tile::Agrees { offset: (x * x + y * y).sqrt(), correlation: here, peak: correlations.peak(best.1) }
}

/// Shifts from which the search for other maxima starts.
const RIM: [Shift; 8] = [(-3, -3), (0, -3), (3, -3), (-3, 0), (3, 0), (-3, 3), (0, 3), (3, 3)];

/// Least correlation of an agreeing tile.
const LEAST_CORRELATION: f32 = 0.4;
