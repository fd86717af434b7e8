//! The tone curve of a camera: high contrast in the shadows, and decreasing contrast towards white.
//!
//! In: the contrast of a camera's pictures, and the number of stops from the middle code value to white. Out: the code
//! value of a scene luminance, the scene luminance of a code value, and the colour in which a photograph shows a colour
//! of the scene. Cost: tables of 640 entries; one interpolation for each luminance, 40 for each colour. Source: the
//! parameters are those of the response ([`Photographed`](crate::merge::Photographed)); the shape was fitted to
//! fourteen responses recovered from photographs. It matches their slopes between code values 32 and 224 to within 6 %
//! (root mean square).
//!
//! Let d be the luminance on the display and s the luminance of the scene, both as logarithms to base 2. The slope at
//! the code value z is
//!
//! ```text
//! dd / ds = c (1 - k t(z)),    t = 0 up to code 64, rising linearly with the code to 1 at 255
//! ```
//!
//! where c and k follow from the contrast (the mean slope between codes 24 and 128) and from the stops from code 128 to
//! white. With c = 1 and k = 0, the luminances on the display are proportional to the luminances of the scene.

use crate::bracket::colour::{linear_to_srgb, srgb_to_linear};
use crate::simd::log2;
use crate::tonemap::display::luminance;

/// The tone curve of a camera.
pub(crate) struct Photograph {
    /// Code values, 0..=1, of scene luminances over the range [`STOPS`](Self::STOPS), with [`PER_STOP`](Self::PER_STOP)
    /// entries per stop.
    codes: Vec<f32>,
    /// Display luminance, relative to white, of each entry of `codes`.
    shown: Vec<f32>,
    /// Scene luminance, in stops from the middle code value, of each of [`STEPS`] equally spaced code values. The last
    /// code value is white.
    stops: Vec<f64>,
}

/// Steps from code value 0 to white: four for each 8-bit code value.
const STEPS: usize = 1020;
/// Code value up to which the slope is largest. Of the candidates 48, 64, 80 and 96, the values 48 and 64 match the
/// fourteen measured responses best: their slopes are wrong by 6.2 % and 6.3 %.
const SHADOWS: f64 = 64.0;
/// The mean slope between these two code values is the contrast, as [`Photographed`](crate::merge::Photographed)
/// measures it.
const CONTRAST_CODES: (usize, usize) = (24, 128);
/// Range of k. Near 1, the slope at white is almost 0; below 0, the slope increases towards white.
const LOSS: (f64, f64) = (-8.0, 0.9999);

impl Photograph {
    /// Number of table entries per stop.
    const PER_STOP: f32 = 32.0;
    /// Scene luminance of the first and of the last table entry, in stops from the middle code value.
    const STOPS: (f32, f32) = (-14.0, 6.0);

    /// Computes the curve that has this contrast below the middle code value, and reaches white `white_stops` stops
    /// above it.
    pub fn new(contrast: f64, white_stops: f64) -> Self {
        let (lights, stops) = curve(contrast, white_stops);
        let display = |stop: f64| {
            let above = stops.partition_point(|&s| s < stop);
            libm::exp2(match above {
                // The value below the first code value is extrapolated with the slope between the first two code
                // values.
                0 => lights[0] + (lights[1] - lights[0]) / (stops[1] - stops[0]) * (stop - stops[0]),
                STEPS => 0.0,
                _ => {
                    let part = (stop - stops[above - 1]) / (stops[above] - stops[above - 1]);
                    lights[above - 1] + part * (lights[above] - lights[above - 1])
                }
            })
        };
        let (first, last) = Self::STOPS;
        let count = ((last - first) * Self::PER_STOP) as usize;
        // The table has one more entry than the range, so that every entry up to the end of `STOPS` has a successor.
        let shown: Vec<f64> =
            (0..=count + 1).map(|i| display(f64::from(first) + i as f64 / f64::from(Self::PER_STOP))).collect();
        let codes = shown.iter().map(|shown| linear_to_srgb(*shown) as f32).collect();
        Photograph { codes, shown: shown.iter().map(|shown| *shown as f32).collect(), stops }
    }

    /// Returns the code value, 0..=1, of a scene luminance that is `stop` stops from the middle code value.
    pub fn code(&self, stop: f32) -> f32 {
        Self::at(&self.codes, stop)
    }

    fn at(table: &[f32], stop: f32) -> f32 {
        let (first, last) = Self::STOPS;
        let place = (stop.clamp(first, last) - first) * Self::PER_STOP;
        let (p, q) = (table[place as usize], table[place as usize + 1]);
        p + (place - place.floor()) * (q - p)
    }

    /// Returns the linear display colour of `colour` in a photograph that is exposed so that `colour` has the displayed
    /// luminance `display` (below 1). Multiplying `colour` by a factor does not change the result.
    pub fn showing(&self, colour: [f32; 3], display: f32) -> [f32; 3] {
        let stops = colour.map(|c| log2(c.max(f32::MIN_POSITIVE)));
        let exposed = |stop: f32| stops.map(|c| Self::at(&self.shown, c + stop));
        let (mut low, mut high) = Self::STOPS;
        // Bisection to a hundredth of a stop, then linear interpolation, so that similar colours stay similar.
        for _ in 0..11 {
            let stop = 0.5 * (low + high);
            if luminance(exposed(stop)) > display {
                high = stop;
            } else {
                low = stop;
            }
        }
        let (below, above) = (exposed(low), exposed(high));
        let part = (display - luminance(below)) / (luminance(above) - luminance(below)).max(f32::MIN_POSITIVE);
        std::array::from_fn(|c| below[c] + part.clamp(0.0, 1.0) * (above[c] - below[c]))
    }

    /// Returns the scene luminance of the code value `code`, 0..=1, in stops from the middle code value.
    pub fn stop(&self, code: f64) -> f64 {
        let place = (code * STEPS as f64 - 1.0).clamp(0.0, (STEPS - 1) as f64);
        let below = (place as usize).min(STEPS - 2);
        self.stops[below] + (place - below as f64) * (self.stops[below + 1] - self.stops[below])
    }
}

/// Returns for each of the [`STEPS`] code values above 0 the display luminance in stops from white, and the scene
/// luminance in stops from the middle code value.
fn curve(contrast: f64, white_stops: f64) -> (Vec<f64>, Vec<f64>) {
    let lights: Vec<f64> = (1..=STEPS).map(|i| libm::log2(srgb_to_linear(i as f64 / STEPS as f64))).collect();
    let at = |code: usize| code * STEPS / 255 - 1;
    let (first, middle) = (at(CONTRAST_CODES.0), at(CONTRAST_CODES.1));
    let (mut low, mut high) = LOSS;
    let mut slopes = Vec::new();
    // 40 halvings of the range of k, which is 9 wide, determine k to 1e-11.
    for _ in 0..40 {
        let k = 0.5 * (low + high);
        slopes = (1..STEPS).map(|i| 1.0 - k * past_shadows((i as f64 + 0.5) / STEPS as f64)).collect();
        let stops =
            |from: usize, to: usize| -> f64 { (from..to).map(|i| (lights[i + 1] - lights[i]) / slopes[i]).sum() };
        let c = contrast * stops(first, middle) / (lights[middle] - lights[first]);
        if stops(middle, STEPS - 1) / c < white_stops {
            low = k;
        } else {
            high = k;
        }
        slopes.iter_mut().for_each(|slope| *slope *= c);
    }
    let mut stops = vec![0.0; STEPS];
    for i in 1..STEPS {
        stops[i] = stops[i - 1] + (lights[i] - lights[i - 1]) / slopes[i - 1];
    }
    let zero = stops[middle];
    stops.iter_mut().for_each(|stop| *stop -= zero);
    (lights, stops)
}

/// Returns t of the module documentation, for a code value 0..=1.
fn past_shadows(code: f64) -> f64 {
    ((255.0 * code - SHADOWS) / (255.0 - SHADOWS)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_has_the_given_middle_white_and_slope() {
        for (contrast, white_stops) in [(1.0, 2.3), (1.4, 2.6), (1.75, 2.7), (1.0, 6.0), (1.0, 1.2)] {
            let photograph = Photograph::new(contrast, white_stops);
            let code = |stop: f64| f64::from(photograph.code(stop as f32));
            assert!((code(0.0) - 128.0 / 255.0).abs() < 1e-4);
            // The curve has a corner at white, which lies between two table entries. The code values of these entries
            // differ by up to 0.02, and linear interpolation cuts the corner by at most a quarter of this.
            assert!((code(white_stops) - 1.0).abs() < 6e-3 && code(white_stops + 1.0) > 0.9999);
            let light = |code: f64| libm::log2(srgb_to_linear(code / 255.0));
            let slope = (light(128.0) - light(24.0)) / (photograph.stop(128.0 / 255.0) - photograph.stop(24.0 / 255.0));
            assert!((slope - contrast).abs() < 1e-3, "{slope}");
            // The curve rises, and `stop` is the inverse of `code`.
            assert!((-400..600).all(|i| code(f64::from(i) / 100.0) <= code(f64::from(i + 1) / 100.0)));
            for of in [0.1, 0.4, 0.6, 0.9] {
                assert!((code(photograph.stop(of)) - of).abs() < 2e-3, "{of}: {}", code(photograph.stop(of)));
            }
        }
    }

    #[test]
    fn a_display_s_own_curve_is_one_of_them() {
        let white = -libm::log2(srgb_to_linear(128.0 / 255.0));
        let photograph = Photograph::new(1.0, white);
        // The last table entry below white is at 2.19 stops. The tested range ends before it, because the interval
        // after this entry contains the corner at white.
        for stop in (-400..218).map(|i| f64::from(i) / 100.0) {
            let expected = linear_to_srgb(libm::exp2(stop - white));
            let found = f64::from(photograph.code(stop as f32));
            // The tolerance covers two errors. Linear interpolation over h = 1/32 stop has an error of h^2 / 8 times
            // the largest second derivative (0.11), which is 1.3e-5. The other error is from the bisection.
            assert!((found - expected).abs() < 1e-4, "{stop}: {found} for {expected}");
        }
    }

    #[test]
    fn colours_have_the_given_luminance_and_desaturate_towards_white() {
        let photograph = Photograph::new(1.4, 2.6);
        let (wood, grey) = ([2.6, 0.55, 0.16], [1.0; 3]);
        let hue = |[r, g, b]: [f32; 3]| (g - b) / (r - b);
        let mut before = 0.0;
        for display in [0.02, 0.1, 0.3, 0.6, 0.9] {
            for colour in [wood, grey] {
                let found = luminance(photograph.showing(colour, display));
                // Luminance is linear in the interpolated channels, so that only rounding remains.
                assert!((found / display - 1.0).abs() < 1e-4, "{found} for {display}");
            }
            let [r, g, b] = photograph.showing(grey, display);
            assert!((r - g).abs() < 1e-6 && (r - b).abs() < 1e-6);
            // Red saturates first, then green, then blue.
            let wooden = hue(photograph.showing(wood, display));
            assert!(wooden > before, "{wooden} at {display}");
            before = wooden;
        }
    }
}
