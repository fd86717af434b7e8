//! Brightness and contrast with which the photographs displayed the radiance, for tone mapping and for headers.
//!
//! In: the exposures of the merged frames, and the response. Out: [`Photographed`], which headers carry as a comment.
//! Cost: none.

use crate::bracket::colour::srgb_to_linear;
use crate::response::ResponseCurve;
use std::fmt;

/// The radiance that the photographs show as the middle code value 128, and the contrast of the photographs there.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Photographed {
    /// Radiance at the middle code value of the longest exposure, which shows the shadows.
    pub longest: f64,
    /// Radiance at the middle code value of the shortest exposure, which shows the highlights. For locally processed
    /// frames, it is multiplied by the factor by which the local gain brightens white in the shortest frame.
    pub shortest: f64,
    /// Displayed contrast below the middle code value, in displayed stops per stop of the scene: 1 to 1.85. Cameras
    /// increase contrast, and with it saturation.
    pub contrast: f64,
    /// Stops from the middle code value to the last one.
    pub white_stops: f64,
}

/// Code values from which the contrast is computed: the darker half, without the darkest code values.
const DARKER: std::ops::RangeInclusive<usize> = 24..=128;
/// Smallest and largest contrast. If the contrast is larger, the code values are not made for a display: linear code
/// values have a contrast of 1.93.
const CONTRASTS: (f64, f64) = (1.0, 1.85);
/// Smallest and largest number of stops from the middle code value to white; sRGB has 2.2.
const WHITES: (f64, f64) = (1.2, 6.0);
/// Code value that is used as white: the last one that is not clipped.
const LAST: usize = 254;

/// The text before each number in a header comment.
const WORDS: (&str, &str, &str, &str) =
    ("middle code of the photographs: radiance ", " to ", ", contrast ", ", stops to white ");

impl Photographed {
    /// Returns the values for frames with these relative `exposures`. `unit` is the exposure of the reference frame,
    /// which has its middle code value at radiance 1. `None` without exposures.
    pub fn of(exposures: impl Iterator<Item = f64>, unit: f64, curve: &ResponseCurve) -> Option<Self> {
        let middles: Vec<f64> = exposures.map(|exposure| unit / exposure).filter(|m| m.is_finite()).collect();
        let longest = middles.iter().copied().min_by(f64::total_cmp)?;
        let shortest = middles.iter().copied().max_by(f64::total_cmp)?;
        Some(Photographed { longest, shortest, contrast: contrast(curve), white_stops: white(curve) })
    }

    /// Returns the values for radiance multiplied by `factor`.
    pub fn times(self, factor: f64) -> Self {
        Photographed { longest: self.longest * factor, shortest: self.shortest * factor, ..self }
    }

    /// Parses the `comments` of a header. `None` if no comment has valid values.
    pub fn read<'a>(comments: impl IntoIterator<Item = &'a String>) -> Option<Self> {
        comments.into_iter().find_map(|comment| {
            let (_, numbers) = comment.split_once(WORDS.0)?;
            let (longest, rest) = numbers.split_once(WORDS.1)?;
            let (shortest, rest) = rest.split_once(WORDS.2)?;
            let (contrast, rest) = rest.split_once(WORDS.3)?;
            let end = rest.find([';', ' ', '\n']).unwrap_or(rest.len());
            let numbers = [longest, shortest, contrast, &rest[..end]].map(|v| v.parse().unwrap_or(0.0));
            let [longest, shortest, contrast, white_stops] = numbers;
            let are_some = longest > 0.0 && longest <= shortest && f64::is_finite(shortest);
            let is_contrast = (CONTRASTS.0..=CONTRASTS.1).contains(&contrast);
            let is_white = (WHITES.0..=WHITES.1).contains(&white_stops);
            (are_some && is_contrast && is_white).then_some(Photographed { longest, shortest, contrast, white_stops })
        })
    }
}

/// Fits a line to the logarithm of displayed luminance as a function of the logarithm of scene luminance, over the
/// darker code values, and returns its slope. Returns 1 if the code values are not made for displays.
fn contrast(curve: &ResponseCurve) -> f64 {
    let (mut n, mut x, mut y, mut xx, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (channel, code) in (0..3).flat_map(|channel| DARKER.map(move |code| (channel, code))) {
        let light = libm::log2(f64::from(curve.exposures(channel)[code]));
        let shown = libm::log2(srgb_to_linear(code as f64 / 255.0));
        (n, x, y, xx, xy) = (n + 1.0, x + light, y + shown, xx + light * light, xy + light * shown);
    }
    let slope = (n * xy - x * y) / (n * xx - x * x);
    if (CONTRASTS.0..=CONTRASTS.1).contains(&slope) { slope } else { CONTRASTS.0 }
}

impl fmt::Display for Photographed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Photographed { longest, shortest, contrast, white_stops } = self;
        let (before, to, third, last) = WORDS;
        write!(f, "{before}{longest}{to}{shortest}{third}{contrast}{last}{white_stops}")
    }
}

/// Returns the number of stops from the middle code value to the last unclipped one, as the mean of the channels.
fn white(curve: &ResponseCurve) -> f64 {
    let stops = |c: usize| libm::log2(f64::from(curve.exposures(c)[LAST]) / f64::from(curve.exposures(c)[128]));
    ((0..3).map(stops).sum::<f64>() / 3.0).clamp(WHITES.0, WHITES.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comment_is_read_back_exactly_and_an_invalid_one_is_ignored() {
        let curve = ResponseCurve::srgb();
        let some = Photographed::of([0.3, 1.0 / 3.0, 7.0].into_iter(), 1.0 / 3.0, &curve).unwrap().times(0.1);
        assert_eq!((some.longest, some.shortest), (1.0 / 3.0 / 7.0 * 0.1, 1.0 / 3.0 / 0.3 * 0.1));
        for comment in [some.to_string(), format!("by hand; {some}; more to come")] {
            assert_eq!(Photographed::read(&[String::from("other"), comment]), Some(some));
        }
        let before = "middle code of the photographs: radiance ";
        for odd in ["-1 to 2, contrast 1", "3 to 2, contrast 1", "1 to 2, contrast 9", "1 to NaN, contrast 1", "1 to 2"]
        {
            assert_eq!(Photographed::read(&[format!("{before}{odd}, stops to white 2.2")]), None, "{odd}");
        }
        assert_eq!(Photographed::of(std::iter::empty(), 1.0, &curve), None);
    }

    #[test]
    fn contrast_is_that_of_the_curve_over_a_display_s() {
        let of = |curve: &ResponseCurve| Photographed::of([1.0].into_iter(), 1.0, curve).unwrap().contrast;
        assert!((of(&ResponseCurve::srgb()) - 1.0).abs() < 1e-3, "{}", of(&ResponseCurve::srgb()));
        // With this curve, a display shows the scene's light raised to the power of 1.5.
        let ln = |code: usize| srgb_to_linear(f64::max(code as f64, 0.5) / 255.0).ln() / 1.5;
        let steeper = ResponseCurve::new([std::array::from_fn(ln); 3]).unwrap();
        assert!((of(&steeper) - 1.5).abs() < 1e-3, "{}", of(&steeper));
        let white = |curve: &ResponseCurve| Photographed::of([1.0].into_iter(), 1.0, curve).unwrap().white_stops;
        assert!((white(&ResponseCurve::srgb()) - 2.2).abs() < 0.02 && (white(&steeper) - 2.2 / 1.5).abs() < 0.02);
        // Linear code values are not made for a display.
        assert_eq!(of(&ResponseCurve::linear()), 1.0);
    }
}
