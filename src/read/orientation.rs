//! Orientation: how stored lines lie in the picture, and the picture upright.
//!
//! In: pixels as they are stored. Out: pixels as they are to be seen. Cost: one copy, none where the picture is stored upright.

use crate::plane::Plane;

/// How stored lines lie in the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Turn {
    /// Lines are columns.
    pub transposed: bool,
    /// What comes first is on the right.
    pub mirrored: bool,
    /// What comes first is at the bottom.
    pub flipped: bool,
}

impl Turn {
    /// As it is to be seen.
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
