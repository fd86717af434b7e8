//! Orientation: the order of stored lines, and the picture upright.
//!
//! In: pixels as stored. Out: pixels as displayed. Cost: one copy; none if the picture is stored upright.

use crate::plane::Plane;

/// The order of stored lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Turn {
    /// Whether stored lines are columns of the displayed picture.
    pub transposed: bool,
    /// Whether the first stored pixel is on the right of the displayed picture.
    pub mirrored: bool,
    /// Whether the first stored pixel is at the bottom of the displayed picture.
    pub flipped: bool,
}

impl Turn {
    /// Returns the picture as displayed.
    pub(crate) fn upright<T: Copy + Default + Send + Sync>(self, stored: Plane<T>) -> Plane<T> {
        if !(self.transposed || self.mirrored || self.flipped) {
            return stored;
        }
        let (mut width, mut height) = (stored.width(), stored.height());
        if self.transposed {
            (width, height) = (height, width);
        }
        Plane::from_rows(width, height, |y, row| {
            let y = if self.flipped { height - 1 - y } else { y };
            for (x, p) in row.iter_mut().enumerate() {
                let x = if self.mirrored { width - 1 - x } else { x };
                *p = if self.transposed { stored.at(y, x) } else { stored.at(x, y) };
            }
        })
    }
}
