//! Features: keypoints with descriptors, told apart and matched.
//!
//! In: the [`Features`] of two pictures. Out: [`Match`]es that are each other's best and clearly better than the second best.
//! Cost: 128 multiply-adds for every pair of keypoints that may match. Source: Lowe, "Distinctive Image Features from Scale-Invariant
//! Keypoints", IJCV 60(2), 2004, section 7.1 (the ratio of the nearest to the second nearest).

use super::warp::map;
use nalgebra::Matrix3;
use rayon::prelude::*;

/// A point that can be found again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Place in pixels of the picture it was sought in; (0, 0) is the centre of the top-left one.
    pub x: f32,
    /// See `x`.
    pub y: f32,
    /// The Gaussian's standard deviation at which it was found, in pixels.
    pub scale: f32,
    /// Direction of its dominant gradient, from +x towards +y, in radians, -pi..=pi.
    pub angle: f32,
    /// |D|, the contrast of the extremum; grey levels are 0..=1.
    pub response: f32,
}

/// What surrounds a keypoint: 4 x 4 histograms of 8 directions.
pub type Descriptor = [u8; 128];

/// The keypoints of one picture, sorted by place, and their descriptors.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Features {
    /// The points.
    pub keypoints: Vec<Keypoint>,
    /// One descriptor a point.
    pub descriptors: Vec<Descriptor>,
}

impl Features {
    /// How many keypoints there are.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }
}

/// A pair of keypoints that look alike, by index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Match {
    /// In the reference's features.
    pub reference: usize,
    /// In the frame's features.
    pub frame: usize,
}

/// Where a match may lie: within `radius` pixels of the place that `motion` (reference -> frame) gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guide {
    /// Reference pixel -> frame pixel.
    pub motion: Matrix3<f64>,
    /// In pixels.
    pub radius: f64,
}

/// The pairs that are each other's nearest, nearer than `ratio` times the reference point's second nearest; with a `guide`, among those
/// near its places.
pub fn match_mutual(reference: &Features, frame: &Features, ratio: f64, guide: Option<&Guide>) -> Vec<Match> {
    let grid = guide.map(|g| (g, Grid::new(&frame.keypoints, g.radius)));
    let chunks: Vec<Chunk> = (0..reference.len().div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut found = Chunk { nearest: Vec::with_capacity(CHUNK), suitors: vec![Suitor::default(); frame.len()] };
            for i in chunk * CHUNK..((chunk + 1) * CHUNK).min(reference.len()) {
                let near = candidates(&reference.keypoints[i], &grid);
                let best = best_of(i as u32, &reference.descriptors[i], frame, &near, ratio, &mut found.suitors);
                found.nearest.push(best);
            }
            found
        })
        .collect();
    // Of the frame's points, each one's nearest in the reference; of equals the first.
    let mut suitors = vec![Suitor::default(); frame.len()];
    for chunk in &chunks {
        for (best, suitor) in suitors.iter_mut().zip(&chunk.suitors) {
            if suitor.distance < best.distance {
                *best = *suitor;
            }
        }
    }
    let nearest = chunks.iter().flat_map(|c| &c.nearest).enumerate();
    nearest
        .filter_map(|(i, best)| best.map(|j| (i, j as usize)))
        .filter(|&(i, j)| suitors[j].point == i as u32)
        .map(|(reference, frame)| Match { reference, frame })
        .collect()
}

/// What one task finds.
struct Chunk {
    /// For each of its points of the reference, the frame's point that is clearly the nearest.
    nearest: Vec<Option<u32>>,
    /// For each point of the frame, the nearest among its points of the reference.
    suitors: Vec<Suitor>,
}

/// A point of the reference, and how far its descriptor is.
#[derive(Debug, Clone, Copy)]
struct Suitor {
    point: u32,
    distance: u32,
}

impl Default for Suitor {
    fn default() -> Self {
        Suitor { point: u32::MAX, distance: u32::MAX }
    }
}

/// Keypoints of the reference that one task matches.
const CHUNK: usize = 64;

enum Candidates<'a> {
    All,
    Some(Vec<&'a [u32]>),
}

fn candidates<'a>(point: &Keypoint, grid: &'a Option<(&Guide, Grid)>) -> Candidates<'a> {
    match grid {
        None => Candidates::All,
        Some((guide, grid)) => {
            let (x, y) = map(&guide.motion, point.x.into(), point.y.into());
            Candidates::Some(grid.near(x, y))
        }
    }
}

/// The nearest of the candidates to point `i`, if it is clearly the nearest; each candidate hears of `i` as well.
fn best_of(
    i: u32,
    descriptor: &Descriptor,
    frame: &Features,
    candidates: &Candidates,
    ratio: f64,
    suitors: &mut [Suitor],
) -> Option<u32> {
    let (mut first, mut second, mut at) = (u32::MAX, u32::MAX, None);
    let mut consider = |j: u32| {
        let distance = distance_squared(descriptor, &frame.descriptors[j as usize]);
        if distance < first {
            (second, first, at) = (first, distance, Some(j));
        } else if distance < second {
            second = distance;
        }
        let suitor = &mut suitors[j as usize];
        if distance < suitor.distance {
            *suitor = Suitor { point: i, distance };
        }
    };
    match candidates {
        Candidates::All => (0..frame.len() as u32).for_each(&mut consider),
        Candidates::Some(cells) => cells.iter().flat_map(|c| c.iter().copied()).for_each(&mut consider),
    }
    let clear = second == u32::MAX || f64::from(first) < ratio * ratio * f64::from(second);
    at.filter(|_| clear && first <= FARTHEST)
}

/// Squared distance of two descriptors beyond which they are not of one place even where nothing else competes: descriptors are 512
/// long, so this is 2/3 of the distance of two that have nothing in common.
const FARTHEST: u32 = 2 * 512 * 512 * 4 / 9;

/// Squared Euclidean distance.
fn distance_squared(a: &Descriptor, b: &Descriptor) -> u32 {
    let mut sum = 0i32;
    for (x, y) in a.iter().zip(b) {
        let d = i16::from(*x) - i16::from(*y);
        sum += i32::from(d) * i32::from(d);
    }
    sum as u32
}

/// The frame's keypoints in square cells as wide as the guide's radius.
struct Grid {
    cell: f64,
    columns: i64,
    rows: i64,
    cells: Vec<Vec<u32>>,
}

impl Grid {
    fn new(points: &[Keypoint], radius: f64) -> Self {
        let cell = radius.max(1.0);
        let far = |f: fn(&Keypoint) -> f32| points.iter().map(|p| f64::from(f(p))).fold(0.0, f64::max);
        let columns = (far(|p| p.x) / cell) as i64 + 1;
        let rows = (far(|p| p.y) / cell) as i64 + 1;
        let mut cells = vec![Vec::new(); (columns * rows) as usize];
        for (j, p) in points.iter().enumerate() {
            let at = (f64::from(p.y.max(0.0)) / cell) as i64 * columns + (f64::from(p.x.max(0.0)) / cell) as i64;
            cells[at as usize].push(j as u32);
        }
        Grid { cell, columns, rows, cells }
    }

    /// The points of the cells about (x, y): all those within the radius, and some more.
    fn near(&self, x: f64, y: f64) -> Vec<&[u32]> {
        let (column, row) = ((x / self.cell).floor() as i64, (y / self.cell).floor() as i64);
        let mut near = Vec::with_capacity(9);
        for r in (row - 1).max(0)..=(row + 1).min(self.rows - 1) {
            for c in (column - 1).max(0)..=(column + 1).min(self.columns - 1) {
                near.push(&self.cells[(r * self.columns + c) as usize][..]);
            }
        }
        near
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Descriptors that have nothing to do with each other, one for each seed.
    fn descriptor(seed: u32) -> Descriptor {
        let mut state = seed.wrapping_mul(0x9E37_79B9) | 1;
        std::array::from_fn(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 26) as u8
        })
    }

    fn features(seeds: &[u32], shift: f32) -> Features {
        let keypoints = seeds
            .iter()
            .map(|&s| Keypoint {
                x: (s % 40) as f32 * 20.0 + shift,
                y: (s / 40) as f32 * 20.0,
                scale: 2.0,
                angle: 0.0,
                response: 0.1,
            })
            .collect();
        Features { keypoints, descriptors: seeds.iter().map(|&s| descriptor(s)).collect() }
    }

    #[test]
    fn equal_descriptors_find_each_other() {
        let a = features(&(0..200).collect::<Vec<_>>(), 0.0);
        let b = features(&(100..300).rev().collect::<Vec<_>>(), 5.0);
        let guide = Guide { motion: Matrix3::new(1.0, 0.0, 5.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), radius: 10.0 };
        for guide in [None, Some(&guide)] {
            let matches = match_mutual(&a, &b, 0.8, guide);
            let right = matches.iter().filter(|m| m.reference == 100 + 199 - m.frame).count();
            assert_eq!((right, matches.len()), (100, 100));
        }
    }

    #[test]
    fn a_guide_forbids_distant_partners() {
        let a = features(&[7], 0.0);
        let b = features(&[7], 300.0);
        let still = Guide { motion: Matrix3::identity(), radius: 10.0 };
        assert_eq!((match_mutual(&a, &b, 0.8, None).len(), match_mutual(&a, &b, 0.8, Some(&still)).len()), (1, 0));
    }

    #[test]
    fn what_repeats_is_not_matched() {
        let a = features(&[1, 2], 0.0);
        let b = features(&[1, 1, 2], 0.0);
        assert_eq!(match_mutual(&a, &b, 0.8, None), [Match { reference: 1, frame: 2 }]);
    }

    #[test]
    fn agrees_with_the_whole_table_of_distances() {
        // Descriptors of few values, so that many are alike and nearest ones are often not mutual.
        let coarse = |seeds: std::ops::Range<u32>| {
            let mut f = features(&seeds.collect::<Vec<_>>(), 0.0);
            f.descriptors.iter_mut().for_each(|d| d[6..].fill(0));
            f
        };
        let (a, b) = (coarse(0..150), coarse(100..260));
        let d = |i: usize, j: usize| distance_squared(&a.descriptors[i], &b.descriptors[j]);
        let mut expected = Vec::new();
        for i in 0..a.len() {
            let mut row: Vec<(u32, usize)> = (0..b.len()).map(|j| (d(i, j), j)).collect();
            row.sort();
            let j = row[0].1;
            let is_clear = f64::from(row[0].0) < 0.64 * f64::from(row[1].0);
            if is_clear && (0..a.len()).all(|k| (d(k, j), k) >= (row[0].0, i)) {
                expected.push(Match { reference: i, frame: j });
            }
        }
        assert!(expected.len() > 20 && expected.len() < 140, "{}", expected.len());
        assert_eq!(match_mutual(&a, &b, 0.8, None), expected);
    }

    #[test]
    fn only_the_nearest_of_two_suitors_is_taken() {
        let mut near = descriptor(5);
        near[0] ^= 1;
        let a = Features { keypoints: features(&[1, 2], 0.0).keypoints, descriptors: vec![near, descriptor(5)] };
        let b = features(&[5, 6], 0.0);
        assert_eq!(match_mutual(&a, &b, 0.8, None), [Match { reference: 1, frame: 0 }]);
    }
}
