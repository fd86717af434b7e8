//! Drago's adaptive logarithmic mapping: a logarithm whose base increases with luminance, which lifts dark parts and
//! compresses bright ones.
//!
//! In: a scene. Out: its tones, by one curve for all pixels. Cost: nothing per pixel beyond the mapping in `tones`.
//! Source: Drago, Myszkowski, Annen, Chiba, "Adaptive Logarithmic Mapping for Displaying High Contrast Scenes" (2003),
//! section 3, equations 1 to 4.

use crate::tonemap::guide::Guide;
use crate::tonemap::overview::Scene;
use crate::tonemap::settings::Setting;
use crate::tonemap::tones::{Curve, Tones};

/// Settings of the operator.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Options {
    /// The bias b, 0.5 to 1: smaller values brighten the dark parts. The paper uses 0.85.
    pub bias: f64,
    /// Factor on the saturation that Mantiuk's colour correction gives (see `tones`): 1 looks as colourful as the
    /// scene, 0 is grey.
    pub saturation: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { bias: 0.85, saturation: 1.0 }
    }
}

impl Options {
    /// Returns the settings, each with its name, range and description.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::number("bias", (0.5, 1.0), &mut self.bias, "smaller values brighten the dark parts"),
            Setting::saturation(&mut self.saturation),
        ]
    }
}

/// Share of the pixels that may be clipped to white, so that a sun does not darken the rest.
const CLIPPED: f64 = 0.001;

/// Returns the tones of `scene`.
pub fn drago(scene: &Scene, options: &Options) -> Tones {
    let average = scene.average_within((scene.percentile(0.001), scene.percentile(0.999)));
    // Section 3: the adaptation luminance, adjusted for the bias.
    let adaptation = average - 5.0 * libm::log2(1.0 + options.bias - 0.85);
    let most = libm::exp2(scene.percentile(1.0 - CLIPPED) - adaptation);
    let power = libm::log(options.bias.clamp(0.5, 0.999)) / libm::log(0.5);
    // Equation 4, with L_dmax = 100 cd/m2.
    let display = |l: f64| {
        let base = 2.0 + 8.0 * libm::pow(l / most, power);
        libm::log(l + 1.0) / (libm::log10(most + 1.0) * libm::log(base))
    };
    let slope = |v: f64| libm::log2(display(libm::exp2(v + 0.05)) / display(libm::exp2(v - 0.05))) / 0.1;
    let curve = Curve::new(|v| display(libm::exp2(v).min(most)), slope, options.saturation);
    Tones::new(scene.to_srgb, Guide::shifted(-adaptation), curve, scene.size.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;
    use crate::plane::Plane;
    use crate::tonemap::overview::Overview;

    /// The expected values are equation 4 as printed, on a ramp. The tolerance covers the rounding of code values and
    /// the linear interpolation of the curve.
    #[test]
    fn codes_are_those_of_the_equation() {
        let light = |x: usize| libm::exp2(x as f64 / 50.0);
        let map =
            Plane::from_rows(600, 20, |_, row| row.iter_mut().enumerate().for_each(|(x, p)| *p = [light(x) as f32; 3]));
        let mut overview = Overview::new((600, 20), &Primaries::SRGB);
        overview.see(0, &map);
        let scene = overview.scene().unwrap();
        for bias in [0.7, 0.85, 0.95] {
            let picture = drago(&scene, &Options { bias, ..Options::default() }).picture(&map);
            let adapted = libm::exp2(599.0 / 50.0 / 2.0) / libm::pow(1.0 + bias - 0.85, 5.0);
            let most = light(599) / adapted;
            for x in (0..600).step_by(7) {
                let l = light(x) / adapted;
                let base = 2.0 + libm::pow(l / most, libm::log(bias) / libm::log(0.5)) * 8.0;
                let display = libm::log(l + 1.0) / libm::log(base) / libm::log10(most + 1.0);
                let code = 255.0 * crate::bracket::colour::linear_to_srgb(display);
                // The percentiles of the scene are exact only to 1/50 stop, which is one step of the ramp.
                assert!((f64::from(picture.at(x, 3)[1]) - code).abs() < 2.0, "{bias} {x}: {code}");
            }
        }
    }
}
