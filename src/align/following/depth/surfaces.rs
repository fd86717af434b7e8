//! Surfaces: the ground, which is the plane in which most of the picture is, and the other planes of the scene.
//!
//! In: the [`Choice`]s of all pixels. Out: [`Surfaces`], and choices on them. Cost: some million operations for each
//! surface, and some for each pixel. Source: RANSAC (Fischler & Bolles 1981), repeated on what the surfaces that were
//! found do not explain, followed by least squares; surfaces as labels as in PEARL (Isack & Boykov, "Energy-Based
//! Geometric Multi-Model Fitting", IJCV 97, 2012).
//!
//! Where no frame shows any detail, as in a clipped sky behind branches, every depth explains the frames. The ground is
//! the best guess: near things have edges, and end at them. And where a surface explains the frames as well as the
//! chosen label, the pixel is on the surface.

use crate::align::following::depth::cost_volume::CostVolume;
use crate::align::following::depth::jumps::JUMP;
use crate::align::following::depth::semi_global::Choice;
use crate::plane::Plane;
use crate::statistics::random;
use nalgebra::{Matrix3, Vector3};

/// A pixel is certain if its certainty is at least this, in natural units of log likelihood.
const CERTAIN: f32 = 0.3;
/// Largest distance of a pixel from a surface that explains it, in labels.
const NEAR: f64 = 1.0;
/// The pixels within this distance of a surface are not on another one, in labels.
const TAKEN: f64 = 2.0;
/// At most this share of the pixels within [`TAKEN`] of a plane are farther away than [`NEAR`]. Where a plane touches a
/// curved surface, their number rises with the distance or its square root, so the share is at least 0.29.
const BEYOND: f64 = 0.2;
/// Approximate number of pixels that are looked at.
const SAMPLES: usize = 4000;
/// Number of planes that are tried for each surface. If half of the pixels are on it, the probability that none of them
/// goes through three of these is below 1e-23; for a fifth, it is 4 %.
const TRIALS: u64 = 400;
/// Rounds of least squares.
const ROUNDS: usize = 3;
/// Least share of the certain pixels that are on the ground, and on another surface.
const LEAST: [f64; 2] = [0.5, 0.04];
/// Largest number of surfaces.
const MOST: usize = 6;
/// A surface other than the ground is as likely as the ground for a label that is this much nearer to it, in labels.
const HANDICAP: f32 = 2.0;
/// A surface explains the frames as well as a label if the log likelihoods differ by at most this, in natural units.
const AS_WELL: f32 = 0.2;

/// The ground and the other surfaces, each as (a, b, c): its label at the pixel (x, y) is a x + b y + c.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Surfaces(Vec<Vector3<f64>>);

impl Surfaces {
    /// The surfaces that explain most of the certain `choices`; none if there is no ground.
    pub(super) fn of(choices: &Plane<Choice>) -> Option<Self> {
        let (width, height) = (choices.width(), choices.height());
        let step = (((width * height) as f64 / SAMPLES as f64).sqrt() as usize).max(1);
        let places = (0..height).step_by(step).flat_map(|y| (0..width).step_by(step).map(move |x| (x, y)));
        let certain = places.map(|(x, y)| (position(x, y), choices.at(x, y))).filter(|(_, c)| c.certainty >= CERTAIN);
        let mut left: Vec<Sample> = certain.map(|(at, choice)| (at, f64::from(choice.label))).collect();
        let (all, mut found) = (left.len() as f64, Vec::new());
        while let Some(surface) = best(&left, LEAST[found.len().min(1)] * all).filter(|_| found.len() < MOST) {
            left.retain(|sample| distance(&surface, sample) > TAKEN);
            found.push(surface);
        }
        (!found.is_empty()).then_some(Surfaces(found))
    }

    /// The labels of the surfaces at the pixel (x, y), each with its handicap.
    pub(super) fn labels(&self, x: usize, y: usize) -> impl Iterator<Item = (f32, f32)> {
        let at = position(x, y);
        self.0.iter().enumerate().map(move |(i, s)| (s.dot(&at) as f32, if i == 0 { 0.0 } else { HANDICAP }))
    }

    /// Moves the pixels near a surface onto it, where it explains the frames as well.
    pub(super) fn attract(&self, choices: &mut Plane<Choice>, volume: &CostVolume) {
        let width = volume.width;
        choices.fill_rows(|y, row| {
            for (x, choice) in row.iter_mut().enumerate() {
                let near = |label: &f32| (label - choice.label).abs();
                let surface = self.labels(x, y).map(|(label, _)| label).min_by(|a, b| near(a).total_cmp(&near(b)));
                let costs = volume.at(y * width + x);
                let is_covered = |label: &f32| near(label) <= JUMP && (0.0..=(costs.len() - 1) as f32).contains(label);
                let Some(label) = surface.filter(is_covered) else { continue };
                let own = f32::from(costs[((choice.label + 0.5) as usize).min(costs.len() - 1)]);
                if cost(costs, label) - own <= AS_WELL * volume.scale {
                    choice.label = label;
                }
            }
        });
    }
}

/// The cost of a label with a fraction.
fn cost(costs: &[u8], label: f32) -> f32 {
    let first = label as usize;
    let [a, b] = [first, (first + 1).min(costs.len() - 1)].map(|i| f32::from(costs[i]));
    a + (label - first as f32) * (b - a)
}

/// A position, and the label there.
type Sample = (Vector3<f64>, f64);

/// The pixel (x, y) as a vector.
fn position(x: usize, y: usize) -> Vector3<f64> {
    Vector3::new(x as f64, y as f64, 1.0)
}

/// Distance of a sample from a surface, in labels.
fn distance(surface: &Vector3<f64>, (at, label): &Sample) -> f64 {
    (surface.dot(at) - label).abs()
}

/// The plane that explains most samples; none if it explains fewer than `least`, or only touches a curved surface.
fn best(samples: &[Sample], least: f64) -> Option<Vector3<f64>> {
    let support = |plane: &Vector3<f64>| samples.iter().filter(|sample| distance(plane, sample) <= NEAR).count();
    let tried = (0..TRIALS).filter_map(|trial| {
        let one = |draw| samples.get((random(1, trial, draw) % samples.len().max(1) as u64) as usize);
        let three = [one(0)?, one(1)?, one(2)?];
        let rows = Matrix3::from_rows(&three.map(|sample| sample.0.transpose()));
        let plane = rows.try_inverse()? * Vector3::from(three.map(|sample| sample.1));
        Some((support(&plane), plane))
    });
    let (most, mut plane) = tried.reduce(|best, other| if other.0 > best.0 { other } else { best })?;
    if (most as f64) < least {
        return None;
    }
    for _ in 0..ROUNDS {
        let (mut normal, mut right) = (Matrix3::identity() * 1e-9, Vector3::zeros());
        for (at, label) in samples.iter().filter(|sample| distance(&plane, sample) <= NEAR) {
            normal += at * at.transpose();
            right += at * *label;
        }
        plane = normal.try_inverse().map_or(plane, |inverse| inverse * right);
    }
    let taken = samples.iter().filter(|sample| distance(&plane, sample) <= TAKEN).count();
    (support(&plane) as f64 >= (1.0 - BEYOND) * taken as f64).then_some(plane)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::scene::uniform;

    /// Two planes, and a part in which nothing is certain.
    fn truth(x: usize, y: usize) -> (f32, bool) {
        let ground = 4.0 + 0.02 * x as f32;
        (if (60..80).contains(&x) { 14.0 - 0.03 * y as f32 } else { ground }, x > 10)
    }

    fn choices(noise: f32) -> Plane<Choice> {
        Plane::from_rows(120, 90, |y, row: &mut [Choice]| {
            for (x, choice) in row.iter_mut().enumerate() {
                let (label, is_certain) = truth(x, y);
                let off = noise * (uniform(3, x as i64, y as i64) as f32 - 0.5);
                *choice = Choice { label: label + off, certainty: if is_certain { 1.0 } else { 0.0 } };
            }
        })
    }

    #[test]
    fn surfaces_are_the_planes_of_the_scene() {
        let surfaces = Surfaces::of(&choices(1.0)).unwrap();
        // Each is fitted to hundreds of samples with an error of 0.3 labels.
        let labels: Vec<(f32, f32)> = surfaces.labels(70, 30).collect();
        assert_eq!(labels.len(), 2, "{labels:?}");
        assert!((labels[0].0 - 5.4).abs() < 0.1 && (labels[1].0 - 13.1).abs() < 0.1, "{labels:?}");
        assert_eq!((labels[0].1, labels[1].1), (0.0, HANDICAP));
        let curved = Plane::from_rows(120, 90, |y, row: &mut [Choice]| {
            for (x, choice) in row.iter_mut().enumerate() {
                let square = |a: usize, b: f32| (a as f32 - b) * (a as f32 - b);
                *choice = Choice { label: 0.01 * (square(x, 60.0) + square(y, 45.0)), certainty: 1.0 };
            }
        });
        assert!(Surfaces::of(&curved).is_none(), "no plane explains half of a curved scene");
        // Five eighths of the labels are within one of the plane, but the others are not far from it.
        let rough = Plane::from_rows(120, 90, |y, row: &mut [Choice]| {
            for (x, choice) in row.iter_mut().enumerate() {
                let off = 3.2 * (uniform(5, x as i64, y as i64) as f32 - 0.5);
                *choice = Choice { label: 6.0 + off, certainty: 1.0 };
            }
        });
        assert!(Surfaces::of(&rough).is_none(), "the scene is not in the plane");
    }

    #[test]
    fn pixels_move_onto_surfaces_that_explain_the_frames_as_well() {
        let surfaces = Surfaces::of(&choices(1.0)).unwrap();
        let (width, height, labels) = (120, 90, 20);
        // In the upper half, nothing is known. In the lower half, all labels are 1.2 too high, and no others explain
        // the frames.
        let mut given = choices(1.0);
        given.as_mut_slice()[45 * width..].iter_mut().for_each(|choice| choice.label += 1.2);
        let cost = |i: usize| {
            let (x, y) = (i / labels % width, i / labels / width);
            if y < 45 || i % labels == (given.at(x, y).label + 0.5) as usize { 200 } else { 250 }
        };
        let costs = (0..width * height * labels).map(cost).collect();
        let mut found = given.clone();
        surfaces.attract(&mut found, &CostVolume { width, height, labels, costs, scale: 40.0 });
        for (x, y) in (0..45).flat_map(|y| (0..width).map(move |x| (x, y))) {
            let off = (found.at(x, y).label - truth(x, y).0).abs();
            assert!(off < 0.1, "({x}, {y}): {off}");
        }
        // The truth is at least 0.2 labels from the label that explains the frames, which costs 10 of the 50 more; the
        // limit is 8.
        assert_eq!(found.rows(45..height), given.rows(45..height));
    }
}
