//! Adjustments: white balance, brightness, contrast, saturation, shadows and highlights, with the same meaning for
//! every operator.
//!
//! In: [`Options`]. Out: the light that is shown as white (`white`, `neutral`), and [`Adjusted`], which changes the
//! light of the picture. The radiance map is not changed. Cost: see [`Adjusted`]; none when nothing is adjusted.
//!
//! White is balanced in linear light, before the operator (for `mertens`: after the fusion). All other adjustments
//! except saturation change the log odds t = log2(Y / (1 - Y)) of display luminance Y. In the dark, t is in stops.
//! Black and white are never reached, so nothing clips. Shadows and highlights are added to t where the surroundings
//! are dark or bright; then contrast scales the distance of t from the log odds of the middle code value; then
//! brightness is added to t. Saturation scales the chroma of OkLab.

mod light;
pub(crate) mod neutral;
mod surroundings;
pub(crate) mod white;

use crate::error::{Error, Result};

#[doc(hidden)]
pub use light::Adjusted;
#[doc(hidden)]
pub use surroundings::CELLS;
pub use white::{Light, WhiteBalance};

/// Adjustments of a picture; by default none.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct Options {
    /// The light that is shown as white.
    pub white_balance: WhiteBalance,
    /// Added to the log odds of luminance, -5 to 5: stops in the dark parts, and less and less towards white.
    pub brightness: f64,
    /// -100 to 100: at 100 the log odds are twice as far from the log odds of the middle code value, at -100 half as
    /// far.
    pub contrast: f64,
    /// -100 to 100: at 100 chroma is doubled, at -100 all is grey.
    pub saturation: f64,
    /// -100 to 100: at 100 the darkest surroundings are two stops brighter, at -100 two stops darker.
    pub shadows: f64,
    /// -100 to 100: at 100 the log odds of the brightest surroundings are greater by 2, at -100 less by 2.
    pub highlights: f64,
}

/// Largest brightness, in stops.
const MOST_STOPS: f64 = 5.0;
/// Largest value of the other adjustments, as in most photo editors.
const MOST: f64 = 100.0;

impl Options {
    /// Returns, for each numeric adjustment, the command line option, the value and the largest absolute value.
    fn numbers(&self) -> [(&'static str, f64, f64); 5] {
        [
            ("--brightness", self.brightness, MOST_STOPS),
            ("--contrast", self.contrast, MOST),
            ("--saturation", self.saturation, MOST),
            ("--shadows", self.shadows, MOST),
            ("--highlights", self.highlights, MOST),
        ]
    }

    /// Checks that every value is within its range.
    ///
    /// # Errors
    /// [`Error::Option`] for the first option that is out of range.
    pub fn validate(&self) -> Result<()> {
        if let WhiteBalance::Light(light) = self.white_balance {
            light.validate()?;
        }
        match self.numbers().into_iter().find(|(_, value, most)| !(-most..=*most).contains(value)) {
            None => Ok(()),
            Some((option, value, most)) => Err(Error::Option {
                option,
                reason: format!("{value} is outside of -{most} to {most}; give a value in this range, 0 for no change"),
            }),
        }
    }

    /// Checks that the adjustments can be applied to a picture of `size` pixels.
    ///
    /// # Errors
    /// [`Error::Option`] when the grey spot is outside of the picture.
    pub fn check(&self, size: (usize, usize)) -> Result<()> {
        match self.white_balance {
            WhiteBalance::Spot(x, y) => neutral::Spot::new((x, y), size).map(|_| ()),
            _ => Ok(()),
        }
    }

    /// Returns the first option that differs from its default; `None` when nothing is adjusted.
    pub fn asked(&self) -> Option<&'static str> {
        let white = (self.white_balance != WhiteBalance::AsShot).then_some(white::OPTION);
        white.or_else(|| self.numbers().into_iter().find(|(_, value, _)| *value != 0.0).map(|(option, ..)| option))
    }

    /// Whether anything besides white balance is adjusted.
    fn changes_light(&self) -> bool {
        self.numbers().iter().any(|(_, value, _)| *value != 0.0)
    }

    /// Whether the adjustment of a pixel depends on its surroundings.
    pub fn needs_surroundings(&self) -> bool {
        self.shadows != 0.0 || self.highlights != 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_refused_by_the_option_that_has_them() {
        assert!(Options::default().validate().is_ok() && Options::default().asked().is_none());
        let one = |brightness: f64| Options { brightness, ..Options::default() };
        assert!([-5.0, 5.0, 0.3].iter().all(|&stops| one(stops).validate().is_ok()));
        for bad in [5.01, -6.0, f64::NAN, f64::INFINITY] {
            let error = one(bad).validate().unwrap_err();
            assert!(error.is_usage() && error.to_string().starts_with("--brightness: "), "{error}");
        }
        let all = Options { contrast: 100.0, saturation: -100.0, shadows: 100.0, highlights: -100.0, ..one(0.0) };
        assert!(all.validate().is_ok());
        assert_eq!((all.asked(), one(0.1).asked()), (Some("--contrast"), Some("--brightness")));
        let candle = WhiteBalance::Light(Light { kelvin: 1200.0, tint: 0.0 });
        let white = Options { white_balance: candle, ..all };
        assert!(white.validate().unwrap_err().to_string().contains("2000 to 25000 K"));
        assert_eq!(white.asked(), Some("--white-balance"));
    }
}
