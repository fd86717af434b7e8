//! Tone mapping: radiance to a display-encoded picture.
//!
//! In: a [`RadianceMap`] in any unit and primaries, whole or row by row. Out: a [`DisplayImage`] (8-bit sRGB) or rows
//! of [`codes`](display::codes). Each [`Operator`] implements a published operator in a file of [`operators`], or is
//! [`natural`]. It analyses an `overview` of the whole scene, a grid of at most a million cells, and returns `tones`,
//! which map the rows. All operators share the encoding, and all but `natural` share the treatment of colour and the
//! gamut mapping: see `tones`, [`display`] and [`codes`](display::codes). Cost: see each operator.

pub mod adjust;
pub mod display;
pub mod fusion;
mod guide;
pub mod natural;
pub mod operators;
pub(crate) mod overview;
pub(crate) mod resize;
pub mod settings;
mod solvers;
pub(crate) mod tones;

use crate::error::Result;
use crate::merge::{Photographed, RadianceMap};
use crate::plane::Plane;
use overview::{Overview, Scene};
use settings::Setting;
use strum::{EnumMessage, IntoEnumIterator};
use tones::Tones;

/// A display-encoded picture: 8-bit, sRGB transfer and primaries.
#[derive(Debug, Clone, PartialEq)]
pub struct DisplayImage {
    /// RGB by rows.
    pub pixels: Plane<[u8; 3]>,
}

/// A tone mapping operator with its settings.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[serde(tag = "name", rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum Operator {
    /// Local: computes exposures from the radiance and fuses them; keeps the colours of the photographs.
    Natural(natural::Options),
    /// Global: one curve, soft highlights. Reinhard et al. 2002.
    Reinhard02(operators::reinhard::Options),
    /// Local: brightens and darkens areas, as dodging and burning. Reinhard et al. 2002.
    Reinhard02Local(operators::reinhard::Options),
    /// Global: one curve, bright shadows. Drago et al. 2003.
    Drago(operators::drago::Options),
    /// Local: compresses large differences of brightness, keeps fine detail. Durand & Dorsey 2002.
    Durand(operators::durand::Options),
    /// Local: strong local contrast, dramatic. Fattal et al. 2002.
    Fattal(operators::fattal::Options),
    /// Local: reduces contrasts of every size, from fine detail to large areas. Mantiuk et al. 2006.
    Mantiuk06(operators::mantiuk06::Options),
    /// Global: computes one curve for the scene, the display and the room light. Mantiuk et al. 2008.
    Mantiuk08(operators::mantiuk08::Options),
}

impl Default for Operator {
    fn default() -> Self {
        Operator::Natural(natural::Options::default())
    }
}

impl Operator {
    /// Returns the name used on the command line and in reports.
    pub fn name(&self) -> &'static str {
        self.into()
    }

    /// Returns the settings of this operator.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        match self {
            Operator::Natural(options) => options.settings(),
            Operator::Reinhard02(options) | Operator::Reinhard02Local(options) => options.settings(),
            Operator::Drago(options) => options.settings(),
            Operator::Durand(options) => options.settings(),
            Operator::Fattal(options) => options.settings(),
            Operator::Mantiuk06(options) => options.settings(),
            Operator::Mantiuk08(options) => options.settings(),
        }
    }

    /// Checks that every setting is within its range.
    ///
    /// # Errors
    /// [`Error::Option`](crate::error::Error::Option) for the first setting that is out of range.
    pub fn validate(&self) -> Result<()> {
        settings::validate(&self.clone().settings(), self.name())
    }

    /// Analyses `scene` and returns its tone mapping.
    pub fn tones(&self, scene: &Scene) -> Tones {
        // A uniform scene has no dark and bright parts to adapt to.
        if scene.is_uniform() {
            return Tones::as_photographed(scene.to_srgb, scene.size.0);
        }
        match self {
            Operator::Natural(options) => natural::natural(scene, options),
            Operator::Reinhard02(options) => operators::reinhard::global(scene, options),
            Operator::Reinhard02Local(options) => operators::reinhard::local(scene, options),
            Operator::Drago(options) => operators::drago::drago(scene, options),
            Operator::Durand(options) => operators::durand::durand(scene, options),
            Operator::Fattal(options) => operators::fattal::fattal(scene, options),
            Operator::Mantiuk06(options) => operators::mantiuk06::mantiuk06(scene, options),
            Operator::Mantiuk08(options) => operators::mantiuk08::mantiuk08(scene, options),
        }
    }
}

/// How the picture is made.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[serde(untagged)]
pub enum Rendering {
    /// From the radiance, by a tone mapping operator.
    Toned(Operator),
    /// From the aligned frames, by exposure fusion.
    Fused(fusion::Options),
}

impl Default for Rendering {
    fn default() -> Self {
        Rendering::Toned(Operator::default())
    }
}

impl Rendering {
    /// Returns every rendering with its default settings, each with a description of one line.
    pub fn every() -> Vec<(Rendering, &'static str)> {
        let toned = Operator::iter().map(|operator| {
            let about = operator.get_documentation().unwrap_or_default();
            (Rendering::Toned(operator), about)
        });
        let fused = (
            Rendering::Fused(fusion::Options::default()),
            "Fusion of the aligned frames, without radiance. Mertens et al. 2007.",
        );
        toned.chain([fused]).collect()
    }

    /// Returns the name used on the command line and in reports.
    pub fn name(&self) -> &'static str {
        match self {
            Rendering::Toned(operator) => operator.name(),
            Rendering::Fused(_) => "mertens",
        }
    }

    /// Returns the settings of this rendering.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        match self {
            Rendering::Toned(operator) => operator.settings(),
            Rendering::Fused(options) => options.settings(),
        }
    }

    /// Checks that every setting is within its range.
    ///
    /// # Errors
    /// [`Error::Option`](crate::error::Error::Option) for the first setting that is out of range.
    pub fn validate(&self) -> Result<()> {
        settings::validate(&self.clone().settings(), self.name())
    }

    /// Sets `key` to `value`.
    ///
    /// # Errors
    /// [`Error::Option`](crate::error::Error::Option) when there is no such setting or the value is out of range.
    pub fn set(&mut self, key: &str, value: f64) -> Result<()> {
        let name = self.name();
        settings::set(self.settings(), name, key, value)
    }
}

/// Tone-maps `radiance` with `operator`.
///
/// `photographed` describes the photographs that the radiance was merged from, if they are known. The
/// [settings](Operator::settings) of the operator must be within their ranges. Multiplying the radiance by a factor
/// does not change the picture, with three exceptions: a setting fixes the scale; the radiance is uniform; or
/// [`natural`] is used with radiances in `photographed` that are not multiplied by the same factor.
pub fn tonemap(radiance: &RadianceMap, photographed: Option<Photographed>, operator: &Operator) -> DisplayImage {
    let pixels = &radiance.pixels;
    let mut overview = Overview::new((pixels.width(), pixels.height()), &radiance.primaries).photographed(photographed);
    overview.see(0, pixels);
    let tones = overview.scene().map_or_else(|| Tones::black(pixels.width()), |scene| operator.tones(&scene));
    DisplayImage { pixels: tones.picture(pixels) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;

    #[test]
    fn setting_out_of_range_is_an_error_that_names_it() {
        assert!(Operator::iter().all(|operator| operator.validate().is_ok()));
        assert!(Rendering::Fused(fusion::Options::default()).validate().is_ok());
        for reach in [f64::NAN, -1.0, 1e9] {
            let durand =
                Operator::Durand(operators::durand::Options { reach, ..operators::durand::Options::default() });
            let error = durand.validate().unwrap_err();
            assert!(error.is_usage() && error.to_string().contains("`reach` of `durand`"), "{error}");
        }
    }

    /// A property test found this error: for luminances above 2^127 times the key, the local shoulder function gave
    /// NaN, and the index into the tone table was computed from this NaN.
    #[test]
    fn extreme_floats_give_a_picture() {
        let ends = [[f32::MAX; 3], [1e-45; 3], [1.0; 3], [1e-30, 1.0, f32::MAX], [0.0; 3], [1e30, 1e-30, 0.0]];
        for operator in Operator::iter() {
            for side in [2usize, 6, 40] {
                let pixels = (0..side * side).map(|i| ends[(i * 7 + i / side) % ends.len()]).collect();
                let pixels = Plane::from_vec(side, side, pixels);
                let picture = tonemap(&RadianceMap { pixels, primaries: Primaries::SRGB }, None, &operator).pixels;
                assert_eq!((picture.width(), picture.height()), (side, side), "{}", operator.name());
            }
        }
    }

    /// The expected values are computed by hand. Radiance 1 has the middle code value, which is 0.2159 of display
    /// white. So white begins at 1 / 0.2159 = 4.63, and code value 1 at 0.00015 / 0.2159 = 0.0007.
    #[test]
    fn uniform_scene_keeps_the_colour_of_the_photographs() {
        for operator in Operator::iter() {
            let code = |pixel: [f32; 3], size: (usize, usize)| {
                let pixels = Plane::filled(size.0, size.1, pixel);
                let picture = tonemap(&RadianceMap { pixels, primaries: Primaries::SRGB }, None, &operator).pixels;
                assert!(picture.as_slice().iter().all(|p| *p == picture.at(0, 0)), "{}", operator.name());
                picture.at(0, 0)
            };
            for size in [(1, 1), (2, 3), (70, 65)] {
                assert_eq!(code([1.0; 3], size), [128; 3], "{}", operator.name());
                assert_eq!(code([4.7; 3], size), [255; 3], "{}", operator.name());
                assert_eq!(code([9e-5; 3], size), [0; 3], "{}", operator.name());
                let [r, g, b] = code([2.0, 1.0, 0.5], size);
                assert!(
                    r > g && g > b && g.abs_diff(128) <= 1 && r.abs_diff(176) <= 1,
                    "{} {r} {g} {b}",
                    operator.name()
                );
            }
        }
    }
}
