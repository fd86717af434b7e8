//! The radiances that the reference allows: the merge shows the scene of the reference, at every pixel.
//!
//! In: a merge without limits, of some rows; then, for a row of the reference, the merged radiance. Out: this radiance,
//! limited to what the code values of the reference can mean. Cost: merging 50,000 pixels, and two dozen operations for
//! each pixel. Source: ours.
//!
//! The motion masks are made of cells, and of differences that are certain. Leaves, the edges of near objects, frames
//! that are blurred, and people before a background of similar brightness leave smaller differences. Where the reference
//! has code value Z, the radiance is between those of Z - d and Z + d, whatever the other frames show. How much the mean
//! and the reference usually differ, by noise and JPEG, is measured in the merged rows, for each step of brightness: d
//! is [`TIMES`] their usual difference, and at least [`LEAST`] code values; the strength of deghosting changes it.
//!
//! Beside clipped pixels, JPEG changes code values by more, so there is no limit for them; in nearly white pixels, the
//! limits are wider. A clipped channel gives a lower limit only.

use super::Merging;
use super::layer::{CLIPPED, CLIPS, COLUMNS, Row, Tile};
use super::mean::{Channels, MAY_CLIP};
use super::noise::{BySteps, STEPS};
use crate::error::Result;
use crate::response::{CODES, ResponseCurve};
use crate::simd::{at_least, at_most, floor32, integer32};

/// Quantile of the differences that is the usual one: that of one standard deviation.
const USUAL: f64 = 0.68;
/// Distance of the limits from the code value, in usual differences. In a few pixels, JPEG changes code values by more:
/// on rendered brackets without motion, 3 instead of 4 loses up to 0.2 dB (PU21-PSNR), and gains more where leaves move.
const TIMES: f64 = 4.0;
/// Least distance of the limits from the code value, in code values.
const LEAST: f64 = 8.0;
/// Number of pixels that are merged to measure the usual differences.
const MEASURED: usize = 50_000;

/// The radiances that the reference allows.
pub(super) struct Allowed {
    /// The index of the reference among the merged frames, by rising exposure.
    pub(super) reference: usize,
    /// For each channel and code value, the least and the largest radiance.
    limits: [Vec<[f32; 2]>; 3],
}

/// A difference between the reference and the mean: the channel, the code value of the reference, and the absolute
/// difference in code values.
type Difference = (usize, f64, f64);

impl Allowed {
    /// The radiances that the reference allows in `merging`, which has no limits yet. The reference is frame `reference`
    /// of the merged frames. `tolerance` is a factor on the distance of the limits from the code values.
    ///
    /// # Errors
    /// [`Error::Scratch`](crate::error::Error::Scratch) if frames are on disk and cannot be read.
    pub fn measure(merging: &Merging, reference: usize, curve: &ResponseCurve, tolerance: f64) -> Result<Self> {
        let (width, height) = merging.size();
        let count = MEASURED.div_ceil(width).min(height);
        let mut seen: [[Vec<f64>; STEPS]; 3] = Default::default();
        for i in 0..count {
            for (channel, code, apart) in differences(merging, reference, curve, (2 * i + 1) * height / (2 * count))? {
                seen[channel][BySteps::step(code)].push(apart);
            }
        }
        let usual = seen.map(|seen| BySteps::quantile(seen, USUAL, LEAST / TIMES));
        let limits = std::array::from_fn(|c| limits(curve, c, |code| tolerance * TIMES * usual[c].at(code)));
        Ok(Allowed { reference, limits })
    }

    /// Limits the merged `radiance` of a row to what the `row` of the reference allows.
    #[inline(always)]
    pub fn limit(&self, row: &Row, radiance: &mut Channels) {
        let held = held(row);
        for c in 0..3 {
            let limits = self.limits[c].as_slice();
            for x in 0..COLUMNS {
                let code = integer32(floor32(at_least(row.codes[c][x], 0.0) + 0.5)) as usize;
                let [least, most] = limits[code.min(CODES - 1)];
                let least = if code < CLIPS.0 { held[x] * least } else { least };
                radiance[c][x] = at_most(at_least(radiance[c][x], least), most / held[x]);
            }
        }
    }
}

/// The radiances of the limits of each code value, which are `away` from it, in code values.
fn limits(curve: &ResponseCurve, channel: usize, away: impl Fn(f64) -> f64) -> Vec<[f32; 2]> {
    let black = curve.black(channel);
    let of = |code: usize| {
        let (code, away) = (code as f64, away(code as f64));
        let (least, most) = (code - away, code.max(black) + away);
        let radiance = |code: f64| curve.exposure(channel, code as f32);
        [if least <= black { 0.0 } else { radiance(least) }, radiance(most)]
    };
    (0..CODES).map(of).collect()
}

/// How much the limits hold for the pixels of a row of the reference, 0..=1: less if the pixel is nearly white, and not at
/// all beside clipped pixels.
#[inline(always)]
fn held(row: &Row) -> [f32; COLUMNS] {
    let [red, green, blue] = row.codes;
    let mut held = [0.0; COLUMNS];
    for x in 0..COLUMNS {
        let top = at_least(at_least(red[x], green[x]), blue[x]);
        let below = at_most(at_least((MAY_CLIP.1 - top) * (1.0 / (MAY_CLIP.1 - MAY_CLIP.0)), 0.0), 1.0);
        held[x] = if row.beside[x] & CLIPPED != 0 { 0.0 } else { below };
    }
    held
}

/// The differences between the reference and the mean in row `y` of the result.
fn differences(merging: &Merging, reference: usize, curve: &ResponseCurve, y: usize) -> Result<Vec<Difference>> {
    let merged = merging.pixel_by_pixel(y..y + 1, &(y..y + 1))?.map.pixels;
    let (layer, region) = (&merging.layers[reference], merging.region);
    let rows = region.y0 + y..region.y0 + y + 1;
    let window = layer.window(&(region.x0..region.x1), &rows)?;
    let (mut tile, mut found) = (Tile::new(), Vec::new());
    for (line, left) in merged.row(0).chunks(COLUMNS).zip((region.x0..).step_by(COLUMNS)) {
        tile.read(layer, &window, left..left + line.len(), rows.clone());
        let Some(row) = tile.row(0) else { continue };
        let held = held(&row);
        for (x, pixel) in line.iter().enumerate().filter(|(x, _)| held[*x] == 1.0) {
            for (channel, radiance) in pixel.iter().enumerate() {
                let code = row.codes[channel][x];
                let apart = (curve.code(channel, *radiance) - code).abs();
                found.push((channel, f64::from(code), f64::from(apart)));
            }
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::Alignment;
    use crate::bracket::exposure::Exposure;
    use crate::bracket::{Bracket, Frame, ReferenceChoice, Samples};
    use crate::merge::MergeOptions;
    use crate::merge::deghost::{self, AUTO};
    use crate::merge::weight::Weight;
    use crate::plane::Plane;

    const SIZE: (usize, usize) = (300, 200);

    /// Code values of a smooth scene, 20..=190 in the reference.
    fn scene(x: usize, y: usize) -> f64 {
        105.0 + 80.0 * libm::sin(x as f64 / 23.0) + 5.0 * libm::cos(y as f64 / 17.0)
    }

    /// The merge of three frames at -1, 0 and 1 stops, with deghosting of strength `strength`, or without. `changed`
    /// gives the code values in the frame of a number, from those of the scene.
    fn merged(changed: impl Fn(usize, usize, usize, f64) -> f64, strength: Option<f64>) -> Plane<[f32; 3]> {
        let curve = ResponseCurve::srgb();
        let frames = [-1.0, 0.0, 1.0].into_iter().enumerate().map(|(i, stops)| {
            let code = |at: usize| {
                let (x, y) = (at % SIZE.0, at / SIZE.0);
                let exposure = libm::exp2(stops) as f32 * curve.exposure(1, scene(x, y) as f32);
                (changed(i, x, y, f64::from(curve.code(1, exposure))) + 0.5).clamp(0.0, 255.0) as u8
            };
            let codes = (0..SIZE.0 * SIZE.1).flat_map(|at| [code(at); 3]).collect();
            let exposure = Exposure::given(stops).unwrap();
            Frame::new(format!("{i}").into(), SIZE.0, SIZE.1, Samples::Eight(codes), exposure)
        });
        let bracket = Bracket::new(frames.collect(), &ReferenceChoice::Number(2)).unwrap();
        let alignment = Alignment::unmoved(&bracket);
        let region = alignment.overlap;
        let find = |strength| deghost::find(&bracket, &alignment, &curve, region, strength, None).unwrap();
        let ghosts = strength.map(find);
        let options = MergeOptions { weight: Weight::Hat, region };
        crate::merge::merge(&bracket, &alignment, &curve, &options, ghosts.as_ref()).unwrap().0.pixels
    }

    /// A disc that moves, and single pixels that differ in the longest frame: too few for a motion mask.
    fn disc_and_specks(i: usize, x: usize, y: usize, code: f64) -> f64 {
        let is_disc = (x as f64 - 60.0 - 40.0 * i as f64).hypot(y as f64 - 100.0) < 20.0;
        match (is_disc, i) {
            (true, _) => 230.0,
            (false, 2) if x % 16 == 5 && y % 16 == 3 && x > 220 => 0.3 * code,
            _ => code,
        }
    }

    #[test]
    fn specks_of_other_frames_are_limited_by_the_reference() {
        let curve = ResponseCurve::srgb();
        let code = |map: &Plane<[f32; 3]>, x: usize, y: usize| f64::from(curve.code(1, map.at(x, y)[1]));
        let [plain, found, weak] = [None, Some(AUTO), Some(0.0)].map(|s| merged(disc_and_specks, s));
        let (mut limited, mut differ) = (0, 0);
        for (x, y) in (0..SIZE.1).flat_map(|y| (225..SIZE.0).map(move |x| (x, y))) {
            let truth = scene(x, y);
            if x % 16 != 5 || y % 16 != 3 {
                // Elsewhere the mean is near the reference, and is not changed.
                assert_eq!(found.at(x, y), plain.at(x, y), "{x} {y}");
                continue;
            }
            // The usual difference is a part of a code value, so the limit is `LEAST` away; rounding adds one half.
            assert!((code(&found, x, y) - truth).abs() <= LEAST + 0.6, "{x} {y}: {} for {truth}", code(&found, x, y));
            assert!((code(&weak, x, y) - truth).abs() <= 2.0 * LEAST + 0.6, "{x} {y}");
            limited += usize::from((code(&plain, x, y) - truth).abs() > LEAST + 1.0);
            differ += usize::from(weak.at(x, y) != found.at(x, y));
        }
        assert!(limited > 20 && differ > 20, "{limited} {differ}");
    }

    #[test]
    fn a_still_bracket_is_not_limited() {
        let specks =
            |i: usize, x: usize, y: usize, code: f64| if x > 220 { disc_and_specks(i, x, y, code) } else { code };
        assert_eq!(merged(specks, Some(AUTO)), merged(specks, None));
    }

    #[test]
    fn beside_clipped_pixels_only_clipped_channels_are_limited() {
        let curve = ResponseCurve::srgb();
        let limits = std::array::from_fn(|c| limits(&curve, c, |_| LEAST));
        let allowed = Allowed { reference: 0, limits };
        let mut codes = [[100.0; COLUMNS]; 3];
        (codes[0][1], codes[0][2]) = (240.0, 255.0);
        let mut beside = [0; COLUMNS];
        beside[3] = CLIPPED;
        let row = Row { codes: codes.each_ref(), beside: &beside };
        let (bright, dark) = (curve.exposure(0, 200.0), curve.exposure(0, 40.0));
        let limited = |radiance: f32| {
            let mut all = [[radiance; COLUMNS]; 3];
            allowed.limit(&row, &mut all);
            [0, 1, 2, 3].map(|x| [all[0][x], all[1][x]])
        };
        let (least, most) = (curve.exposure(0, 92.0), curve.exposure(0, 108.0));
        // Far from clipped pixels; near white; clipped; beside a clipped pixel.
        let white = [232.0, 247.0].map(|code| curve.exposure(0, code));
        assert_eq!(limited(dark), [[least, least], [white[0], dark], [white[1], dark], [dark, dark]]);
        assert_eq!(limited(bright)[0], [most, most]);
        assert_eq!(limited(2.0 * white[1])[1..], [[2.0 * white[1]; 2]; 3]);
    }
}
