//! Keypoints and descriptors.
//!
//! In and out: the types that detection gives and matching takes. Source: Lowe 2004 (see
//! [`features`](crate::align::features)).

/// A point that can be found again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Place in pixels of the picture it was sought in; (0, 0) is the centre of the top-left one.
    pub x: f32,
    /// See `x`.
    pub y: f32,
    /// The Gaussian's standard deviation at which it was found, in pixels.
    pub scale: f32,
    /// Direction of its dominant gradient, from +x towards +y, in radians, -pi..=pi.
    pub angle: f32,
    /// |D|, the contrast of the extremum; grey values are 0..=1.
    pub response: f32,
    /// Whether it is brighter than its surroundings, or darker.
    pub bright: bool,
}

/// What surrounds a keypoint: 4 x 4 histograms of 8 directions.
pub type Descriptor = [u8; 128];

/// The keypoints of one picture, sorted by place, and their descriptors.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Features {
    /// The points.
    pub keypoints: Vec<Keypoint>,
    /// One descriptor a point.
    pub descriptors: Vec<Descriptor>,
}

impl Features {
    /// How many keypoints there are.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }
}
