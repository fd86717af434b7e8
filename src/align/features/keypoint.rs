//! Keypoints and descriptors: the result of detection and the input of matching (Lowe 2004, see
//! [`sift`](crate::align::features::sift)).

/// A distinctive point of an image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Keypoint {
    /// Column in pixels of the image; (0, 0) is the centre of the top-left pixel.
    pub x: f32,
    /// Row, see `x`.
    pub y: f32,
    /// Standard deviation of the Gaussian at which it was found, in pixels.
    pub scale: f32,
    /// Direction of the dominant gradient, from +x towards +y, in radians, -pi..=pi.
    pub angle: f32,
    /// |D|, the contrast of the extremum for grey values 0..=1.
    pub response: f32,
    /// Whether it is brighter than its surroundings (otherwise it is darker).
    pub bright: bool,
}

/// The surroundings of a keypoint: 4 x 4 histograms of 8 gradient directions.
pub type Descriptor = [u8; 128];

/// The keypoints of one image, sorted by position, and their descriptors.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Features {
    /// The keypoints.
    pub keypoints: Vec<Keypoint>,
    /// The descriptor of each keypoint.
    pub descriptors: Vec<Descriptor>,
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
