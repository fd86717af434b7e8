//! Matching of descriptors.
//!
//! In: the [`Features`] of two images. Out: [`Match`]es that are mutual nearest neighbours and pass the ratio test.
//! Cost: 128 multiply-adds (64 for SURF) for every pair of keypoints that may match. This is about one pair in ten,
//! because a hand-held camera hardly rotates or zooms, and because a point that is brighter than its surroundings is so
//! at any exposure. Source: Lowe, "Distinctive Image Features from Scale-Invariant Keypoints", IJCV 60(2), 2004,
//! section 7.1 (test of the distance ratio of the nearest and the second nearest neighbour).

use crate::align::features::{Descriptors, Features, Keypoint, sift, surf};
use crate::align::transform::map;
use nalgebra::Matrix3;
use rayon::prelude::*;
use std::f32::consts::PI;

/// Indices of two keypoints with similar descriptors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Match {
    /// Index in the features of the reference.
    pub reference: usize,
    /// Index in the features of the frame.
    pub frame: usize,
}

/// Restricts matches: the frame's keypoint must be near the position that `motion` predicts. All keypoints within
/// `radius` pixels are considered, and some that are farther away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guide {
    /// The predicted motion, reference pixel -> frame pixel.
    pub motion: Matrix3<f64>,
    /// Search radius, in pixels.
    pub radius: f64,
}

/// Returns the pairs of keypoints whose descriptors are mutual nearest neighbours and pass the ratio test.
///
/// Ratio test: the distance from a keypoint of the reference to the nearest candidate in the frame must be less than
/// `ratio` times the distance to the second nearest candidate. Distances are between descriptors. A keypoint of the
/// frame is a candidate if it and the reference's keypoint are both brighter, or both darker, than their surroundings.
/// In addition, their directions differ by at most 45 degrees (or up to 67.5 in some cases, due to binning), and their
/// scales by at most a factor of two. With a `guide`, a candidate must also be near the predicted position.
///
/// Features of different detectors have no matches.
pub fn match_mutual(reference: &Features, frame: &Features, ratio: f64, guide: Option<&Guide>) -> Vec<Match> {
    let points = (reference.keypoints.as_slice(), frame.keypoints.as_slice());
    match (&reference.descriptors, &frame.descriptors) {
        (Descriptors::Sift(a), Descriptors::Sift(b)) => matches(points, (a, b), sift::LENGTH, ratio, guide),
        (Descriptors::Surf(a), Descriptors::Surf(b)) => matches(points, (a, b), surf::LENGTH, ratio, guide),
        _ => Vec::new(),
    }
}

/// Implements [`match_mutual`] for the points and descriptors of the reference and of the frame. `length` is the
/// Euclidean length of a descriptor.
fn matches<T: Copy + Into<i16> + Sync, const N: usize>(
    (points, frame_points): (&[Keypoint], &[Keypoint]),
    (descriptors, frame_descriptors): (&[[T; N]], &[[T; N]]),
    length: f32,
    ratio: f64,
    guide: Option<&Guide>,
) -> Vec<Match> {
    let table = Table::new(frame_points, frame_descriptors);
    let farthest = (FARTHEST * length * length) as i32;
    let grid = guide.map(|g| (g, Grid::new(&table.points, g.radius)));
    let chunks: Vec<Chunk> = (0..points.len().div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let mut found = Chunk {
                nearest: Vec::with_capacity(CHUNK),
                nearest_references: vec![NO_REFERENCE; frame_points.len()],
            };
            for i in chunk * CHUNK..((chunk + 1) * CHUNK).min(points.len()) {
                let mut search = Nearest {
                    point: i as u32,
                    descriptor: &WideDescriptor::new(&descriptors[i]),
                    table: &table,
                    nearest_references: &mut found.nearest_references,
                    first: i32::MAX,
                    second: i32::MAX,
                    at: None,
                };
                let point = &points[i];
                match &grid {
                    None => table.candidates(point).into_iter().flatten().for_each(|j| search.consider(j)),
                    Some((guide, grid)) => {
                        let (x, y) = map(&guide.motion, point.x.into(), point.y.into());
                        grid.near(x, y)
                            .filter(|&j| may_match(point, &table.points[j]))
                            .for_each(|j| search.consider(j));
                    }
                }
                let best = search.if_unambiguous(ratio, farthest);
                found.nearest.push(best);
            }
            found
        })
        .collect();
    // For each keypoint of the frame, the nearest keypoint of the reference; if several are equally near, the first of
    // them.
    let mut nearest_references = vec![NO_REFERENCE; frame_points.len()];
    for chunk in &chunks {
        for (best, nearest_reference) in nearest_references.iter_mut().zip(&chunk.nearest_references) {
            if nearest_reference.distance < best.distance {
                *best = *nearest_reference;
            }
        }
    }
    let nearest = chunks.iter().flat_map(|c| &c.nearest).enumerate();
    nearest
        .filter_map(|(i, best)| best.map(|j| (i, j)))
        .filter(|&(i, j)| nearest_references[j].point == i as u32)
        .map(|(reference, j)| Match { reference, frame: table.order[j] })
        .collect()
}

/// The result of one parallel task, which searches matches for some keypoints of the reference.
struct Chunk {
    /// For each reference keypoint of this task, the nearest keypoint of the frame as an index in the table; none if
    /// the match is ambiguous or too far.
    nearest: Vec<Option<usize>>,
    /// For each keypoint of the table, which contains the keypoints of the frame: the nearest among the reference
    /// keypoints of this task.
    nearest_references: Vec<NearestReference>,
}

/// A keypoint of the reference, and the squared distance between its descriptor and the descriptor of a keypoint of the
/// frame.
#[derive(Debug, Clone, Copy)]
struct NearestReference {
    point: u32,
    distance: i32,
}

const NO_REFERENCE: NearestReference = NearestReference { point: u32::MAX, distance: i32::MAX };

/// Number of keypoints of the reference that one task searches for.
const CHUNK: usize = 64;

/// The table is ordered by direction, in this number of bins of 22.5 degrees each.
const TURNS: usize = 16;
/// Largest difference in direction between matching keypoints, in bins.
const MOST_TURNS: usize = 2;
/// Largest ratio of the larger to the smaller scale of two matching keypoints.
const MOST_ZOOM: f32 = 2.0;

/// Returns the index of the bin of the direction `angle`.
fn turn(angle: f32) -> usize {
    ((angle + PI) * (TURNS as f32 / (2.0 * PI))) as usize % TURNS
}

/// Whether two keypoints can be the same point, seen by a hand-held camera.
fn may_match(a: &Keypoint, b: &Keypoint) -> bool {
    let apart = (turn(a.angle) + TURNS - turn(b.angle)) % TURNS;
    a.bright == b.bright
        && apart.min(TURNS - apart) <= MOST_TURNS
        && a.scale <= MOST_ZOOM * b.scale
        && b.scale <= MOST_ZOOM * a.scale
}

/// The frame's features, ordered so that the candidates for a keypoint (see [`may_match`]) are in a few index ranges.
struct Table<const N: usize> {
    /// For each keypoint of the table, its index in the frame's features.
    order: Vec<usize>,
    points: Vec<Keypoint>,
    descriptors: Vec<WideDescriptor<N>>,
    /// Index of the first keypoint of each bin, and at the end the number of all keypoints. A bin holds the dark or the
    /// bright keypoints of one direction.
    starts: [usize; 2 * TURNS + 1],
}

impl<const N: usize> Table<N> {
    fn new<T: Copy + Into<i16>>(points: &[Keypoint], descriptors: &[[T; N]]) -> Self {
        let key = |i: usize| {
            let k = &points[i];
            usize::from(k.bright) * TURNS + turn(k.angle)
        };
        let scale = |i: usize| points[i].scale;
        let mut order: Vec<usize> = (0..points.len()).collect();
        order.sort_by(|&a, &b| key(a).cmp(&key(b)).then(scale(a).total_cmp(&scale(b))).then(a.cmp(&b)));
        let starts = std::array::from_fn(|k| order.partition_point(|&i| key(i) < k));
        let points = order.iter().map(|&i| points[i]).collect();
        let descriptors = order.iter().map(|&i| WideDescriptor::new(&descriptors[i])).collect();
        Table { order, points, descriptors, starts }
    }

    /// Returns the ranges of the table that contain the candidates for `point`.
    fn candidates(&self, point: &Keypoint) -> [std::ops::Range<usize>; 2 * MOST_TURNS + 1] {
        let kind = usize::from(point.bright) * TURNS;
        std::array::from_fn(|k| {
            let part = kind + (turn(point.angle) + TURNS + k - MOST_TURNS) % TURNS;
            let (start, end) = (self.starts[part], self.starts[part + 1]);
            let run = &self.points[start..end];
            let first = run.partition_point(|p| MOST_ZOOM * p.scale < point.scale);
            let last = run.partition_point(|p| p.scale <= MOST_ZOOM * point.scale);
            start + first..start + last
        })
    }
}

/// A descriptor as 16-bit integers, for multiplication, and its squared length.
struct WideDescriptor<const N: usize> {
    values: [i16; N],
    square: i32,
}

impl<const N: usize> WideDescriptor<N> {
    fn new<T: Copy + Into<i16>>(descriptor: &[T; N]) -> Self {
        let values = descriptor.map(Into::into);
        WideDescriptor { square: dot(&values, &values), values }
    }

    /// Returns the squared Euclidean distance from `other`.
    fn distance_squared(&self, other: &Self) -> i32 {
        self.square + other.square - 2 * dot(&self.values, &other.values)
    }
}

/// Returns the scalar product of two descriptors. Eight partial sums let the compiler vectorise the loop.
#[inline]
fn dot<const N: usize>(a: &[i16; N], b: &[i16; N]) -> i32 {
    let mut sums = [0i32; 8];
    for (x, y) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        for (sum, (p, q)) in sums.iter_mut().zip(x.iter().zip(y)) {
            *sum += i32::from(*p) * i32::from(*q);
        }
    }
    sums.iter().sum()
}

/// A search for the keypoint of the frame that is nearest to one keypoint of the reference.
///
/// For every keypoint of the frame that it compares, the search also updates the nearest keypoint of the reference.
struct Nearest<'a, const N: usize> {
    point: u32,
    descriptor: &'a WideDescriptor<N>,
    table: &'a Table<N>,
    nearest_references: &'a mut [NearestReference],
    first: i32,
    second: i32,
    at: Option<usize>,
}

impl<const N: usize> Nearest<'_, N> {
    /// Compares the descriptor with the descriptor of the table's keypoint `j`.
    #[inline]
    fn consider(&mut self, j: usize) {
        let distance = self.descriptor.distance_squared(&self.table.descriptors[j]);
        if distance < self.first {
            (self.second, self.first, self.at) = (self.first, distance, Some(j));
        } else if distance < self.second {
            self.second = distance;
        }
        let nearest_reference = &mut self.nearest_references[j];
        if distance < nearest_reference.distance {
            *nearest_reference = NearestReference { point: self.point, distance };
        }
    }

    /// Returns the nearest keypoint, if it passes the ratio test and its squared distance is at most `farthest`. If two
    /// keypoints are equally near, neither passes the ratio test.
    fn if_unambiguous(&self, ratio: f64, farthest: i32) -> Option<usize> {
        let clear = self.second == i32::MAX || f64::from(self.first) < ratio * ratio * f64::from(self.second);
        self.at.filter(|_| clear && self.first <= farthest)
    }
}

/// Largest squared distance of matching descriptors, in units of the squared length of a descriptor. It also applies if
/// there is no second candidate for the ratio test.
///
/// Uncorrelated descriptors of length L are sqrt(2) L apart. Matching ones may be at most 2/3 of that apart.
const FARTHEST: f32 = 2.0 * 4.0 / 9.0;

/// Indices of the frame's keypoints, in square cells as wide as the guide's radius.
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

    /// Returns the keypoints in the cell of (x, y) and the cells around it. They include all keypoints within the
    /// guide's radius.
    fn near(&self, x: f64, y: f64) -> impl Iterator<Item = usize> {
        let around = |v: f64, count: i64| {
            let cell = (v / self.cell).floor() as i64;
            cell.saturating_sub(1).max(0)..=cell.saturating_add(1).min(count - 1)
        };
        let (rows, columns) = (around(y, self.rows), around(x, self.columns));
        let cells = rows.flat_map(move |r| columns.clone().map(move |c| &self.cells[(r * self.columns + c) as usize]));
        cells.flatten().map(|&j| j as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::features::SiftDescriptor;

    /// Returns a pseudorandom descriptor that depends only on the seed.
    fn descriptor(seed: u32) -> SiftDescriptor {
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
                bright: true,
            })
            .collect();
        Features { keypoints, descriptors: Descriptors::Sift(seeds.iter().map(|&s| descriptor(s)).collect()) }
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
    fn repeated_features_are_not_matched() {
        let a = features(&[1, 2], 0.0);
        let b = features(&[1, 1, 2], 0.0);
        assert_eq!(match_mutual(&a, &b, 0.8, None), [Match { reference: 1, frame: 2 }]);
    }

    #[test]
    fn agrees_with_the_whole_table_of_distances() {
        // These descriptors have few non-zero values. So many are similar, and nearest neighbours are often not mutual.
        let coarse = |seeds: std::ops::Range<u32>| {
            let mut f = features(&seeds.collect::<Vec<_>>(), 0.0);
            let Descriptors::Sift(descriptors) = &mut f.descriptors else { unreachable!() };
            descriptors.iter_mut().for_each(|d| d[6..].fill(0));
            f
        };
        let (a, b) = (coarse(0..150), coarse(100..260));
        // Gives the keypoints directions, scales and brightnesses on both sides of the limits of `may_match`.
        let turned = |mut f: Features, by: usize| {
            for (i, k) in f.keypoints.iter_mut().enumerate() {
                k.angle = ((i * by % 40) as f32 / 20.0 - 1.0) * PI;
                k.scale = 1.0 + (i * by % 7) as f32;
                k.bright = !(i * by).is_multiple_of(3);
            }
            f
        };
        for (a, b, least) in [(a.clone(), b.clone(), 20), (turned(a, 3), turned(b, 11), 20)] {
            // The expected matches follow from the definition, in exact integers.
            let d = |i: usize, j: usize| -> i32 {
                if !may_match(&a.keypoints[i], &b.keypoints[j]) {
                    return i32::MAX;
                }
                let (Descriptors::Sift(p), Descriptors::Sift(q)) = (&a.descriptors, &b.descriptors) else {
                    unreachable!()
                };
                let pairs = p[i].iter().zip(&q[j]);
                pairs.map(|(p, q)| (i32::from(*p) - i32::from(*q)).pow(2)).sum()
            };
            let mut expected = Vec::new();
            for i in 0..a.len() {
                let mut row: Vec<(i32, usize)> = (0..b.len()).map(|j| (d(i, j), j)).collect();
                row.sort();
                let j = row[0].1;
                let is_clear = row[1].0 == i32::MAX || f64::from(row[0].0) < 0.64 * f64::from(row[1].0);
                if row[0].0 <= (FARTHEST * 512.0 * 512.0) as i32
                    && is_clear
                    && (0..a.len()).all(|k| (d(k, j), k) >= (row[0].0, i))
                {
                    expected.push(Match { reference: i, frame: j });
                }
            }
            assert!(expected.len() > least && expected.len() < 140, "{}", expected.len());
            assert_eq!(match_mutual(&a, &b, 0.8, None), expected);
        }
    }

    #[test]
    fn only_the_nearest_of_two_candidates_is_taken() {
        let mut near = descriptor(5);
        near[0] ^= 1;
        let a = Features {
            keypoints: features(&[1, 2], 0.0).keypoints,
            descriptors: Descriptors::Sift(vec![near, descriptor(5)]),
        };
        let b = features(&[5, 6], 0.0);
        assert_eq!(match_mutual(&a, &b, 0.8, None), [Match { reference: 1, frame: 0 }]);
    }
}
