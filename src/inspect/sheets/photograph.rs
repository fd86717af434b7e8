//! Photographs in a drawing: the grey values of a frame, scaled to the page. Dark frames are brightened, so that they
//! can be seen.
//!
//! In: grey values of frames of any size. Out: [`Photograph`]s. Cost: one pass over the pixels.

use crate::draw::image::png_grey;
use crate::draw::scale::reduce;
use crate::draw::svg::{Area, Drawing};
use crate::plane::Plane;

/// A frame as it is drawn: grey values that are dark enough for coloured marks to be visible on them.
pub(in crate::inspect) struct Photograph {
    /// The grey values as displayed.
    pub(in crate::inspect) grey: Plane<u8>,
    /// Width and height of the frame, in pixels.
    full: (usize, usize),
    /// Width and height of a pixel of `grey` on the page, in pixels of the page.
    magnified: f64,
    /// Whether the frame is displayed brighter than it is.
    pub(in crate::inspect) brightened: bool,
}

/// The grey value with which black is displayed.
const DARKEST: f64 = 12.0;
/// The grey value with which white is displayed. Marks in saturated colours are visible on it.
const BRIGHTEST: f64 = 184.0;
/// A darker median is raised to this fraction of the displayed range, but with an exponent of at least 0.45.
const LEAST_MEDIAN: f64 = 0.25;

impl Photograph {
    /// Scales `frame` so that width and height are at most `most` pixels. A small frame is magnified by an integer
    /// factor.
    pub(in crate::inspect) fn new(frame: &Plane<u8>, most: (usize, usize)) -> Self {
        let small = reduce(frame, most);
        let fits = (most.0 / small.width()).min(most.1 / small.height()).max(1);
        let (curve, brightened) = shown(&small);
        let grey = Plane::from_rows(small.width(), small.height(), |y, row| {
            for (v, g) in row.iter_mut().zip(small.row(y)) {
                *v = curve[usize::from(*g)];
            }
        });
        Photograph { grey, full: (frame.width(), frame.height()), magnified: fits as f64, brightened }
    }

    /// Returns the width and height of the photograph on the page, in pixels of the page.
    pub(in crate::inspect) fn size(&self) -> (f64, f64) {
        (self.grey.width() as f64 * self.magnified, self.grey.height() as f64 * self.magnified)
    }

    /// Returns the width of a pixel of the frame on the page, in pixels of the page.
    pub(in crate::inspect) fn scale(&self) -> f64 {
        self.size().0 / self.full.0 as f64
    }

    /// Returns the position on the page of the pixel (x, y) of the frame. `corner` is the upper left corner of the
    /// photograph on the page.
    pub(in crate::inspect) fn place(&self, corner: (f64, f64), x: f64, y: f64) -> (f64, f64) {
        let (w, h) = self.size();
        (corner.0 + (x + 0.5) * w / self.full.0 as f64, corner.1 + (y + 0.5) * h / self.full.1 as f64)
    }

    /// Draws the photograph on `page`, with its upper left corner at `corner`. Returns the area that it covers.
    pub(in crate::inspect) fn put(&self, page: &mut Drawing, corner: (f64, f64)) -> Result<Area, String> {
        let (width, height) = self.size();
        let area = Area { x: corner.0, y: corner.1, width, height };
        page.picture(area, &png_grey(&self.grey)?);
        Ok(area)
    }
}

/// Returns the displayed value for each grey value, and whether the picture is brightened. The brightest 0.2 % of the
/// pixels are displayed as white. If the median is dark, it is raised. In a dark frame, the darkest 1 % of the pixels
/// are displayed as black, because the camera's black level may be above 0.
fn shown(grey: &Plane<u8>) -> ([u8; 256], bool) {
    let mut counts = [0usize; 256];
    for &v in grey.as_slice() {
        counts[usize::from(v)] += 1;
    }
    let total = grey.as_slice().len();
    let quantile = |share: f64| {
        let mut below = 0;
        let found = counts.iter().position(|n| {
            below += n;
            below as f64 >= share * total as f64
        });
        found.unwrap_or(255) as f64
    };
    let white = quantile(0.998).max(4.0);
    let black = if white < 128.0 { quantile(0.01).min(white - 2.0) } else { 0.0 };
    let median = ((quantile(0.5) - black) / (white - black)).clamp(0.02, 1.0);
    let power = (libm::log(LEAST_MEDIAN) / libm::log(median)).clamp(0.45, 1.0);
    let power = if median >= LEAST_MEDIAN { 1.0 } else { power };
    let level = |v: usize| {
        let share = libm::pow(((v as f64 - black) / (white - black)).clamp(0.0, 1.0), power);
        (DARKEST + (BRIGHTEST - DARKEST) * share).round() as u8
    };
    (std::array::from_fn(level), white < 200.0 || power < 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_the_same_at_every_scale() {
        let frame = Plane::filled(400, 200, 90u8);
        let photograph = Photograph::new(&frame, (100, 100));
        assert_eq!((photograph.size(), photograph.scale()), ((100.0, 50.0), 0.25));
        assert_eq!(photograph.place((10.0, 20.0), 199.5, 99.5), (60.0, 45.0));
        let small = Photograph::new(&Plane::filled(30, 20, 90u8), (100, 100));
        assert_eq!(small.size(), (90.0, 60.0));
        assert_eq!(small.place((0.0, 0.0), 14.5, 9.5), (45.0, 30.0));
    }

    #[test]
    fn dark_frames_are_brightened_and_others_only_dimmed() {
        let ramp =
            |most: usize| Plane::from_rows(256, 4, |_, row| (0..256).for_each(|x| row[x] = (x * most / 255) as u8));
        let (dark, brightened) = shown(&ramp(20));
        assert!(brightened && dark[20] == BRIGHTEST as u8 && dark[10] > 60);
        let (light, brightened) = shown(&ramp(255));
        assert!(!brightened && light.windows(2).all(|w| w[0] <= w[1]));
    }
}
