//! What a camera makes of light for a display: a power of it below the middle code, and a shoulder above.
//!
//! In: how contrasty a camera's pictures are, and how much light makes them white. Out: the code of any light, the light of a code, and the colour in which
//! a photograph shows a light. Cost: tables of 640 entries, and an interpolation for each light; 40 of them for each colour. Source: the shape is ours; the numbers are of the response
//! ([`Photographed`](crate::merge::Photographed)).

use super::display::luminance;
use crate::bracket::colour::{linear_to_srgb, srgb_to_linear};
use crate::simd::log2;

/// The curve of a camera.
pub(super) struct Photograph {
    /// Codes by log2 of the light, of 1 where the middle code is.
    codes: Vec<f32>,
    /// What a display makes of them, relative to white.
    shown: Vec<f32>,
    contrast: f64,
    white_stops: f64,
}

impl Photograph {
    /// Entries to a stop; the stop of the first, and of the last, from the middle code's.
    const PER_STOP: f32 = 32.0;
    const STOPS: (f32, f32) = (-14.0, 6.0);

    /// Of a camera with this contrast below the middle code and so many stops from there to white.
    pub fn new(contrast: f64, white_stops: f64) -> Self {
        let mut photograph = Photograph { codes: Vec::new(), shown: Vec::new(), contrast, white_stops };
        let (first, last) = Self::STOPS;
        let count = ((last - first) * Self::PER_STOP) as usize;
        let stop = |i: usize| f64::from(first) + i as f64 / f64::from(Self::PER_STOP);
        // One more, so that every entry has a next one.
        let shown: Vec<f64> = (0..=count + 1).map(|i| photograph.display(stop(i))).collect();
        photograph.codes = shown.iter().map(|shown| linear_to_srgb(*shown) as f32).collect();
        photograph.shown = shown.iter().map(|shown| *shown as f32).collect();
        photograph
    }

    /// How many times as steep the shoulder begins as the straight line to white.
    fn bend(&self) -> f64 {
        (self.contrast * self.white_stops / -libm::log2(middle())).max(1.0)
    }

    /// The luminance, relative to white, of light that is `stop` stops above what has the middle code.
    fn display(&self, stop: f64) -> f64 {
        if stop <= 0.0 {
            return middle() * libm::exp2(self.contrast * stop);
        }
        // From the middle to white as log2 rises from the one to the other, with the slope below at its beginning and none at its end.
        let left = libm::pow((1.0 - stop / self.white_stops).max(0.0), self.bend());
        libm::exp2(libm::log2(middle()) * left)
    }

    /// The code, 0..=1, of such light.
    pub fn code(&self, stop: f32) -> f32 {
        Self::at(&self.codes, stop)
    }

    fn at(table: &[f32], stop: f32) -> f32 {
        let (first, last) = Self::STOPS;
        let place = (stop.clamp(first, last) - first) * Self::PER_STOP;
        let (p, q) = (table[place as usize], table[place as usize + 1]);
        p + (place - place.floor()) * (q - p)
    }

    /// Linear light of the display where a photograph shows light of this `colour`, any multiple of it, so bright that its luminance is `display`, below 1.
    pub fn showing(&self, colour: [f32; 3], display: f32) -> [f32; 3] {
        let stops = colour.map(|c| log2(c.max(f32::MIN_POSITIVE)));
        let exposed = |stop: f32| stops.map(|c| Self::at(&self.shown, c + stop));
        let (mut low, mut high) = Self::STOPS;
        // To a hundredth of a stop, and straight between, so that what differs little is shown nearly alike.
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

    /// The stop of light that has the `code`, below 1.
    pub fn stop(&self, code: f64) -> f64 {
        let stops = libm::log2(srgb_to_linear(code) / middle());
        if stops <= 0.0 {
            return stops / self.contrast;
        }
        let left = 1.0 + stops / libm::log2(middle());
        self.white_stops * (1.0 - libm::pow(left, 1.0 / self.bend()))
    }
}

/// The luminance of the middle code, 128, relative to display white.
fn middle() -> f64 {
    srgb_to_linear(128.0 / 255.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_and_white_are_where_they_were_asked_for_and_the_slope_below() {
        for (contrast, white_stops) in [(1.0, 2.3), (1.4, 2.6), (1.75, 2.7), (1.0, 6.0), (1.0, 1.2)] {
            let photograph = Photograph::new(contrast, white_stops);
            let code = |stop: f64| f64::from(photograph.code(stop as f32));
            assert!((code(0.0) - 128.0 / 255.0).abs() < 1e-4);
            // White lies within a piece of the table, which a straight line of up to 0.02 of a code's range crosses.
            assert!((code(white_stops) - 1.0).abs() < 6e-3 && code(white_stops + 1.0) > 0.9999);
            let shown = |stop: f64| libm::log2(srgb_to_linear(code(stop)));
            assert!((shown(-1.0) - shown(-2.0) - contrast).abs() < 0.01, "{}", shown(-1.0) - shown(-2.0));
            // It rises, and the stop of a code is where the code is.
            assert!((-400..600).all(|i| code(f64::from(i) / 100.0) <= code(f64::from(i + 1) / 100.0)));
            for of in [0.1, 0.4, 0.6, 0.9] {
                assert!((code(photograph.stop(of)) - of).abs() < 2e-3, "{of}: {}", code(photograph.stop(of)));
            }
        }
    }

    #[test]
    fn colours_are_shown_at_the_luminance_asked_for_paler_and_yellower_towards_white() {
        let photograph = Photograph::new(1.4, 2.6);
        let (wood, grey) = ([2.6, 0.55, 0.16], [1.0; 3]);
        let hue = |[r, g, b]: [f32; 3]| (g - b) / (r - b);
        let mut before = 0.0;
        for display in [0.02, 0.1, 0.3, 0.6, 0.9] {
            for colour in [wood, grey] {
                let found = luminance(photograph.showing(colour, display));
                // Roundings of a hundredth of a stop's rise.
                assert!((found / display - 1.0).abs() < 1e-4, "{found} for {display}");
            }
            let [r, g, b] = photograph.showing(grey, display);
            assert!((r - g).abs() < 1e-6 && (r - b).abs() < 1e-6);
            // Red is at its end first, and green catches up before blue.
            let wooden = hue(photograph.showing(wood, display));
            assert!(wooden > before, "{wooden} at {display}");
            before = wooden;
        }
    }
}
