//! The direction in which depth displaces the patches of one frame: the start of the joint fit.
//!
//! In: the [`Observation`]s of a frame. Out: a [`Start`]: a direction, and a homography that explains the displacements
//! across this direction. Cost: some thousand multiply-adds per observation. Source: with small motions, all
//! displacements by depth have nearly the same direction, and the displacements across it are those of a homography.
//! All directions are tried; least absolute errors by iteratively reweighted least squares.

use crate::align::following::depth::geometry::camera_motion::CameraMotion;
use crate::align::following::homography::{self, Homography, absolute, basis, solved};
use crate::align::following::observations::Observation;
use nalgebra::{SMatrix, Vector2};
use std::f64::consts::PI;

/// Number of directions that are tried over half a turn.
const DIRECTIONS: usize = 36;
/// Number of rounds in which weights are computed again.
const ROUNDS: usize = 6;
/// Strength of the pull towards the homography without depth, per observation. Along the direction of depth, it alone
/// determines the homography.
const HOLD: f64 = 1e-3;

/// The result of the search for the direction.
#[derive(Debug, Clone)]
pub(super) struct Start {
    /// The homography of least absolute errors, without depth.
    plain: Homography,
    /// The homography that explains the displacements across the direction of depth.
    across: Homography,
    direction: Vector2<f64>,
    /// By how much the mean absolute error falls if displacements along the direction are free, in standard deviations.
    pub(super) gain: f64,
}

impl Start {
    /// The motion without depth.
    pub(super) fn without_depth(&self) -> CameraMotion {
        CameraMotion::flat(&self.plain)
    }

    /// Displacement of a patch along the direction, in pixels: its relative depth.
    pub(super) fn depth(&self, observation: &Observation) -> f64 {
        let r = observation.displacement - basis(observation) * self.across;
        let pull = observation.precision * self.direction;
        r.dot(&pull) / self.direction.dot(&pull).max(1e-12)
    }
}

/// Searches for the direction in which depth displaces the patches.
pub(super) fn search(observations: &[Observation]) -> Start {
    let plain = homography::fit(observations.iter());
    let of_plain = |s: &Observation| {
        let d = basis(s) * plain;
        absolute(s.misfit([d.x, d.y]))
    };
    let all = observations.iter().map(of_plain).sum::<f64>();
    let tried = (0..DIRECTIONS).map(|i| {
        let (sin, cos) = libm::sincos(PI * i as f64 / DIRECTIONS as f64);
        let direction = Vector2::new(cos, sin);
        let (across, error) = across(observations, &plain, direction);
        (error, across, direction)
    });
    let start = (all, plain, Vector2::x());
    let (error, across, direction) = tried.fold(start, |best, other| if other.0 < best.0 { other } else { best });
    Start { plain, across, direction, gain: (all - error) / observations.len().max(1) as f64 }
}

/// The homography that explains the displacements across `direction`, near `plain`, and the sum of its errors.
fn across(observations: &[Observation], plain: &Homography, direction: Vector2<f64>) -> (Homography, f64) {
    let normal_direction = Vector2::new(-direction.y, direction.x);
    // For each observation: the derivatives of the displacement across the direction, this displacement, and its
    // precision.
    let rows: Vec<(Homography, f64, f64)> = observations
        .iter()
        .map(|s| {
            let covariance = s.precision.try_inverse().unwrap_or_else(nalgebra::Matrix2::identity);
            let variance = (covariance * normal_direction).dot(&normal_direction).max(1e-12);
            (basis(s).transpose() * normal_direction, s.displacement.dot(&normal_direction), 1.0 / variance)
        })
        .collect();
    let misfit = |h: &Homography, (row, d, precision): &(Homography, f64, f64)| {
        let r = d - row.dot(h);
        r * r * precision
    };
    let mut h = *plain;
    for round in 0..ROUNDS {
        let (mut normal, mut right) = (SMatrix::<f64, 8, 8>::zeros(), Homography::zeros());
        for row in &rows {
            let weight = if round == 0 { 1.0 } else { 1.0 / (absolute(misfit(&h, row)) + 1.0) };
            let weighed = row.0 * (weight * row.2);
            normal += weighed * row.0.transpose();
            right += weighed * row.1;
        }
        h = solved(normal, right, HOLD * observations.len() as f64, plain);
    }
    (h, rows.iter().map(|row| absolute(misfit(&h, row))).sum())
}
