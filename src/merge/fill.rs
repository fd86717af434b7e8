//! Filling: frames with assumed transforms fill what is clipped or black in all other frames.
//!
//! In: the mean of the frames with known transforms, and a row of all frames. Out: the radiance of the row. Cost: none
//! if no transform is assumed, else the cost of the mean again.
//!
//! P is the mean of the frames with known transforms. A is the mean of frames with assumed transforms. For clipped
//! pixels, A is the mean of those that are shorter than the reference; for black pixels, the mean of those that are
//! longer. The radiance E of a clipped or black pixel is
//!
//! ```text
//! clipped: E = (1 - a) P + a max(A, L)        black: E = (1 - b) P + b min(A, U)
//! ```
//!
//! - a rises from 0 to 1 over the code values at which the shortest known frame begins to clip. b rises from 0 to 1
//!   over the code values at which the longest known frame falls to black. So an assumed frame, which may be displaced,
//!   is used only where no known frame shows the scene.
//! - L is the smallest radiance that agrees with the code value of the shortest known frame. U is the largest radiance
//!   that agrees with the code value of the longest known frame. At the edge of a lamp, where a displaced frame may
//!   show the dark wall, E is never below L.

use super::layer::{CLIPS, COLUMNS, Fill, LIFT, Layer, Meaning, PAINTED, Taken, Tile};
use super::mean::{Channels, Means};
use crate::simd::{Loops, at_least, at_most};

/// Buffers that are reused from row to row.
pub(super) struct Filling {
    means: Means,
    /// A of the [module](self): the mean of the frames with assumed transforms.
    filled: Channels,
    /// The bound L or U (see the [module](self)) of each pixel.
    bound: Channels,
    /// The fraction a or b (see the [module](self)) of each pixel, 0..=1.
    part: [f32; COLUMNS],
    meanings: [Meaning; COLUMNS],
}

/// Fills row `y` of a tile. `known` and `radiance` contain the mean over the frames with known transforms, and are
/// updated.
pub(super) struct FilledRow<'a, 'b> {
    pub layers: &'a [Layer<'b>],
    pub tiles: &'a [Tile],
    /// For each frame, the motion-mask factor on the weight and the gain on the radiance of each pixel.
    pub taken: &'a [Taken<'a>],
    pub y: usize,
    pub fill: Fill,
    pub filling: &'a mut Filling,
    pub known: &'a mut Means,
    pub radiance: &'a mut [[f32; 3]],
}

impl Filling {
    pub fn new() -> Self {
        let none = [[0.0; COLUMNS]; 3];
        Filling { means: Means::new(), filled: none, bound: none, part: [0.0; COLUMNS], meanings: [[0.0; 4]; COLUMNS] }
    }

    /// Returns the fraction a or b (see the [module](self)) of each pixel of the last row, 0..=1.
    pub fn part(&self) -> &[f32; COLUMNS] {
        &self.part
    }
}

impl Loops for FilledRow<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let FilledRow { layers, tiles, taken, y, fill, filling, known, radiance } = self;
        let Filling { means, filled, bound, part, meanings } = filling;
        // The fraction a or b of each pixel. a depends on the shortest known frame that is used at the pixel, b on the
        // longest.
        let mut end = [0.0f32; COLUMNS];
        let mut is_seen = [0u32; COLUMNS];
        let known_ones = layers.iter().zip(tiles).zip(taken).filter(|((layer, _), _)| layer.fill.is_none());
        for ((layer, tile), Taken { kept, gain }) in known_ones {
            let Some(row) = tile.row(y) else { continue };
            let [red, green, blue] = row.codes;
            let mut is_end = [0u32; COLUMNS];
            for x in 0..COLUMNS {
                let is_shown = red[x] >= 0.0 && row.beside[x] & PAINTED == 0;
                let is_used = is_shown && kept.get(x).is_none_or(|&kept| kept >= 0.5);
                let is_later = fill == Fill::Black || is_seen[x] == 0;
                is_end[x] = u32::from(is_used && is_later);
                is_seen[x] |= u32::from(is_used);
                let top = at_least(at_least(red[x], green[x]), blue[x]);
                let (begins, sure) = (CLIPS.0 as f32, CLIPS.1 as f32);
                // To fill black pixels, the code value above black is mirrored (subtracted from 255), so that the
                // limits `CLIPS` apply.
                let reaches = match fill {
                    Fill::Clipped => top,
                    Fill::Black => 255.0 - (top - layer.black),
                };
                let reaches = at_most(at_least((reaches - begins) * (1.0 / (sure - begins)), 0.0), 1.0);
                end[x] = if is_end[x] != 0 { reaches } else { end[x] };
            }
            for c in 0..3 {
                let codes = row.codes[c];
                let shifted: [f32; COLUMNS] = match fill {
                    Fill::Clipped => *codes,
                    Fill::Black => codes.map(|code| code + LIFT as f32),
                };
                layer.look_up(c, &shifted, meanings);
                for x in 0..COLUMNS {
                    let [most, _, least, _] = meanings[x];
                    let held = if fill == Fill::Clipped { least } else { most };
                    let held = held * gain.get(x).copied().unwrap_or(1.0);
                    bound[c][x] = if is_end[x] != 0 { held } else { bound[c][x] };
                }
            }
        }
        means.add_all(Some(fill), (layers, tiles, taken), y);
        means.radiance(filled);
        for x in 0..COLUMNS {
            part[x] = if means.is_seen(x) && is_seen[x] != 0 { end[x] } else { 0.0 };
        }
        for (x, pixel) in radiance.iter_mut().enumerate().take(COLUMNS) {
            for c in 0..3 {
                let (value, bound) = (filled[c][x], bound[c][x]);
                let value = if fill == Fill::Clipped { at_least(value, bound) } else { at_most(value, bound) };
                pixel[c] += part[x] * (value - pixel[c]);
            }
            if part[x] >= 0.5 {
                known.fill(x, fill, means);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::weight::Weight;
    use super::super::{MergeOptions, Merged, Merging, merge};
    use crate::align::{Alignment, Placement, RejectedBy, Status, Transform};
    use crate::bracket::Bracket;
    use crate::response::ResponseCurve;
    use crate::response::tests::still;

    const SIZE: (usize, usize) = (300, 3);

    /// Returns a radiance that rises by thirty stops from left to right.
    fn ramp(x: usize) -> [f64; 3] {
        [libm::exp2((x as f64 - 200.0) / 10.0); 3]
    }

    /// Returns a still bracket of five frames, four stops apart; the reference is the middle one.
    fn bracket(scene: impl Fn(usize, usize) -> [f64; 3] + Sync) -> (Bracket, Alignment) {
        still(SIZE, &[1.0 / 256.0, 1.0 / 16.0, 1.0, 16.0, 256.0], scene)
    }

    fn merged(bracket: &Bracket, alignment: &Alignment) -> (Vec<[f32; 3]>, Merged) {
        let options = MergeOptions { weight: Weight::Hat, region: alignment.overlap };
        let (map, merged) = merge(bracket, alignment, &ResponseCurve::srgb(), &options, None).unwrap();
        (map.pixels.into_vec(), merged)
    }

    /// Returns the alignment, with `status` for frames 0 and 4.
    fn with(alignment: &Alignment, status: Status) -> Alignment {
        let mut alignment = alignment.clone();
        for i in [0, 4] {
            let placement = &mut alignment.placements[i];
            *placement = match (placement.clone(), status) {
                (Placement::Placed(estimate), Status::Assumed) => Placement::Assumed(estimate),
                _ => Placement::excluded(RejectedBy::User, "a reason".into()),
            };
        }
        alignment
    }

    #[test]
    fn assumed_frames_are_merged_only_where_others_are_clipped_or_black() {
        let (bracket, alignment) = bracket(|x, _| ramp(x));
        let (all, whole) = merged(&bracket, &alignment);
        let (without, fewer) = merged(&bracket, &with(&alignment, Status::Rejected));
        let (filled, merged) = merged(&bracket, &with(&alignment, Status::Assumed));
        let curve = ResponseCurve::srgb();
        let unit = f64::from(curve.exposure(0, 255.0));
        for x in 0..SIZE.0 {
            let truth = ramp(x)[1] * unit;
            // The transforms of frames 0 and 4 are assumed. Where frame 1 (exposure 1/16) is below code value 230, the
            // fraction a is 0, so frame 0 is not used. Where frame 3 (exposure 16) is above code value 25, the fraction
            // b is 0, so frame 4 is not used. The limits 228 and 27 leave a margin for rounding.
            let is_held = ramp(x)[1] < 16.0 * f64::from(curve.exposure(0, 228.0)) / unit
                && ramp(x)[1] * 16.0 > f64::from(curve.exposure(0, 27.0)) / unit;
            if is_held {
                assert_eq!(filled[x], without[x], "{x}");
            }
            // Only the assumed frames show these ranges of radiance. Frame 1 clips above 16, and frame 0 at 256. Below
            // 5e-4 frame 3 has code values below 23, and at 4e-5 frame 4 still has code value 26.
            if (16.5..240.0).contains(&ramp(x)[1]) || (4.0e-5..5.0e-4).contains(&ramp(x)[1]) {
                let found = f64::from(filled[x][1]) / truth;
                assert!((found - 1.0).abs() < 0.06, "{x}: {found}, {} with all", f64::from(all[x][1]) / truth);
            }
        }
        assert!(fewer.all_clipped > merged.all_clipped && fewer.all_black > merged.all_black);
        assert_eq!((merged.all_clipped, merged.frames), (whole.all_clipped, 5));
    }

    #[test]
    fn displaced_assumed_frame_changes_only_clipped_places() {
        // The scene is a lamp. Frame 0 shows it displaced by ten pixels to the right.
        let lamp = |at: usize, x: usize| if x.abs_diff(at) <= 20 { [200.0; 3] } else { [0.02; 3] };
        let (bracket, mut alignment) = bracket(|x, _| lamp(150, x));
        let (without, _) = merged(&bracket, &with(&alignment, Status::Rejected));
        alignment.placements[0] = Placement::by_user(Transform::Rigid { dx: -10.0, dy: 0.0, angle: 0.0 });
        let (filled, _) = merged(&bracket, &with(&alignment, Status::Assumed));
        for x in 10..SIZE.0 - 10 {
            let (old, new) = (without[x][1], filled[x][1]);
            if lamp(150, x)[1] < 1.0 {
                // To the right of the lamp, frame 0 shows the lamp, but is not used, because the known frames are not
                // clipped.
                assert_eq!(old, new, "{x}");
            } else if x.abs_diff(150) <= 6 {
                assert!(new > 10.0 * old, "{x}: {new} {old}");
            } else {
                // Near the edge of the lamp, frame 0 may show the wall. The result is then at least L, the radiance of
                // the known frame's code value minus 6 (`LIFT`).
                assert!(new > 0.9 * old, "{x}: {new} {old}");
            }
        }
    }

    #[test]
    fn shares_of_frames_that_fill_are_those_with_which_they_do() {
        let (bracket, alignment) = bracket(|x, _| ramp(x));
        let alignment = with(&alignment, Status::Assumed);
        let options = MergeOptions { weight: Weight::Hat, region: alignment.overlap };
        let curve = ResponseCurve::srgb();
        let merging = Merging::of(&bracket, &alignment, &curve, &options, None).unwrap();
        let shares = merging.shares((SIZE.0, 1)).unwrap();
        for x in 0..SIZE.0 {
            let all: f32 = shares.iter().map(|share| share.cells.at(x, 0)).sum();
            assert!((all - 1.0).abs() < 1e-4, "{x}: {all}");
        }
        let of = |frame: usize, x: usize| shares[frame].cells.at(x, 0);
        assert!(of(0, 290) > 0.99 && of(4, 2) > 0.99 && of(0, 150) == 0.0 && of(4, 150) == 0.0);
    }
}
