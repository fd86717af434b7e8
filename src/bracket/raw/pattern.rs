//! The colour filter array: which colour each pixel of a sensor sees.
//!
//! In: the tags of a file. Out: a [`Pattern`]. Cost: none. Source: DNG, CFARepeatPatternDim and CFAPattern; TIFF/EP.

use crate::bracket::raw::Reason;

/// Red, green or blue: 0, 1 or 2.
pub(crate) type Colour = usize;

/// A repeated pattern of colour filters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pattern {
    /// Width and height of the part that repeats.
    size: (usize, usize),
    /// Its colours, row by row.
    colours: Vec<Colour>,
}

impl Pattern {
    /// The pattern of this size; `colours` are those of DNG: 0 red, 1 green, 2 blue.
    ///
    /// # Errors
    /// The reason, if it is no Bayer pattern.
    pub(super) fn new(size: (usize, usize), colours: &[u64]) -> Result<Self, Reason> {
        let unsupported = || {
            let names: String = colours.iter().map(|&c| *b"RGBCMYW".get(c as usize).unwrap_or(&b'?') as char).collect();
            format!(
                "its colour filters ({}x{} {names}) are not supported, only Bayer patterns of red, green and blue are; \
                 develop it to 16-bit TIFF first",
                size.0, size.1
            )
        };
        let colours: Vec<Colour> = colours.iter().map(|&c| c as usize).collect();
        let is_bayer =
            size == (2, 2) && matches!(colours[..], [0, 1, 1, 2] | [2, 1, 1, 0] | [1, 0, 2, 1] | [1, 2, 0, 1]);
        if is_bayer { Ok(Pattern { size, colours }) } else { Err(unsupported()) }
    }

    /// The Bayer pattern with these colours in its first row and its second.
    #[cfg(test)]
    pub(crate) fn bayer(colours: [u64; 4]) -> Self {
        Pattern::new((2, 2), &colours).expect("a Bayer pattern")
    }

    /// The pattern of a picture whose pixel (x, y) is the pixel `stored(x, y)` of this pattern. `stored` moves, turns
    /// or mirrors pictures.
    pub(crate) fn seen(&self, stored: impl Fn(usize, usize) -> (usize, usize)) -> Self {
        let (width, height) = self.size;
        let colour = |i: usize| {
            let (x, y) = stored(i % width, i / width);
            self.at(x, y)
        };
        Pattern { size: self.size, colours: (0..width * height).map(colour).collect() }
    }

    /// The colour of the pixel (x, y).
    #[inline(always)]
    pub(crate) fn at(&self, x: usize, y: usize) -> Colour {
        self.colours[(y % self.size.1) * self.size.0 + x % self.size.0]
    }
}
