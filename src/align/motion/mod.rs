//! The motion of a frame: where it shows each pixel of the reference.
//!
//! In: a transform, and what it does not describe, if that is known: a [`Bend`], or the [`Relief`] of the scene. Out: a
//! [`Motion`]. Cost: for each pixel, a homography; with a relief, also four depths; with a bend, up to 100 operations.
//!
//! One homography describes the motion if the scene is flat or far, or if the camera only turned; and if, beyond that,
//! the lens does not distort, and all rows were exposed at the same time. Otherwise, smooth bends are added. If the
//! scene has depth and nothing in it moved, then a pixel's position also depends on its depth.

pub(crate) mod bend;
pub(crate) mod camera;
pub(crate) mod coordinates;
pub(crate) mod relief;

use crate::align::motion::relief::{View, Visibility};
use crate::align::transform::{Transform, map};
pub use bend::Bend;
use nalgebra::Matrix3;
pub use relief::Relief;
use std::ops::Range;
use std::sync::Arc;

/// The motion of a frame: where it shows each pixel of the reference.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Width and height of the frame, in pixels.
    size: (usize, usize),
    /// Reference pixel -> frame pixel, unless something better is followed.
    homography: Matrix3<f64>,
    is_identity: bool,
    followed: Option<OneFrame>,
}

/// What the frames of a bracket show of the scene, where one homography for each of them does not suffice.
#[derive(Debug, Clone, PartialEq)]
pub enum Followed {
    /// Each pixel is aligned at its depth.
    Depth(Arc<Relief>),
    /// The motion of each frame differs smoothly from its homography; none if the homography suffices.
    Bends(Vec<Option<Arc<Bend>>>),
}

/// Why one homography does not suffice.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// The lens distorts the pictures.
    Lens,
    /// The camera moved while the rows were read (rolling shutter).
    Shutter,
    /// The camera moved, and the scene has depth.
    Depth,
}

/// What is followed in one frame.
#[derive(Debug, Clone, PartialEq)]
enum OneFrame {
    /// The relief, and the number of the frame in it.
    Depth(Arc<Relief>, usize),
    /// The frame's bend.
    Bend(Arc<Bend>),
}

impl Followed {
    fn of(&self, i: usize) -> Option<OneFrame> {
        match self {
            Followed::Depth(relief) => relief.view(i).map(|_| OneFrame::Depth(relief.clone(), i)),
            Followed::Bends(bends) => bends[i].as_ref().map(|bend| OneFrame::Bend(bend.clone())),
        }
    }

    /// Why the homography of frame `i` does not suffice; none if it does.
    pub fn cause(&self, i: usize) -> Option<Cause> {
        match self.of(i)? {
            OneFrame::Depth(..) => Some(Cause::Depth),
            OneFrame::Bend(bend) => Some(bend.cause()),
        }
    }
}

impl Motion {
    /// The motion by `transform` of a frame of `size` pixels.
    pub fn new(transform: &Transform, size: (usize, usize)) -> Self {
        let is_identity = *transform == Transform::Identity;
        Motion { size, homography: transform.matrix(size.0, size.1), is_identity, followed: None }
    }

    /// A frame of `size` pixels that did not move.
    pub(crate) fn unmoved(size: (usize, usize)) -> Self {
        Motion::new(&Transform::Identity, size)
    }

    /// The motion of frame `i`, if something in it is followed.
    pub(crate) fn following(self, followed: Option<&Followed>, i: usize) -> Self {
        let followed = followed.and_then(|followed| followed.of(i));
        Motion { is_identity: self.is_identity && followed.is_none(), followed, ..self }
    }

    /// Whether the frame shows each pixel of the reference at the same position.
    pub fn is_identity(&self) -> bool {
        self.is_identity
    }

    /// Position in the frame, in pixels, of what the reference shows at (x, y), which may be between pixels. It may be
    /// outside of the frame. None if something nearer hides it in the frame, or pixels beside it.
    #[inline(always)]
    pub fn position(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        self.position_if(x, y, |visibility| visibility == Visibility::Shown)
    }

    /// The [position](Self::position), if the pixel `is_wanted`.
    #[inline(always)]
    fn position_if(&self, x: f64, y: f64, is_wanted: impl Fn(Visibility) -> bool) -> Option<(f64, f64)> {
        match &self.followed {
            None if self.is_identity => Some((x, y)),
            None => Some(map(&self.homography, x, y)),
            Some(OneFrame::Bend(bend)) => Some(bend.position(x, y)),
            Some(OneFrame::Depth(..)) => {
                let (relief, view) = self.relief()?;
                let (q, visibility) = relief.at(view, x as f32, y as f32);
                is_wanted(visibility).then(|| view.camera.position(x, y, f64::from(q)))
            }
        }
    }

    /// Like [`position`](Self::position), but also none outside of the rectangle of the frame's pixel centres.
    #[inline(always)]
    pub fn inside(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        self.position(x, y).filter(|at| self.is_inside(at))
    }

    /// Like [`inside`](Self::inside), but also where something nearer only hides pixels beside it. The frame shows such
    /// a pixel, but perhaps mixed with what is nearer, so it is not merged.
    pub fn seen(&self, x: f64, y: f64) -> Option<(f64, f64)> {
        self.position_if(x, y, |visibility| visibility != Visibility::Hidden).filter(|at| self.is_inside(at))
    }

    /// Whether a position is within the rectangle of the frame's pixel centres; false for NaN.
    #[inline(always)]
    fn is_inside(&self, &(u, v): &(f64, f64)) -> bool {
        u >= 0.0 && v >= 0.0 && u <= (self.size.0 - 1) as f64 && v <= (self.size.1 - 1) as f64
    }

    /// Width and height of the frame, in pixels.
    pub(crate) fn size(&self) -> (usize, usize) {
        self.size
    }

    /// The relief and the frame's view of it, if the depth is known.
    #[inline(always)]
    pub(crate) fn relief(&self) -> Option<(&Relief, &View)> {
        match &self.followed {
            Some(OneFrame::Depth(relief, i)) => Some((relief, relief.view(*i)?)),
            _ => None,
        }
    }

    /// The bend, if there is one.
    #[inline(always)]
    pub(crate) fn bend(&self) -> Option<&Bend> {
        match &self.followed {
            Some(OneFrame::Bend(bend)) => Some(bend),
            _ => None,
        }
    }

    /// Two homographies: along each axis, the position in the frame of each of the reference's pixels `columns` x
    /// `rows` is between the two positions that they give.
    pub(crate) fn bounds(&self, columns: &Range<usize>, rows: &Range<usize>) -> [Matrix3<f64>; 2] {
        match self.relief() {
            Some((relief, view)) => relief.range(columns, rows).map(|q| view.camera.homography(f64::from(q))),
            None => self.extremes(),
        }
    }

    /// Like [`bounds`](Self::bounds), for the whole reference.
    pub(crate) fn extremes(&self) -> [Matrix3<f64>; 2] {
        if let Some((relief, view)) = self.relief() {
            return relief.extremes().map(|q| view.camera.homography(f64::from(q)));
        }
        let farthest = self.bend().map_or(0.0, Bend::farthest);
        let shift = |px: f64| Matrix3::new(1.0, 0.0, px, 0.0, 1.0, px, 0.0, 0.0, 1.0);
        [-farthest, farthest].map(|px| shift(px) * self.homography)
    }
}
