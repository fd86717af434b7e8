//! Keypoints and descriptors: the result of detection and the input of matching.

/// A distinctive point of an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Column in pixels of the image; (0, 0) is the centre of the top-left pixel.
    pub x: f32,
    /// Row in pixels of the image, with the same origin as `x`.
    pub y: f32,
    /// Standard deviation of the Gaussian at which the keypoint was found, in pixels. With SURF, it is the Gaussian
    /// that the box filters approximate.
    pub scale: f32,
    /// Dominant direction of the gradients, from +x towards +y, in radians, -pi..=pi.
    pub angle: f32,
    /// Strength of the extremum, for grey values scaled to 0..=1. For SIFT it is |D|, where D is the difference of
    /// Gaussians; for SURF it is the determinant of the Hessian.
    pub response: f32,
    /// Whether the point is brighter than its surroundings; otherwise it is darker.
    pub bright: bool,
}

/// SIFT descriptor of a keypoint's surroundings: 4 x 4 histograms of 8 gradient directions.
pub type SiftDescriptor = [u8; 128];

/// SURF descriptor of a keypoint's surroundings: for each of 4 x 4 cells, the sums of dx, |dx|, dy and |dy|.
pub type SurfDescriptor = [i8; 64];

/// The descriptors of one image, in the order of its keypoints.
#[derive(Debug, Clone, PartialEq)]
pub enum Descriptors {
    /// Descriptors of SIFT.
    Sift(Vec<SiftDescriptor>),
    /// Descriptors of SURF, whose distances are not comparable with those of SIFT.
    Surf(Vec<SurfDescriptor>),
}

impl Default for Descriptors {
    fn default() -> Self {
        Descriptors::Sift(Vec::new())
    }
}

/// The keypoints of one image, sorted by position, and their descriptors.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Features {
    /// The keypoints.
    pub keypoints: Vec<Keypoint>,
    /// The descriptor of each keypoint.
    pub descriptors: Descriptors,
}

impl Features {
    /// The number of keypoints.
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// Whether there are no keypoints.
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }
}
