//! The coordinates in which motions are fitted: the centre of the picture is (0, 0), half its long side is 1.
//!
//! In: the size of a picture, positions in pixels. Out: positions, and the displacements by small homographies. Cost:
//! negligible. In these coordinates, all parameters of a motion have about the same effect.

use nalgebra::Matrix3;

/// The coordinates of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Coordinates {
    centre: [f64; 2],
    /// Length of the unit, in pixels.
    pub(crate) unit: f64,
}

impl Coordinates {
    /// The coordinates of a picture of this size.
    pub(crate) fn new((width, height): (usize, usize)) -> Self {
        let [right, bottom] = [width, height].map(|length| length as f64 - 1.0);
        Coordinates { centre: [right / 2.0, bottom / 2.0], unit: (right.max(bottom) / 2.0).max(1.0) }
    }

    /// The same coordinates for pixels of the full size, if these are for pixels of `level`.
    pub(crate) fn off_level(&self, level: usize) -> Self {
        let side = (1u64 << level) as f64;
        Coordinates { centre: self.centre.map(|c| (c + 0.5) * side - 0.5), unit: self.unit * side }
    }

    /// The position of the pixel (x, y).
    #[inline(always)]
    pub(crate) fn of(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [(x - self.centre[0]) / self.unit, (y - self.centre[1]) / self.unit]
    }

    /// The pixel at the position (u, v).
    #[inline(always)]
    pub(crate) fn pixel(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        [u * self.unit + self.centre[0], v * self.unit + self.centre[1]]
    }

    /// Maps pixels to these coordinates.
    pub(crate) fn matrix(&self) -> Matrix3<f64> {
        let [x, y] = self.centre;
        Matrix3::new(1.0, 0.0, -x, 0.0, 1.0, -y, 0.0, 0.0, self.unit) / self.unit
    }

    /// Maps these coordinates to pixels.
    pub(crate) fn inverse(&self) -> Matrix3<f64> {
        let [x, y] = self.centre;
        Matrix3::new(self.unit, 0.0, x, 0.0, self.unit, y, 0.0, 0.0, 1.0)
    }

    /// The homography `h` between pixels, as one between these coordinates.
    pub(crate) fn homography(&self, h: &Matrix3<f64>) -> Matrix3<f64> {
        self.matrix() * h * self.inverse()
    }
}

/// Derivatives of the displacement at (u, v) by the 8 parameters of a small homography: of x and of y. A parameter is
/// the displacement that it causes at the distance of one unit from the centre.
#[inline(always)]
pub(crate) fn by_homography([u, v]: [f64; 2]) -> [[f64; 8]; 2] {
    [[u, v, 1.0, 0.0, 0.0, 0.0, u * u, u * v], [0.0, 0.0, 0.0, u, v, 1.0, u * v, v * v]]
}
