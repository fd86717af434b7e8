//! Merging: radiance from aligned frames, their exposures and the response.
//!
//! In: a bracket, its alignment and the response. Out: a [`RadianceMap`] on the pixels of the reference frame, and its
//! statistics, [`Merged`]. Cost: about 15 ns of one core for each pixel of each frame, twice that in frames that are
//! resampled. Source: Debevec & Malik 1997, "Recovering High Dynamic Range Radiance Maps from Photographs", section
//! 2.2.
//!
//! The radiance E of a pixel is the weighted mean over the frames j, for each channel. Z_j is the code value of frame
//! j, g(Z) the logarithm of the exposure that gives code value Z, and dt_j the exposure of frame j divided by the
//! exposure of the reference frame:
//!
//! ```text
//! E = sum_j w_j X_j / dt_j  /  sum_j w_j,        X = exp(g(Z)),
//! w_j = w(Z_j) sqrt(dt_j) v(max of R, G, B in j) u_j r_j + e_j
//! ```
//!
//! - The mean is of exposures, not of their logarithms as in the paper's equation 6: on ten rendered brackets, with the
//!   hat weight and the true response, the mean of logarithms has a PU21-PSNR lower by 1.2 dB, with an equal RMS error
//!   in stops.
//! - v depends on the brightest of the three channels: if this channel is nearly clipped, the colour processing of the
//!   camera has changed the other two, so v reduces the weight of the frame in favour of frames without clipping.
//!   Without v a clipped channel leaves a colour cast.
//! - u is 0 if frame j counts as clipped: a shorter frame shows more radiance than frame j can hold, and the brightest
//!   channel of frame j is near white. Code values alone do not show clipping: JPEG ringing beside clipped pixels, and
//!   noise, give a clipped pixel code values below white, which would darken the mean. With noise weights, u alone
//!   gains 17 dB on rendered brackets.
//! - r is 1/2 for clipped pixels and their eight neighbours, otherwise 1: JPEG ringing, sharpening and resampling
//!   change the neighbours.
//! - For uniform weights v, u, r and the factor sqrt(dt) are 1. For noise weights, dt^2 divided by the variance of X
//!   replaces sqrt(dt).
//! - e_j is a small weight that matters only where no frame has another weight. It selects the shortest exposure where
//!   all frames are clipped, and the longest where all are black. It is at most about the hat weight of code value 1,
//!   and changes linearly with the code value, so that there is no visible border.
//! - A pixel with some channels at white and the others at 0 does not show a scene: it is painted, as in the borders of
//!   registered scans. Such pixels and their neighbours are not used, except in the reference frame.
//! - A frame with an [assumed](crate::align::Placement::Assumed) transform is not among the frames j: it fills what is
//!   clipped, or black, in all frames j (`fill`).
//! - If ghosts are removed, E is limited to what the code value of the reference frame allows (`allowed`).
//! - If no frame of a bracket of raw mosaics moved, E is demosaiced once more, from the mean of all frames:
//!   `MergedMosaic`.
//! - In locally processed frames (those of phones with local tone mapping), X_j / dt_j and the radiances that u
//!   compares are multiplied by the local [gain](local).
//!
//! **Units.** dt of the reference frame is 1, and the mean of g(128) over the channels is 0: radiance 1 gives the
//! reference frame its middle code value. A well-exposed reference frame shows radiances of about 0.001 to 5, so the
//! range of any bracket fits into half floats (6e-8 to 65504). To compare brackets of different exposures, divide the
//! radiance by [`Merged::reference_exposure`], or normalise it (`radiance::normalisation`).

mod allowed;
pub mod deghost;
mod fill;
mod layer;
#[doc(hidden)]
pub mod local;
mod mean;
mod merging;
pub(crate) mod miniature;
mod noise;
pub mod radiance;
mod rows;
pub(crate) mod share;
pub mod weight;

use crate::align::Rect;
use crate::bracket::colour::Primaries;
use crate::plane::Plane;
pub use merging::merge;
#[doc(hidden)]
pub use merging::{Merging, Slab};
use radiance::calibration::Unit;
#[doc(hidden)]
pub use radiance::photographed::Photographed;
use radiance::range::Limits;
use radiance::statistics::Statistics;
use serde::Serialize;
use weight::Weight;

/// Lower limit of radiance, so that no value is 0. It is below the radiance that any real response and exposure give.
pub const FLOOR: f32 = 1e-12;

/// Linear radiance.
#[derive(Debug, Clone, PartialEq)]
pub struct RadianceMap {
    /// Linear RGB by rows; every value finite and positive.
    pub pixels: Plane<[f32; 3]>,
    /// Chromaticities of red, green, blue and white.
    pub primaries: Primaries,
}

/// How frames are merged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MergeOptions {
    /// The weighting function.
    pub weight: Weight,
    /// The part of the reference frame to merge, for example its [overlap](crate::align::Alignment::overlap) with the
    /// other frames.
    pub region: Rect,
}

/// Statistics of a merge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Merged {
    /// The number of frames merged.
    pub frames: usize,
    /// Number of pixels with a channel at white even in the shortest exposure that covers them: their radiance is a
    /// lower bound.
    pub all_clipped: usize,
    /// Number of pixels with all channels at code value 0 even in the longest exposure that covers them: their radiance
    /// is an upper bound.
    pub all_black: usize,
    /// The relative exposure of the reference frame, t * ISO / N^2 in s, or 2^EV if EV was given. Radiance divided by
    /// it is comparable between brackets.
    pub reference_exposure: f64,
}

impl Merged {
    /// Returns the report; `radiance` and `limits` are in their final unit and colours. `unit_exposure` is the exposure
    /// at which a relative radiance of 1 gives the middle code value; `None` stands for the exposure of the reference
    /// frame.
    pub fn report(self, radiance: Statistics, limits: Option<Limits>, unit_exposure: Option<f64>) -> MergeReport {
        let Merged { frames, all_clipped, all_black, reference_exposure } = self;
        let is_relative = radiance.unit == Unit::Relative;
        let unit_exposure_s = is_relative.then_some(unit_exposure.unwrap_or(reference_exposure));
        MergeReport {
            frames,
            all_clipped,
            all_black,
            reference_exposure,
            unit_exposure_s,
            range_stops: limits.map(|limits| limits.stops(&radiance)),
            limits,
            radiance,
        }
    }
}

/// The section of the report on the merge.
#[doc(hidden)]
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MergeReport {
    /// [`Merged::frames`].
    pub frames: usize,
    /// [`Merged::all_clipped`].
    pub all_clipped: usize,
    /// [`Merged::all_black`].
    pub all_black: usize,
    /// [`Merged::reference_exposure`].
    pub reference_exposure: f64,
    /// The relative exposure t * ISO / N^2 at which radiance 1 gives the middle code value. It is the exposure of the
    /// reference frame, or that of the normalisation. Null if radiance is in cd/m2.
    pub unit_exposure_s: Option<f64>,
    /// The range in stops from the darkest radiance in the picture that is above the noise to the brightest that is not
    /// clipped. Null for locally processed frames.
    pub range_stops: Option<f64>,
    /// The radiances at which noise and clipping begin to limit the result, in the unit of the radiance. Null for
    /// locally processed frames.
    pub limits: Option<Limits>,
    /// Statistics of the luminance.
    pub radiance: Statistics,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::{Alignment, Placement, RejectedBy, Transform};
    use crate::bracket::{Bracket, Pattern, Raw, ReferenceChoice};
    use crate::response::ResponseCurve;
    use crate::response::tests::still;

    fn run(bracket: &Bracket, alignment: &Alignment, weight: Weight) -> (RadianceMap, Merged) {
        let options = MergeOptions { weight, region: alignment.overlap };
        merge(bracket, alignment, &ResponseCurve::srgb(), &options, None).unwrap()
    }

    /// Returns a radiance that rises by twelve stops from left to right, over 240 columns.
    fn ramp(x: usize, _: usize) -> [f64; 3] {
        [libm::exp2(x as f64 / 20.0 - 9.0); 3]
    }

    #[test]
    fn radiance_equals_that_of_the_scene_without_seams() {
        let (bracket, alignment) = still((240, 70), &[0.125, 1.0, 8.0], ramp);
        for weight in [Weight::Hat, Weight::Gaussian, Weight::Plateau] {
            let (map, report) = run(&bracket, &alignment, weight);
            let scale = f64::from(ResponseCurve::srgb().exposure(0, 255.0));
            for x in 0..240 {
                let (found, truth) = (f64::from(map.pixels.at(x, 69)[1]) / scale, ramp(x, 0)[1]);
                // The shortest exposure clips radiances above 8. The longest exposure shows radiances below 0.001 with
                // code values below 22, where rounding by half a code value is already an error of 3 %.
                if (0.001..7.5).contains(&truth) {
                    assert!((found / truth - 1.0).abs() < 0.05, "{weight:?} {x}: {found} for {truth}");
                }
            }
            // The merged radiance rises along the row, both where one frame has all the weight and where frames are
            // averaged. The tolerance of 3 % is for the rounding of code values.
            assert!((1..240).all(|x| map.pixels.at(x, 0)[0] >= 0.97 * map.pixels.at(x - 1, 0)[0]), "{weight:?}");
            assert_eq!((report.all_clipped, report.all_black), (0, 0));
        }
    }

    #[test]
    fn all_clipped_is_bright_and_grey_and_all_black_is_dark() {
        let (bracket, alignment) = still((8, 3), &[1.0, 4.0], |x, _| if x < 4 { [90.0, 80.0, 70.0] } else { [0.0; 3] });
        let (map, report) = run(&bracket, &alignment, Weight::Hat);
        assert_eq!((report.all_clipped, report.all_black), (12, 12));
        let (bright, dark) = (map.pixels.at(0, 0), map.pixels.at(7, 0));
        let curve = ResponseCurve::srgb();
        // The reference is the longer frame: code value 255 of the shorter frame stands for four times the radiance of
        // code value 255 of the reference. In the black half, `mean::LEAST` gives the shorter frame a share of less
        // than 1e-4.
        assert!((bright[0] / (4.0 * curve.exposure(0, 255.0)) - 1.0).abs() < 1e-3);
        assert!(bright[0] == bright[1] && bright[1] == bright[2] && dark[0] > 0.0);
        assert!((dark[0] / curve.exposure(0, 0.0) - 1.0).abs() < 1e-3);
    }

    #[test]
    fn ghosts_of_another_region_or_of_other_frames_are_refused() {
        let (bracket, alignment) = still((64, 48), &[0.5, 1.0, 2.0], |x, y| [0.05 + 0.003 * (x + y) as f64; 3]);
        let curve = ResponseCurve::srgb();
        let region = Rect { x0: 8, y0: 0, x1: 40, y1: 48 };
        let ghosts = deghost::find(&bracket, &alignment, &curve, region, deghost::AUTO, None).unwrap();
        let merged = |alignment: &Alignment, region| {
            merge(&bracket, alignment, &curve, &MergeOptions { weight: Weight::Hat, region }, Some(&ghosts))
        };
        assert!(merged(&alignment, region).is_ok());
        let moved = Rect { x0: 9, x1: 41, ..region };
        let refused = merged(&alignment, moved).unwrap_err().to_string();
        assert!(refused.contains("--deghost") && refused.contains("columns 8..40"), "{refused}");
        let mut fewer = alignment.clone();
        fewer.placements[0] = Placement::excluded(RejectedBy::User, "a reason".into());
        assert!(merged(&fewer, region).is_err_and(|e| e.to_string().contains("other frames")));
    }

    #[test]
    fn moved_frames_and_rejected_ones() {
        let (bracket, mut alignment) = still((40, 30), &[0.5, 1.0, 2.0], |x, y| [0.05 + 0.003 * (x + y) as f64; 3]);
        let (exact, _) = run(&bracket, &alignment, Weight::Hat);
        // With a shift by 0 pixels, the code values are looked up by interpolation. This must give the same radiance as
        // the exact look-up.
        alignment.placements[0] = Placement::by_user(Transform::Rigid { dx: 0.0, dy: 0.0, angle: 0.0 });
        let (moved, _) = run(&bracket, &alignment, Weight::Hat);
        for (a, b) in exact.pixels.as_slice().iter().zip(moved.pixels.as_slice()) {
            assert!((a[0] / b[0] - 1.0).abs() < 1e-4);
        }
        // A frame that is moved out of the picture has no effect, as if it were rejected.
        alignment.placements[0] = Placement::by_user(Transform::Rigid { dx: 1000.0, dy: 0.0, angle: 0.0 });
        let (outside, _) = run(&bracket, &alignment, Weight::Hat);
        alignment.placements[0] = Placement::excluded(RejectedBy::User, "a reason".into());
        let (rejected, report) = run(&bracket, &alignment, Weight::Hat);
        assert_eq!((outside.pixels, report.frames), (rejected.pixels, 2));
    }

    #[test]
    fn unmoved_raw_frames_are_demosaiced_once_whatever_the_slabs() {
        let (bracket, mut alignment) =
            still((50, 90), &[0.5, 2.0], |x, y| [0.01 * (x % 9) as f64, 0.02 * (y % 11) as f64, 0.1 * (x % 2) as f64]);
        let pattern = Pattern::bayer([0, 1, 1, 2]);
        let raw = |pattern: Option<Pattern>| {
            let raw = Raw { pattern, white: [0.5, 1.0, 0.7] };
            let mut frames = bracket.frames().to_vec();
            frames.iter_mut().for_each(|frame| frame.raw = Some(raw.clone()));
            Bracket::new(frames, &ReferenceChoice::Number(2)).unwrap()
        };
        let (pixel_by_pixel, counts) = run(&raw(None), &alignment, Weight::Noise);
        let bracket = raw(Some(pattern.clone()));
        let region = Rect { x0: 3, y0: 5, ..alignment.overlap };
        let options = MergeOptions { weight: Weight::Noise, region };
        let curve = ResponseCurve::srgb();
        let merging = Merging::of(&bracket, &alignment, &curve, &options, None).unwrap();
        let whole = merging.slab(0..85).unwrap();
        for (x, y) in (0..85).flat_map(|y| (0..47).map(move |x| (x, y))) {
            let c = pattern.at(3 + x, 5 + y);
            let (found, mean) = (whole.map.pixels.at(x, y)[c], pixel_by_pixel.pixels.at(3 + x, 5 + y)[c]);
            assert!((found / mean - 1.0).abs() < 1e-4, "measured values stay: {x} {y} {found} {mean}");
        }
        assert_ne!(whole.map.pixels.at(20, 20), pixel_by_pixel.pixels.at(23, 25), "others are interpolated");
        let slabs = [0..1, 1..40, 40..85].map(|rows| merging.slab(rows).unwrap());
        let joined: Vec<_> = slabs.iter().flat_map(|slab| slab.map.pixels.as_slice().to_vec()).collect();
        assert_eq!(joined, whole.map.pixels.as_slice());
        let sum = |of: fn(&Slab) -> usize| slabs.iter().map(of).sum::<usize>();
        assert_eq!((sum(|s| s.all_clipped), sum(|s| s.all_black)), (whole.all_clipped, whole.all_black));
        assert!(whole.all_black > 0 && whole.all_black <= counts.all_black);
        // A frame that moved has no measured value at some pixels.
        alignment.placements[0] = Placement::by_user(Transform::Rigid { dx: 0.0, dy: 0.0, angle: 0.0 });
        let moved = run(&bracket, &alignment, Weight::Noise);
        assert_eq!(moved, run(&raw(None), &alignment, Weight::Noise), "frames are merged pixel by pixel");
    }

    #[test]
    fn the_same_bytes_on_any_number_of_threads_and_a_region_is_a_part() {
        let (bracket, alignment) = still((50, 200), &[0.5, 2.0], |x, y| [0.01 * x as f64, 0.004 * y as f64, 0.1]);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| run(&bracket, &alignment, Weight::Gaussian))
        };
        let whole = on(1);
        assert_eq!(whole, on(3));
        let region = Rect { x0: 7, y0: 70, x1: 31, y1: 190 };
        let options = MergeOptions { weight: Weight::Gaussian, region };
        let (part, _) = merge(&bracket, &alignment, &ResponseCurve::srgb(), &options, None).unwrap();
        assert!((0..120).all(|y| part.pixels.row(y) == &whole.0.pixels.row(y + 70)[7..31]));
        let options = MergeOptions { region: Rect { x1: 51, ..region }, ..options };
        assert!(merge(&bracket, &alignment, &ResponseCurve::srgb(), &options, None).is_err());
    }
}
