//! The part of the reference that the results show.
//!
//! In: the requested part, and the alignment. Out: a rectangle of the reference. Cost: negligible.

use crate::align::{Alignment, Rect};
use crate::bracket::Bracket;
use crate::error::{Error, Result};
use std::fmt;
use std::str::FromStr;

/// The requested part of the reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Crop {
    /// The largest rectangle found that all merged frames cover.
    #[default]
    Common,
    /// All of the reference; fewer frames are merged where fewer cover it.
    None,
    /// This part of the reference; fewer frames are merged where fewer cover it.
    Part(Rect),
}

impl Crop {
    /// Checks that the part is inside the reference of `bracket`.
    ///
    /// # Errors
    /// [`Error::Option`] if the part is empty or extends beyond the reference.
    pub(super) fn check(self, bracket: &Bracket) -> Result<()> {
        let Crop::Part(Rect { x0, y0, x1, y1 }) = self else { return Ok(()) };
        let (width, height) = (bracket.width(), bracket.height());
        if x0 < x1 && y0 < y1 && x1 <= width && y1 <= height {
            return Ok(());
        }
        let reason = format!(
            "{self} is not inside the reference, which has {width} x {height} pixels; give X,Y,WIDTH,HEIGHT inside 0,0,{width},{height}"
        );
        Err(Error::Option { option: "--crop", reason })
    }

    /// Returns the rectangle in pixels of the reference.
    pub(super) fn rect(self, bracket: &Bracket, alignment: &Alignment) -> Rect {
        match self {
            Crop::Common => alignment.overlap,
            Crop::None => Rect { x0: 0, y0: 0, x1: bracket.width(), y1: bracket.height() },
            Crop::Part(rect) => rect,
        }
    }
}

impl FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Crop, String> {
        match text {
            "common" => return Ok(Crop::Common),
            "none" => return Ok(Crop::None),
            _ => {}
        }
        let numbers: Option<Vec<usize>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some([_, _, 0, _] | [_, _, _, 0]) => {
                Err("the part is empty; give a WIDTH and a HEIGHT of 1 or more".into())
            }
            Some(&[x0, y0, width, height]) => {
                let end = |from: usize, side: usize| {
                    from.checked_add(side).ok_or("the numbers are too large; give smaller ones")
                };
                Ok(Crop::Part(Rect { x0, y0, x1: end(x0, width)?, y1: end(y0, height)? }))
            }
            _ => Err(
                "give `common`, `none`, or X,Y,WIDTH,HEIGHT in pixels of the reference, for example `0,200,4000,2250`"
                    .into(),
            ),
        }
    }
}

impl fmt::Display for Crop {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Crop::Common => f.write_str("common"),
            Crop::None => f.write_str("none"),
            Crop::Part(rect) => write!(f, "{},{},{},{}", rect.x0, rect.y0, rect.width(), rect.height()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn part_is_a_corner_and_a_size() {
        let part = Crop::Part(Rect { x0: 10, y0: 20, x1: 310, y1: 220 });
        assert_eq!("10,20,300,200".parse(), Ok(part));
        for crop in [Crop::Common, Crop::None, part] {
            assert_eq!(crop.to_string().parse(), Ok(crop));
        }
        for (text, said) in [
            ("all", "`common`"),
            ("1,2,3", "X,Y,WIDTH,HEIGHT"),
            ("-1,2,3,4", "X,Y,WIDTH,HEIGHT"),
            ("1,2,0,4", "empty"),
            ("1,2,18446744073709551615,4", "too large"),
        ] {
            let error = text.parse::<Crop>().unwrap_err();
            assert!(error.contains(said), "{text}: {error}");
        }
    }
}
