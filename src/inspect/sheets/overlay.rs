//! The overlay: the edges of a frame and of the reference frame in one picture. There are two pictures of equal size,
//! one before and one after alignment. The user compares them with a slider.
//!
//! In: two frames and a transform. Out: an [`Overlay`]. It shows the whole picture. If the photographs are large
//! enough, a row of details follows below, at twice their size, so that an offset of half a pixel is visible. Cost:
//! drawing a sheet of edges (`views`), which has the same colours.

use super::views::{BOX, Couple, DETAIL_GAP, Detail, MAGNIFIED, Views, two_colours};
use crate::plane::Plane;

/// Edges up to this strength (of 255) are mostly noise. They are not shown here, because they would outnumber all
/// other edges.
const NOISE: u16 = 26;
/// Line width of the boxes around the details, in pixels.
const PEN: usize = 2;

/// The edges of a frame drawn over the edges of the reference frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Overlay {
    /// The edges as photographed, before alignment.
    pub before: Plane<[u8; 3]>,
    /// The edges after alignment; `None` if the frame is rejected or excluded.
    pub after: Option<Plane<[u8; 3]>>,
    /// Number of rows that show the whole picture. The rows below them, if any, show the details.
    pub whole_rows: usize,
}

/// Returns the overlay of the two frames in `couple`, at most `most` pixels wide.
pub(in crate::inspect) fn of(couple: &Couple, most: usize) -> Result<Overlay, String> {
    let views = Views::new(couple, (most, most), false);
    let (width, height) = (views.reference.strength.width(), views.reference.strength.height());
    let picture = |k: usize| -> Result<Plane<[u8; 3]>, String> {
        let gap = DETAIL_GAP as usize;
        let below = views.details.first().map_or(0, |p| gap + p.height * MAGNIFIED);
        let mut sheet = Plane::filled(width, height + below, [0u8; 3]);
        let coloured = |[still, moved]: [&Plane<u8>; 2]| two_colours(&plain(still), &plain(moved));
        put(&mut sheet, (0, 0), 1, &coloured([&views.reference.strength, &views.frame[k].1.strength]));
        for (i, place) in views.details.iter().enumerate() {
            frame_place(&mut sheet, place, (width, height), (couple.reference.width(), couple.reference.height()));
            let corner = (i * (place.width * MAGNIFIED + gap), height + gap);
            put(&mut sheet, corner, MAGNIFIED, &coloured(views.strengths(place, k)?.each_ref()));
        }
        Ok(sheet)
    };
    let after = couple.motion.as_ref().map(|_| picture(1)).transpose()?;
    Ok(Overlay { before: picture(0)?, after, whole_rows: height })
}

/// Returns `strength` scaled so that [`NOISE`] and weaker edges become 0, and 255 stays 255.
fn plain(strength: &Plane<u8>) -> Plane<u8> {
    Plane::from_rows(strength.width(), strength.height(), |y, row: &mut [u8]| {
        for (v, s) in row.iter_mut().zip(strength.row(y)) {
            *v = (u16::from(*s).saturating_sub(NOISE) * 255 / (255 - NOISE)) as u8;
        }
    })
}

/// Copies `picture` into `sheet`, with its upper left corner at `corner`. Each pixel becomes a square of `side` x
/// `side` pixels. Parts outside of the sheet are not copied.
fn put(sheet: &mut Plane<[u8; 3]>, corner: (usize, usize), side: usize, picture: &Plane<[u8; 3]>) {
    let rows = (picture.height() * side).min(sheet.height().saturating_sub(corner.1));
    for y in 0..rows {
        let from = picture.row(y / side);
        let to = sheet.row_mut(corner.1 + y).iter_mut().skip(corner.0).take(picture.width() * side);
        to.enumerate().for_each(|(x, pixel)| *pixel = from[x / side]);
    }
}

/// Draws a box around the detail `place`. The photograph has `full` pixels, and is drawn with `size` pixels on the
/// sheet.
fn frame_place(sheet: &mut Plane<[u8; 3]>, place: &Detail, size: (usize, usize), full: (usize, usize)) {
    let at = |v: usize, most: usize, of: usize| (v * most / of).min(most - 1);
    let (left, right) = (at(place.x, size.0, full.0), at(place.x + place.width, size.0, full.0));
    let (top, bottom) = (at(place.y, size.1, full.1), at(place.y + place.height, size.1, full.1));
    for y in top..=bottom {
        let row = &mut sheet.row_mut(y)[left..=right];
        let last = row.len() - 1;
        for (x, pixel) in row.iter_mut().enumerate() {
            let is_edge = x < PEN || x + PEN > last || y < top + PEN || y + PEN > bottom;
            if is_edge {
                *pixel = BOX.rgb();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::scene::{Scene, Shot, rigid};
    use crate::align::{Motion, Transform};
    use crate::bracket::exposure::Exposure;
    use crate::bracket::{Frame, Samples};

    /// Returns the number of pixels that have only one of the two colours, because only one frame has an edge there.
    fn alone(sheet: &Plane<[u8; 3]>) -> usize {
        sheet.as_slice().iter().filter(|[r, _, b]| r.abs_diff(*b) > 90).count()
    }

    #[test]
    fn edges_differ_before_alignment_and_agree_after() {
        let (size, scene, truth) = ((900, 600), Scene::new(3), rigid(14.0, -9.0, 1.0));
        let greys = [Transform::Identity, truth].map(|w| scene.photograph(size, &w, Shot::at(0.0)));
        let frame = |grey: &Plane<u8>| {
            let codes = grey.as_slice().iter().flat_map(|v| [*v; 3]).collect();
            Frame::new("x".into(), size.0, size.1, Samples::Eight(codes), Exposure::given(0.0).unwrap())
        };
        let frames = [frame(&greys[0]), frame(&greys[1])];
        let couple = |motion| Couple {
            reference: &frames[0],
            frame: &frames[1],
            reference_grey: &greys[0],
            frame_grey: &greys[1],
            motion,
        };
        let overlay = of(&couple(Some(Motion::new(&truth, size))), 450).unwrap();
        let after = overlay.after.unwrap();
        assert_eq!((after.width(), overlay.whole_rows), (450, 300));
        assert_eq!((after.width(), after.height()), (overlay.before.width(), overlay.before.height()));
        // The whole picture has 300 rows. Below it follows a row of details.
        assert!(after.height() > 350);
        // After alignment, few edges in only one colour remain: noise, and edges in the strip that the frame does not
        // cover.
        assert!(2 * alone(&after) < alone(&overlay.before), "{} {}", alone(&after), alone(&overlay.before));
        assert!(of(&couple(None), 450).unwrap().after.is_none());
    }
}
