//! The ground: the plane in which most of the picture is.
//!
//! In: the [`Choice`]s of all pixels. Out: a [`Ground`], the plane that explains most of the certain ones. Cost: some
//! million operations. Source: RANSAC (Fischler & Bolles 1981), followed by least squares.
//!
//! Where no frame shows any detail, as in a clipped sky behind branches, every depth explains the frames. The ground is
//! the best guess: near things have edges, and end at them.

use crate::align::following::depth::semi_global::Choice;
use crate::plane::Plane;
use crate::statistics::random;
use nalgebra::{Matrix3, Vector3};

/// A pixel is certain if its certainty is at least this, in natural units of log likelihood.
const CERTAIN: f32 = 0.3;
/// Largest distance of a pixel from a plane that explains it, in labels.
const NEAR: f64 = 1.0;
/// Approximate number of pixels that are looked at.
const SAMPLES: usize = 4000;
/// Number of planes that are tried. If half of the pixels are on the ground, the probability that none of the planes
/// goes through three of them is below 1e-11.
const TRIALS: u64 = 200;
/// Rounds of least squares.
const ROUNDS: usize = 3;

/// A plane: its label at the pixel (x, y) is a x + b y + c.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Ground(Vector3<f64>);

impl Ground {
    /// The plane that explains most of the certain `choices`; none if it explains less than half of them.
    pub(super) fn of(choices: &Plane<Choice>) -> Option<Self> {
        let (width, height) = (choices.width(), choices.height());
        let step = (((width * height) as f64 / SAMPLES as f64).sqrt() as usize).max(1);
        let places = (0..height).step_by(step).flat_map(|y| (0..width).step_by(step).map(move |x| (x, y)));
        let known: Vec<(Vector3<f64>, f64)> = places
            .map(|(x, y)| (Vector3::new(x as f64, y as f64, 1.0), choices.at(x, y)))
            .filter(|(_, choice)| choice.certainty >= CERTAIN)
            .map(|(at, choice)| (at, f64::from(choice.label)))
            .collect();
        let is_near = |plane: &Vector3<f64>, (at, label): &(Vector3<f64>, f64)| (plane.dot(at) - label).abs() <= NEAR;
        let support = |plane: &Vector3<f64>| known.iter().filter(|k| is_near(plane, k)).count();
        let tried = (0..TRIALS).filter_map(|trial| {
            let one = |draw| known.get((random(1, trial, draw) % known.len().max(1) as u64) as usize);
            let three = [one(0)?, one(1)?, one(2)?];
            let rows = Matrix3::from_rows(&three.map(|k| k.0.transpose()));
            let plane = rows.try_inverse()? * Vector3::from(three.map(|k| k.1));
            Some((support(&plane), plane))
        });
        let (most, mut plane) = tried.reduce(|best, other| if other.0 > best.0 { other } else { best })?;
        if 2 * most < known.len() {
            return None;
        }
        for _ in 0..ROUNDS {
            let (mut normal, mut right) = (Matrix3::identity() * 1e-9, Vector3::zeros());
            for (at, label) in known.iter().filter(|k| is_near(&plane, k)) {
                normal += at * at.transpose();
                right += at * *label;
            }
            plane = normal.try_inverse().map_or(plane, |inverse| inverse * right);
        }
        Some(Ground(plane))
    }

    /// The label at the pixel (x, y).
    pub(super) fn label(&self, x: usize, y: usize) -> f32 {
        self.0.dot(&Vector3::new(x as f64, y as f64, 1.0)) as f32
    }
}
