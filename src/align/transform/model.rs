//! The models of a transform: unmoved, shift, rigid, homography; and the nearest transform of a model.
//!
//! In: a transform, or its matrix. Out: its [`Model`]; the nearest transform of a smaller model. Cost: negligible.
//! Source: Hartley & Zisserman, Multiple View Geometry (2nd ed., 2004), section 2.4 (a hierarchy of transformations).

use super::Transform;
use nalgebra::Matrix3;

/// The model of a transform, from the fewest to the most parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Model {
    /// The identity.
    Unmoved,
    /// Shift: two parameters.
    Shift,
    /// Shift and rotation about the centre: three parameters.
    Rigid,
    /// Any view of a plane, or any rotation of the camera: eight parameters.
    Homography,
}

impl Model {
    /// Returns the smallest model for the variant of `transform`. A [`Transform::Homography`] always has the model
    /// [`Model::Homography`], even if its matrix is a shift.
    pub fn of(transform: &Transform) -> Self {
        match *transform {
            Transform::Identity => Model::Unmoved,
            Transform::Rigid { angle: 0.0, .. } => Model::Shift,
            Transform::Rigid { .. } => Model::Rigid,
            Transform::Homography(_) => Model::Homography,
        }
    }
}

/// Returns the matrix of a transform of `model` near `h`: it has the same shift at the centre, and, if `model` allows
/// rotation, the same rotation there.
pub(crate) fn restrict(h: &Matrix3<f64>, model: Model, width: usize, height: usize) -> Matrix3<f64> {
    let transform = Transform::Homography(*h);
    let (dx, dy) = transform.shift_px(width, height);
    match model {
        Model::Unmoved => Matrix3::identity(),
        Model::Shift => Transform::Rigid { dx, dy, angle: 0.0 }.matrix(width, height),
        Model::Rigid => {
            let angle = transform.rotation_deg(width, height).to_radians();
            Transform::Rigid { dx, dy, angle }.matrix(width, height)
        }
        Model::Homography => *h,
    }
}

/// Converts `h` to a [`Transform`] of `model`, with the same shift at the centre as `h`, and, if `model` allows
/// rotation, the same rotation there.
pub(crate) fn to_transform(h: &Matrix3<f64>, model: Model, width: usize, height: usize) -> Transform {
    let whole = Transform::Homography(h / h[(2, 2)]);
    let (dx, dy) = whole.shift_px(width, height);
    match model {
        Model::Unmoved => Transform::Identity,
        Model::Shift => Transform::Rigid { dx, dy, angle: 0.0 },
        Model::Rigid => Transform::Rigid { dx, dy, angle: whole.rotation_deg(width, height).to_radians() },
        Model::Homography => whole,
    }
}
