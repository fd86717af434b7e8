//! Options that pictures of all formats have: bit depth, colour space, size and adjustments.
//!
//! In: options and outputs. Out: an error where a format does not support them. Cost: none.

use super::format::{Format, Output};
use super::jpeg::Resolution;
use crate::error::{Error, Result, Warning};
use crate::tonemap::adjust;
use crate::tonemap::display::codes::{Colours, Depth};
use std::fmt;
use std::str::FromStr;

/// Options for pictures.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Options {
    /// Bits per channel. Default: 8.
    pub depth: Depth,
    /// Primaries and transfer function, and the profile that describes them. Default: sRGB.
    pub colours: Colours,
    /// Size of the picture. By default, the size of the radiance map.
    pub size: Size,
    /// Adjustments after the tone mapping operator. Default: none.
    pub adjust: adjust::Options,
}

/// Size of a picture, which is never larger than the radiance map.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum Size {
    /// As large as the radiance map.
    #[default]
    Full,
    /// Number of pixels of the longest side.
    Longest(usize),
    /// Percentage of the width and of the height of the radiance map.
    Percent(f64),
}

impl Size {
    /// Returns width and height of the picture, for a radiance map of width and height `full`.
    pub fn of(self, full: (usize, usize)) -> (usize, usize) {
        let longest = full.0.max(full.1).max(1);
        let factor = match self {
            Size::Full => 1.0,
            Size::Longest(pixels) => pixels as f64 / longest as f64,
            Size::Percent(percent) => percent / 100.0,
        };
        let side = |pixels: usize| ((pixels as f64 * factor).round() as usize).clamp(1, pixels.max(1));
        (side(full.0), side(full.1))
    }

    /// Returns a warning if the requested size is larger than the radiance map, which has width and height `full`.
    pub fn warning(self, full: (usize, usize)) -> Option<Warning> {
        let longest_px = full.0.max(full.1);
        match self {
            Size::Longest(asked_px) if asked_px > longest_px => Some(Warning::NotEnlarged { longest_px, asked_px }),
            _ => None,
        }
    }
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Size, String> {
        let wrong =
            || format!("{text:?} is not a size; give the pixels of the longest side, for example `2048`, or `50%`");
        match text.strip_suffix('%') {
            Some(number) => match number.trim().parse() {
                Ok(percent) if percent > 0.0 && percent <= 100.0 => Ok(Size::Percent(percent)),
                Ok(percent) if percent > 100.0 => Err("pictures are never enlarged; give 100% or less".into()),
                _ => Err(wrong()),
            },
            None => match text.parse() {
                Ok(pixels) if pixels > 0 => Ok(Size::Longest(pixels)),
                _ => Err(wrong()),
            },
        }
    }
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Size::Full => write!(f, "100%"),
            Size::Longest(pixels) => write!(f, "{pixels}"),
            Size::Percent(percent) => write!(f, "{percent}%"),
        }
    }
}

impl Options {
    /// Checks that `outputs` support these options. `gain_map` is the size of the gain map in a `.jpg`.
    ///
    /// # Errors
    /// [`Error::Option`] if an output does not support an option, or if an option is given but no picture is written.
    pub(super) fn check(&self, outputs: &[Output], gain_map: Resolution) -> Result<()> {
        let refused = |option, reason: String| Err(Error::Option { option, reason });
        self.adjust.validate()?;
        let asked = [
            (self.depth != Depth::default()).then_some("--bit-depth"),
            (self.colours != Colours::default()).then_some("--picture-colour"),
            (self.size != Size::default()).then_some("--resize"),
            // Without any output, the picture is returned in memory, and adjustments apply to it.
            self.adjust.asked().filter(|_| !outputs.is_empty()),
        ];
        if outputs.iter().all(|output| output.format.holds_radiance())
            && let Some(option) = asked.into_iter().flatten().next()
        {
            return refused(option, "no picture is written; write a .png too, or omit the option".into());
        }
        let Some(jpeg) = outputs.iter().find(|output| output.format == Format::Jpeg) else { return Ok(()) };
        let name = jpeg.path.display();
        if self.depth == Depth::Sixteen {
            return refused(
                "--bit-depth",
                format!("{name}: JPEG has 8 bits; write a .png instead, or omit the option"),
            );
        }
        if self.colours == Colours::AdobeRgb && gain_map != Resolution::None {
            let reason = "gain maps support srgb and display-p3; give --gain-map none, or choose one of these";
            return refused("--picture-colour", format!("{name}: {reason}"));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn size_is_of_the_longest_side_or_a_share_and_never_larger() {
        let of = |text: &str, full| text.parse::<Size>().unwrap().of(full);
        assert_eq!([of("2048", (4000, 3000)), of("2048", (3000, 4000))], [(2048, 1536), (1536, 2048)]);
        assert_eq!([of("50%", (301, 200)), of("12.5 %", (800, 1))], [(151, 100), (100, 1)]);
        assert_eq!([of("2048", (300, 200)), of("100%", (300, 200))], [(300, 200); 2]);
        for (text, said) in
            [("0", "`2048`"), ("0%", "`50%`"), ("-3", "not a size"), ("1e3", "not a size"), ("101%", "never")]
        {
            let error = text.parse::<Size>().unwrap_err();
            assert!(error.contains(said), "{text}: {error}");
        }
        for text in ["2048", "50%", "33.5%"] {
            assert_eq!(text.parse::<Size>().unwrap().to_string(), text);
        }
        assert!(Size::Longest(301).warning((300, 200)).is_some() && Size::Longest(300).warning((300, 200)).is_none());
    }
}
