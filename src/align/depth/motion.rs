//! The motion of each frame: where it shows each pixel of the reference.
//!
//! In: a bracket and its alignment. Out: a [`Motion`] for each placed frame, by the depth of the scene if it is known,
//! else by the frame's homography. Cost: see [`super`].

use crate::align::depth::Relief;
use crate::align::depth::camera::Camera;
use crate::align::transform::map;
use crate::align::{Alignment, Placement};
use crate::bracket::Bracket;
use crate::error::Result;
use nalgebra::Matrix3;
use std::sync::Arc;

/// The motion of a frame: where it shows each pixel of the reference.
#[derive(Debug, Clone)]
pub struct Motion {
    /// The homography of the frame, for frames whose camera is unknown.
    homography: Matrix3<f64>,
    /// The depth of the scene and the camera of the frame, in pixels of the full size.
    depth: Option<(Arc<Relief>, Camera)>,
}

impl Motion {
    /// Position in the frame, in pixels, of what the reference shows at the pixel (x, y).
    pub fn position(&self, x: usize, y: usize) -> (f64, f64) {
        match &self.depth {
            Some((relief, camera)) => camera.position(x as f64, y as f64, f64::from(relief.depth(x, y))),
            None => map(&self.homography, x as f64, y as f64),
        }
    }
}

/// Returns the motion of each placed frame of `bracket`; none for the reference and for rejected frames.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch) if a frame on disk cannot be read.
pub fn motions(bracket: &Bracket, alignment: &Alignment) -> Result<Vec<Option<Motion>>> {
    let relief = Relief::measure(bracket, alignment)?.map(Arc::new);
    let motion = |(i, placement): (usize, &Placement)| {
        let transform = placement.transform().filter(|_| i != bracket.reference_index())?;
        let camera = |relief: &Arc<Relief>| Some((relief.clone(), relief.cameras[i]?));
        let homography = transform.matrix(bracket.width(), bracket.height());
        Some(Motion { homography, depth: relief.as_ref().and_then(camera) })
    };
    Ok(alignment.placements.iter().enumerate().map(motion).collect())
}
