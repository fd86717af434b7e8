//! Adjustments: what a photographer changes of the picture after the operator, with the same meaning for every operator.
//!
//! In: [`Options`]. Out: which light is white (`white`, `neutral`), and what takes the light of the picture to that of the adjusted one ([`Adjusted`]).
//! Radiance stays as it is. Cost: see [`Adjusted`]; nothing where all is left as it is.
//!
//! White is balanced in linear light, before the operator. All else is a change of the log odds of luminance Y on the display, t = log2(Y / (1 - Y)): in the
//! dark they are stops, and black and white are out of reach, so that nothing clips. Shadows and highlights are added to t where the surroundings are dark or
//! bright; contrast is the slope of what comes of it about the middle code; brightness is added to that. Saturation is times the chroma of OkLab.

mod light;
pub(crate) mod neutral;
mod surroundings;
pub(crate) mod white;

use crate::error::{Error, Result};

pub use light::Adjusted;
pub use surroundings::CELLS;
pub use white::{Light, WhiteBalance};

/// What is changed of a picture; by default nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize)]
pub struct Options {
    /// Which light is shown as white.
    pub white_balance: WhiteBalance,
    /// Added to the log odds of luminance, -5 to 5: in the dark parts stops, towards white less and less.
    pub brightness: f64,
    /// -100 to 100: at 100 the log odds are twice as far from those of the middle code, at -100 half as far.
    pub contrast: f64,
    /// -100 to 100: at 100 chroma is doubled, at -100 all is grey.
    pub saturation: f64,
    /// -100 to 100: at 100 what lies in the dark is two stops brighter, at -100 two stops darker.
    pub shadows: f64,
    /// -100 to 100: at 100 what lies in the light is two stops brighter, at -100 two stops darker.
    pub highlights: f64,
}

/// The most that brightness is, in stops.
const MOST_STOPS: f64 = 5.0;
/// The most of the others: as in most programs for photographs.
const MOST: f64 = 100.0;

impl Options {
    /// The numbers, each with its option as it is typed and the most that it is, to either side.
    fn numbers(&self) -> [(&'static str, f64, f64); 5] {
        [
            ("--brightness", self.brightness, MOST_STOPS),
            ("--contrast", self.contrast, MOST),
            ("--saturation", self.saturation, MOST),
            ("--shadows", self.shadows, MOST),
            ("--highlights", self.highlights, MOST),
        ]
    }

    /// Checks the values against their ranges.
    ///
    /// # Errors
    /// [`Error::Option`] for the first that is out of its range.
    pub fn validate(&self) -> Result<()> {
        if let WhiteBalance::Light(light) = self.white_balance {
            light.validate()?;
        }
        match self.numbers().into_iter().find(|(_, value, most)| !(-most..=*most).contains(value)) {
            None => Ok(()),
            Some((option, value, most)) => Err(Error::Option {
                option,
                reason: format!("{value} is outside of -{most} to {most}; 0 changes nothing"),
            }),
        }
    }

    /// Whether a picture of `size` pixels can be changed so.
    ///
    /// # Errors
    /// [`Error::Option`] where the grey spot is outside of it.
    pub fn check(&self, size: (usize, usize)) -> Result<()> {
        match self.white_balance {
            WhiteBalance::Spot(x, y) => neutral::Spot::new((x, y), size).map(|_| ()),
            _ => Ok(()),
        }
    }

    /// The first that is asked for, as it is typed; none where nothing is changed.
    pub fn asked(&self) -> Option<&'static str> {
        let white = (self.white_balance != WhiteBalance::AsShot).then_some(white::OPTION);
        white.or_else(|| self.numbers().into_iter().find(|(_, value, _)| *value != 0.0).map(|(option, ..)| option))
    }

    /// Whether anything but white is changed.
    fn changes_light(&self) -> bool {
        self.numbers().iter().any(|(_, value, _)| *value != 0.0)
    }

    /// Whether what lies around a pixel must be known.
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
