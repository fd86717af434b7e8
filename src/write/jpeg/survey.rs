//! Survey of radiance and picture: determines the white and the range of gains for the gain map.
//!
//! In: radiance by rows, and the codes of the picture for them. Out: a [`Rendition`]. Cost: work on about 200,000
//! pixels. Source: see `gain_map`.

use super::gain_map::{Base, GRAIN, MOST_FALL, MOST_STOPS, OFFSET, Rendition, ToBase, lit, shown};
use crate::bracket::colour::Primaries;
use crate::plane::Plane;
use crate::tonemap::display::codes::Colours;
use crate::tonemap::display::luminance;
use rayon::prelude::*;

/// Largest number of pixels that are sampled, approximately.
const SEEN: usize = 200_000;

/// Samples of the radiance and the picture.
#[derive(Debug, Clone)]
pub struct Survey {
    to_base: ToBase,
    width: usize,
    step: usize,
    /// For each sampled pixel, the radiance in the primaries of the picture, and the codes of the picture.
    seen: Vec<([f32; 3], [u8; 3])>,
}

impl Survey {
    /// Creates a survey of a picture of `size` pixels with `colours`, and radiance with `primaries`.
    pub fn new(size: (usize, usize), primaries: &Primaries, colours: Colours) -> Self {
        let mut step = 1;
        while (size.0 / step) * (size.1 / step) > SEEN {
            step += 1;
        }
        Survey { to_base: ToBase::of(primaries, colours), width: size.0, step, seen: Vec::new() }
    }

    /// Adds samples of the rows `pixels`, from row `first` on; `show` writes the codes of a row, given its number and
    /// its radiance.
    pub fn see(
        &mut self,
        first: usize,
        pixels: &Plane<[f32; 3]>,
        show: impl Fn(usize, &[[f32; 3]], &mut [[u8; 3]]) + Sync,
    ) {
        let (step, to_base) = (self.step, self.to_base);
        let rows: Vec<usize> = (0..pixels.height()).filter(|y| (first + y).is_multiple_of(step)).collect();
        let seen = rows.par_iter().map_init(
            || vec![[0; 3]; self.width],
            |codes, &y| {
                let row = pixels.row(y);
                show(first + y, row, codes);
                let pairs = row.iter().zip(codes.iter()).step_by(step);
                pairs.map(|(&p, &code)| (to_base.apply(p).map(lit), code)).collect::<Vec<_>>()
            },
        );
        let seen: Vec<_> = seen.collect();
        self.seen.extend(seen.into_iter().flatten());
    }

    /// Returns the rendition for the samples. `white` is the radiance that is shown as the picture's white; for `None`,
    /// it is chosen so that radiance and picture agree in the mid-tones.
    pub fn rendition(self, white: Option<f32>) -> Rendition {
        let white = white.filter(|w| w.is_finite() && *w > 0.0).unwrap_or_else(|| self.white());
        let base = Base::new();
        let scale = 1.0 / white;
        let (mut gains, mut peaks) = (Vec::new(), Vec::new());
        for (light, codes) in &self.seen {
            let light = light.map(|v| shown(v, scale));
            peaks.push(light[0].max(light[1]).max(light[2]));
            // The gain of codes close to black is not reliable.
            let reliable = light.iter().zip(codes).filter(|(_, code)| **code >= LEAST_CODE);
            gains.extend(reliable.map(|(&v, &code)| (libm::log2(f64::from(v) + OFFSET) - base.stops(code)) as f32));
        }
        gains.sort_unstable_by(f32::total_cmp);
        peaks.sort_unstable_by(f32::total_cmp);
        let at = |sorted: &[f32], share: f64| {
            let place = (sorted.len().saturating_sub(1) as f64 * share) as usize;
            sorted.get(place).copied().map_or(0.0, f64::from)
        };
        let least = (at(&gains, 0.001) * GRAIN).floor() / GRAIN;
        // A few very bright pixels must not reduce the precision of all other pixels.
        let most = (at(&gains, 0.9999) * GRAIN).ceil() / GRAIN;
        // The range must not be 0, because it is a divisor.
        let least = least.clamp(-MOST_FALL, 0.0) + 0.0;
        let most = most.clamp(0.0, MOST_STOPS).max(least + 0.125);
        let headroom = (libm::log2(at(&peaks, 0.998).max(1.0)) * GRAIN).round() / GRAIN;
        Rendition {
            white,
            least_stops: least,
            most_stops: most,
            headroom_stops: headroom.clamp(LEAST_HEADROOM, MOST_STOPS),
        }
    }

    /// Returns the white for which radiance and picture agree in the median of the mid-tones, or of all pixels if
    /// there are few mid-tones.
    fn white(&self) -> f32 {
        let of_code = Base::new().linear;
        let mut all = Vec::new();
        let mut middle = Vec::new();
        for (light, codes) in &self.seen {
            let (radiance, display) = (luminance(*light), luminance(codes.map(|code| of_code[usize::from(code)])));
            if radiance > 0.0 && radiance.is_finite() && display > 0.0 {
                let ratio = radiance / display;
                all.push(ratio);
                if MIDDLE.contains(&display) {
                    middle.push(ratio);
                }
            }
        }
        let mut ratios = if middle.len() * 100 >= all.len() { middle } else { all };
        ratios.sort_unstable_by(f32::total_cmp);
        let median = ratios.get(ratios.len() / 2).copied();
        median.filter(|w| w.is_normal()).unwrap_or(1.0)
    }
}

/// Luminance of the mid-tones of the picture, where 1 is white: about code values 63 to 188.
const MIDDLE: std::ops::RangeInclusive<f32> = 0.05..=0.5;

/// Smallest code value of the picture whose gain is used to determine the range of the map.
const LEAST_CODE: u8 = 8;

/// Smallest headroom in stops; not 0, because readers divide by it.
const LEAST_HEADROOM: f64 = 0.5;
