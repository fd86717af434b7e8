//! Compares radiance maps, in stops.
//!
//! In: two maps of one size. Out: for each pixel the difference of its worst channel in stops, and summary statistics.
//! Cost: 0.1 us for each pixel that differs.
//!
//! The difference of a and b is log2(1 + |a - b| / max(min(a, b), f)). Above the floor f this is |log2(a / b)|. Below
//! it the difference is relative to f, so that black and nearly black are close, and a bright pixel and black are far
//! apart but not infinitely. f is the 0.1th percentile of the positive values of the expected map: values that file
//! formats round to 0 are below it, and picture content is above it. Negative values are colours outside the gamut of
//! the primaries, and are compared like other values.
//!
//! NaN equals NaN, and an infinity equals itself. The difference of NaN or infinity from any other value has no value
//! in stops, and exceeds every tolerance.

use super::pu21::Light;
use super::{ChannelStops, Magnitudes, Measured, RadianceDifference, Unit, by_bands};
use crate::bracket::colour::Conversion;
use crate::merge::RadianceMap;
use crate::plane::Plane;
use crate::statistics::of_rank;
use crate::write::Metadata;

/// Fraction of the positive values that are below the floor f. Differences between values below f are divided by f.
const DARK: f64 = 0.001;
/// If the map is not calibrated, the luminance that is higher than in this fraction of the pixels counts as
/// [`BRIGHT_CD_M2`].
const BRIGHT: f64 = 0.999;
/// Assumed luminance at the percentile [`BRIGHT`] of a map that is not calibrated, in cd/m2.
const BRIGHT_CD_M2: f64 = 1000.0;
/// Largest number of values for a percentile; larger maps are sampled at every n-th pixel.
const SAMPLED: usize = 4_000_000;

/// Compares the map `b` with the map `a`, both of one size.
pub(super) fn measure(a: &RadianceMap, b: &RadianceMap, about: &Metadata) -> Measured {
    let converted = converted(b, a);
    let b = converted.as_ref().unwrap_or(b);
    let floor = floor(a).or_else(|| self::floor(b)).unwrap_or(1.0);
    let (plane, tallies) = stops(&a.pixels, &b.pixels, floor);
    let weights = a.primaries.luminance().map(|w| w as f32);
    let scale = match about.cd_m2_per_unit {
        Some(unit) => unit.get(),
        None => BRIGHT_CD_M2 / f64::from(bright(a, weights)),
    };
    let light = |pixels| Light { pixels, scale: scale as f32, weights };
    let (left, right) = (light(&a.pixels), light(&b.pixels));
    let names = ["red", "green", "blue"];
    let channels = [0, 1, 2].map(|c| tallies.channels[c].summary(names[c]));
    let all = tallies.channels.iter().fold(Channel::default(), Channel::merged).summary("");
    let radiance = RadianceDifference {
        floor: f64::from(floor),
        channels,
        rms_stops: all.rms_stops,
        mean_stops: all.mean_stops,
        not_comparable_pixels: tallies.not_comparable,
        cd_m2_per_unit: scale,
    };
    Measured::new(Magnitudes { plane, unit: Unit::Stops }, (&left, &right), Some(radiance), None)
}

/// Returns `map` converted to the primaries of `like`; `None` if it already has these primaries.
fn converted(map: &RadianceMap, like: &RadianceMap) -> Option<RadianceMap> {
    if map.primaries.is_close(&like.primaries, 1e-4) {
        return None;
    }
    let conversion = Conversion::between(&map.primaries, &like.primaries)?;
    let (width, height) = (map.pixels.width(), map.pixels.height());
    let pixels = Plane::from_rows(width, height, |y, row| {
        row.iter_mut().zip(map.pixels.row(y)).for_each(|(to, from)| *to = conversion.apply(*from));
    });
    Some(RadianceMap { pixels, primaries: like.primaries })
}

/// Returns the floor f of the module documentation; `None` if no value is positive.
fn floor(map: &RadianceMap) -> Option<f32> {
    let pixels = map.pixels.as_slice();
    let step = pixels.len().div_ceil(SAMPLED / 3).max(1);
    percentile(pixels.iter().step_by(step).flatten().copied(), DARK)
}

/// Returns the luminance at the percentile [`BRIGHT`]; 1 if no luminance is positive.
fn bright(map: &RadianceMap, weights: [f32; 3]) -> f32 {
    let pixels = map.pixels.as_slice();
    let luminance = |p: &[f32; 3]| weights[0] * p[0] + weights[1] * p[1] + weights[2] * p[2];
    let step = pixels.len().div_ceil(SAMPLED).max(1);
    percentile(pixels.iter().step_by(step).map(luminance), BRIGHT).unwrap_or(1.0)
}

/// Returns the value below which `share` of the positive and finite `values` are; `None` if there are no such values.
pub(super) fn percentile(values: impl Iterator<Item = f32>, share: f64) -> Option<f32> {
    let values: Vec<f32> = values.filter(|v| *v > 0.0 && v.is_finite()).collect();
    let last = values.len().checked_sub(1)?;
    of_rank(values, (share * last as f64).round() as usize)
}

/// Sums of one channel.
#[derive(Debug, Clone, Copy, Default)]
struct Channel {
    max: f64,
    sum: f64,
    squares: f64,
    count: usize,
}

impl Channel {
    fn add(&mut self, stops: f64) {
        self.max = self.max.max(stops.abs());
        self.sum += stops;
        self.squares += stops * stops;
        self.count += 1;
    }

    fn merged(self, other: &Channel) -> Channel {
        Channel {
            max: self.max.max(other.max),
            sum: self.sum + other.sum,
            squares: self.squares + other.squares,
            count: self.count + other.count,
        }
    }

    fn summary(&self, channel: &'static str) -> ChannelStops {
        let count = self.count.max(1) as f64;
        ChannelStops {
            channel,
            max_stops: self.max,
            rms_stops: (self.squares / count).sqrt(),
            mean_stops: self.sum / count,
        }
    }
}

#[derive(Debug, Default)]
struct Tally {
    channels: [Channel; 3],
    not_comparable: usize,
}

/// Returns for each pixel the difference of its worst channel in stops, and the sums over all pixels.
fn stops(a: &Plane<[f32; 3]>, b: &Plane<[f32; 3]>, floor: f32) -> (Plane<f32>, Tally) {
    let (plane, tallies) = by_bands((a.width(), a.height()), |tally: &mut Tally, at| {
        let (p, q) = (a.as_slice()[at], b.as_slice()[at]);
        let [Some(red), Some(green), Some(blue)] = [0, 1, 2].map(|c| difference(p[c], q[c], floor)) else {
            tally.not_comparable += 1;
            return f32::INFINITY;
        };
        let mut most = 0.0f32;
        for (channel, off) in tally.channels.iter_mut().zip([red, green, blue]) {
            channel.add(off);
            most = most.max(off.abs() as f32);
        }
        most
    });
    let total = tallies.iter().fold(Tally::default(), |sum, tally| Tally {
        channels: [0, 1, 2].map(|c| sum.channels[c].merged(&tally.channels[c])),
        not_comparable: sum.not_comparable + tally.not_comparable,
    });
    (plane, total)
}

/// Returns the difference from `a` to `b` in stops, positive if `b` is larger; `None` if it has no value in stops.
fn difference(a: f32, b: f32, floor: f32) -> Option<f64> {
    if a == b || a.is_nan() && b.is_nan() {
        return Some(0.0);
    }
    if !a.is_finite() || !b.is_finite() {
        return None;
    }
    let (a, b) = (f64::from(a), f64::from(b));
    let stops = libm::log2(1.0 + (a - b).abs() / a.min(b).max(f64::from(floor)));
    Some(if b > a { stops } else { -stops })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;

    fn map(pixels: Vec<[f32; 3]>, width: usize) -> RadianceMap {
        RadianceMap { pixels: Plane::from_vec(width, pixels.len() / width, pixels), primaries: Primaries::SRGB }
    }

    fn ramp(gain: f32) -> RadianceMap {
        map((0..6400).map(|i| [0.01, 0.02, 0.005].map(|v| gain * v * (1.0 + i as f32))).collect(), 80)
    }

    #[test]
    fn difference_in_stops_is_the_ratio_above_the_floor_and_finite_below() {
        // The relative rounding error of an `f32`, 6e-8, is 9e-8 stops.
        assert!((difference(3.0, 12.0, 1.0).unwrap() - 2.0).abs() < 1e-6);
        assert!((difference(12.0, 3.0, 1.0).unwrap() + 2.0).abs() < 1e-6);
        assert_eq!(difference(0.0, 1.0, 1.0), Some(1.0));
        assert_eq!(difference(-1.0, 0.0, 1.0), Some(1.0));
        assert!(difference(0.0, 1e-9, 1.0).unwrap() < 2e-9);
        assert_eq!(difference(f32::NAN, f32::NAN, 1.0), Some(0.0));
        assert_eq!(difference(f32::INFINITY, f32::INFINITY, 1.0), Some(0.0));
        for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert_eq!((difference(odd, 1.0, 1.0), difference(1.0, odd, 1.0)), (None, None));
        }
        assert_eq!(difference(f32::INFINITY, f32::NEG_INFINITY, 1.0), None);
    }

    #[test]
    fn gain_is_printed_with_its_sign() {
        let gain = libm::exp2(-0.02) as f32;
        let found = measure(&ramp(1.0), &ramp(gain), &Metadata::default());
        let gain = found.radiance.unwrap();
        // 0.1 % of the values are below the floor, where a gain gives a smaller difference.
        assert!((gain.mean_stops + 0.02).abs() < 2e-5 && (gain.rms_stops - 0.02).abs() < 2e-5, "{gain:?}");
        assert!(gain.channels.iter().all(|c| (c.max_stops - 0.02).abs() < 1e-5));
        assert!(found.magnitudes.plane.as_slice().iter().filter(|v| **v > 0.019).count() > 6300);
    }

    #[test]
    fn a_picture_of_one_value_is_not_taken_for_black() {
        let flat = |v: f32| map(vec![[v; 3]; 4096], 64);
        for other in [0.0, 0.5, 2.0] {
            let found = measure(&flat(1.0), &flat(other), &Metadata::default()).radiance.unwrap();
            assert!(found.channels.iter().all(|c| c.max_stops > 0.5), "{other}: {found:?}");
        }
        // No value of the expected map is positive, so the floor is computed from the actual map.
        let found = measure(&flat(0.0), &flat(3.0), &Metadata::default()).radiance.unwrap();
        assert!((found.channels[0].max_stops - 1.0).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn the_same_light_in_other_primaries_is_the_same() {
        let a = ramp(1.0);
        let conversion = Conversion::between(&Primaries::SRGB, &Primaries::BT2020).unwrap();
        let pixels = a.pixels.as_slice().iter().map(|p| conversion.apply(*p)).collect();
        let b = RadianceMap { pixels: Plane::from_vec(80, 80, pixels), primaries: Primaries::BT2020 };
        let there_and_back = measure(&a, &b, &Metadata::default()).radiance.unwrap();
        assert!(there_and_back.channels.iter().all(|c| c.max_stops < 1e-4), "{there_and_back:?}");
        let mislabelled = RadianceMap { primaries: Primaries::SRGB, ..b };
        let wrong = measure(&a, &mislabelled, &Metadata::default()).radiance.unwrap();
        assert!(wrong.channels.iter().any(|c| c.max_stops > 0.1), "{wrong:?}");
    }

    #[test]
    fn nan_in_one_file_only_is_counted() {
        let mut odd = ramp(1.0);
        odd.pixels.as_mut_slice()[7] = [f32::NAN, 1.0, 1.0];
        let found = measure(&ramp(1.0), &odd, &Metadata::default());
        assert_eq!(found.radiance.unwrap().not_comparable_pixels, 1);
        assert_eq!(found.magnitudes.plane.at(7, 0), f32::INFINITY);
        let both = measure(&odd.clone(), &odd, &Metadata::default());
        assert!(both.magnitudes.plane.as_slice().iter().all(|v| *v == 0.0));
    }
}
