//! The motion of the camera while the rows were read, from the displacements of the patches.
//!
//! In: the [`Observed`] frames. Out: [`Bends`]. Cost: some thousand multiply-adds for each observation and round.
//! Source: Grundmann et al. 2012 use a mixture of homographies, one for each block of rows; here, a turn, a tilt and a
//! roll that are cubic splines of the row, because these are the motions of a hand that displace a picture most.

use crate::align::following::bend::Bends;
use crate::align::following::explained::{Explained, ROUNDS, weight};
use crate::align::following::homography::basis;
use crate::align::following::observations::Observation;
use crate::align::following::{Observed, Picture, some};
use crate::align::motion::bend::{BendModel, SHUTTER_PARAMETERS, SPLINES, Shutter, by_shutter, displacement};
use crate::align::motion::coordinates::by_homography;
use crate::align::transform::off_level;
use nalgebra::{SMatrix, SVector, Vector2};

/// Expected size of the parameters, in pixels of the level: those of the homography, and the turns.
const EXPECTED_PX: f64 = 5.0;
/// Expected size of the second differences of the turns from spline to spline, in pixels of the level.
const EXPECTED_CURVATURE_PX: f64 = 0.5;

type Parameters = SVector<f64, SHUTTER_PARAMETERS>;

/// Fits the motion of each frame.
pub(in crate::align::following) fn fit(frames: &[Option<Observed>], picture: &Picture) -> Bends {
    let bend = |observed: &Option<Observed>| {
        let observed = observed.as_ref().filter(|observed| observed.is_usable())?;
        let parameters = parameters(observed, picture.height);
        let plain = |o: &Observation| (basis(o) * observed.plain).into();
        let predicted = |o: &Observation| Some(displacement(&parameters, o.at, picture.height));
        let explained = Explained::new(&observed.observations, plain, predicted);
        let homography = off_level(&observed.homography, picture.level);
        let coordinates = picture.coordinates.off_level(picture.level);
        let parameters = parameters / picture.coordinates.unit;
        let shutter = Shutter::new(coordinates, picture.height, parameters, homography);
        Some((picture.bend(BendModel::Shutter(Box::new(shutter)), &observed.homography), explained))
    };
    frames.iter().map(bend).collect()
}

/// The parameters of a frame, in pixels of the level.
fn parameters(observed: &Observed, height: f64) -> Parameters {
    let mut held = SMatrix::<f64, SHUTTER_PARAMETERS, SHUTTER_PARAMETERS>::zeros();
    for i in 0..SHUTTER_PARAMETERS {
        held[(i, i)] = 1.0 / (EXPECTED_PX * EXPECTED_PX);
    }
    let curvature = 1.0 / (EXPECTED_CURVATURE_PX * EXPECTED_CURVATURE_PX);
    for (spline, turn) in (0..SPLINES - 2).flat_map(|spline| (0..3).map(move |turn| (spline, turn))) {
        let three = [0, 1, 2].map(|next| 8 + 3 * (spline + next) + turn);
        for (a, ca) in three.into_iter().zip([1.0, -2.0, 1.0]) {
            for (b, cb) in three.into_iter().zip([1.0, -2.0, 1.0]) {
                held[(a, b)] += ca * cb * curvature;
            }
        }
    }
    let mut parameters = Parameters::zeros();
    for round in (0..ROUNDS).step_by(2) {
        let weight = weight(round);
        let (mut normal, mut right) = (held, Parameters::zeros());
        for observation in some(&observed.observations) {
            let (first, turns) = by_shutter(observation.at, height);
            let small = by_homography(observation.at);
            // The parameters on which the displacement depends, and its derivatives by them.
            let by: [(usize, Vector2<f64>); 20] = std::array::from_fn(|i| match i.checked_sub(8) {
                None => (i, Vector2::new(small[0][i], small[1][i])),
                Some(turn) => (8 + 3 * first + turn, Vector2::from(turns[turn])),
            });
            let misfit = observation.misfit(displacement(&parameters, observation.at, height));
            let pull = observation.precision * weight(misfit);
            for (i, by_i) in &by {
                let pulled = pull * by_i;
                right[*i] += pulled.dot(&observation.displacement);
                by.iter().for_each(|(j, by_j)| normal[(*i, *j)] += pulled.dot(by_j));
            }
        }
        parameters = normal.cholesky().map_or(parameters, |c| c.solve(&right));
    }
    parameters
}
