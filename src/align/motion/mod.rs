//! The motion of a frame: where it shows each pixel of the reference.
//!
//! In: a transform, and the [`Relief`] of the scene if it is known. Out: a [`Motion`]. Cost: for each pixel, a
//! homography; with a relief, also four depths.
//!
//! One homography describes the motion if the scene is flat or far, or if the camera only turned. If the scene has
//! depth and nothing in it moved, then a pixel's position also depends on its depth.

pub(crate) mod camera;
pub(crate) mod relief;

use crate::align::motion::relief::View;
use crate::align::transform::{Transform, map};
use nalgebra::Matrix3;
pub use relief::Relief;
use std::ops::Range;
use std::sync::Arc;

/// The motion of a frame: where it shows each pixel of the reference.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Width and height of the frame, in pixels.
    size: (usize, usize),
    /// Reference pixel -> frame pixel, if the depth is unknown.
    homography: Matrix3<f64>,
    is_identity: bool,
    /// The relief, and the number of the frame in it.
    depth: Option<(Arc<Relief>, usize)>,
}

impl Motion {
    /// The motion by `transform` of a frame of `size` pixels.
    pub fn new(transform: &Transform, size: (usize, usize)) -> Self {
        let is_identity = *transform == Transform::Identity;
        Motion { size, homography: transform.matrix(size.0, size.1), is_identity, depth: None }
    }

    /// A frame of `size` pixels that did not move.
    pub(crate) fn none(size: (usize, usize)) -> Self {
        Motion::new(&Transform::Identity, size)
    }

    /// The motion of frame `i` by its view of `relief`, if there is one.
    pub(crate) fn with_relief(self, relief: Option<&Arc<Relief>>, i: usize) -> Self {
        let depth = relief.filter(|relief| relief.view(i).is_some()).map(|relief| (relief.clone(), i));
        Motion { is_identity: self.is_identity && depth.is_none(), depth, ..self }
    }

    /// Whether the frame shows each pixel of the reference at the same position.
    pub fn is_identity(&self) -> bool {
        self.is_identity
    }

    /// Position in the frame, in pixels, of what the reference shows at (x, y), which may be between pixels. It may be
    /// outside of the frame. None if something nearer hides it in the frame.
    #[inline(always)]
    pub fn position(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        match self.relief() {
            None if self.is_identity => Some((x, y)),
            None => Some(map(&self.homography, x, y)),
            Some((relief, view)) => {
                let (q, is_shown) = relief.at(view, x as f32, y as f32);
                is_shown.then(|| view.camera.position(x, y, f64::from(q)))
            }
        }
    }

    /// Like [`position`](Self::position), but also none outside of the rectangle of the frame's pixel centres.
    #[inline(always)]
    pub fn inside(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        let (right, bottom) = ((self.size.0 - 1) as f64, (self.size.1 - 1) as f64);
        // The comparisons are false for NaN.
        self.position(x, y).filter(|&(u, v)| u >= 0.0 && v >= 0.0 && u <= right && v <= bottom)
    }

    /// Width and height of the frame, in pixels.
    pub(crate) fn size(&self) -> (usize, usize) {
        self.size
    }

    /// The relief and the frame's view of it, if the depth is known.
    #[inline(always)]
    pub(crate) fn relief(&self) -> Option<(&Relief, &View)> {
        let (relief, i) = self.depth.as_ref()?;
        Some((relief, relief.view(*i)?))
    }

    /// Two homographies: the position in the frame of each of the reference's pixels `columns` x `rows` is on the line
    /// between the two positions that they give.
    pub(crate) fn bounds(&self, columns: &Range<usize>, rows: &Range<usize>) -> [Matrix3<f64>; 2] {
        match self.relief() {
            None => [self.homography; 2],
            Some((relief, view)) => relief.range(columns, rows).map(|q| view.camera.homography(f64::from(q))),
        }
    }

    /// Like [`bounds`](Self::bounds), for the whole reference.
    pub(crate) fn extremes(&self) -> [Matrix3<f64>; 2] {
        match self.relief() {
            None => [self.homography; 2],
            Some((relief, view)) => relief.extremes().map(|q| view.camera.homography(f64::from(q))),
        }
    }
}
