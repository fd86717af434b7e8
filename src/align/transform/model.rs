//! The models of a transform: unmoved, shift, rigid, homography; and the nearest transform of a model.
//!
//! In: a transform, or its matrix. Out: the smallest [`Model`] that it is of; the nearest one of a smaller model. Cost: negligible.
//! Source: Hartley & Zisserman, Multiple View Geometry (2nd ed., 2004), section 2.4 (a hierarchy of transformations).

use super::Warp;
use nalgebra::Matrix3;

/// What a warp is allowed to do, from the least to the most.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// Nothing.
    Unmoved,
    /// Shift: two numbers.
    Shift,
    /// Shift and rotation about the centre: three numbers.
    Rigid,
    /// Any view of a plane, or any turn of the camera: eight numbers.
    Homography,
}

impl Model {
    /// The model that `warp` is of.
    pub fn of(warp: &Warp) -> Self {
        match *warp {
            Warp::Identity => Model::Unmoved,
            Warp::Rigid { angle: 0.0, .. } => Model::Shift,
            Warp::Rigid { .. } => Model::Rigid,
            Warp::Homography(_) => Model::Homography,
        }
    }
}

/// The warp of `model` nearest to `h`, in the sense that it does the same to the centre and to its surroundings.
pub(crate) fn restrict(h: &Matrix3<f64>, model: Model, width: usize, height: usize) -> Matrix3<f64> {
    let warp = Warp::Homography(*h);
    let (dx, dy) = warp.shift_px(width, height);
    match model {
        Model::Unmoved => Matrix3::identity(),
        Model::Shift => Warp::Rigid { dx, dy, angle: 0.0 }.matrix(width, height),
        Model::Rigid => {
            let angle = warp.rotation_deg(width, height).to_radians();
            Warp::Rigid { dx, dy, angle }.matrix(width, height)
        }
        Model::Homography => *h,
    }
}

pub(crate) fn to_warp(h: &Matrix3<f64>, model: Model, width: usize, height: usize) -> Warp {
    let whole = Warp::Homography(h / h[(2, 2)]);
    let (dx, dy) = whole.shift_px(width, height);
    match model {
        Model::Unmoved => Warp::Identity,
        Model::Shift => Warp::Rigid { dx, dy, angle: 0.0 },
        Model::Rigid => Warp::Rigid { dx, dy, angle: whole.rotation_deg(width, height).to_radians() },
        Model::Homography => whole,
    }
}
