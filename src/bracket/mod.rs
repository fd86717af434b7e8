//! The bracket: differently exposed photographs of one scene, decoded and ordered.
//!
//! In: paths. Out: a [`Bracket`] of [`Frame`]s by rising exposure. Frames keep the code values the camera wrote (8 or 16 bit,
//! camera-encoded, orientation applied): three values a pixel, never floats. Cost: that of the decoders, one frame per thread.

mod brightness;
mod capture;
pub mod colour;
mod decode;
pub mod exposure;
mod load;
mod nominal;
mod reference;

pub use load::{LoadOptions, load, load_with_progress};
pub use reference::ReferenceChoice;

use crate::error::{Error, Result};
use crate::plane::Plane;
use crate::simd::{Loops, vectorised};
use colour::{Primaries, Profile};
use exposure::Exposure;
use std::path::{Path, PathBuf};

/// The code values of a picture: interleaved RGB by rows, three to a pixel.
#[derive(Debug, Clone, PartialEq)]
pub enum Samples {
    /// 0..=255.
    Eight(Vec<u8>),
    /// 0..=65535.
    Sixteen(Vec<u16>),
}

impl Samples {
    /// The largest code value: 255 or 65535.
    pub fn max(&self) -> u16 {
        match self {
            Samples::Eight(_) => u8::MAX.into(),
            Samples::Sixteen(_) => u16::MAX,
        }
    }

    /// How many values there are: three times the pixels.
    pub fn len(&self) -> usize {
        match self {
            Samples::Eight(v) => v.len(),
            Samples::Sixteen(v) => v.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// What the camera noted beside the exposure: carried over to the outputs.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Capture {
    /// EXIF Make.
    pub make: Option<String>,
    /// EXIF Model.
    pub model: Option<String>,
    /// EXIF DateTimeOriginal, as `YYYY:MM:DD HH:MM:SS`.
    pub date: Option<String>,
    /// EXIF LensModel.
    pub lens: Option<String>,
    /// EXIF FocalLength, in millimetres.
    pub focal_length_mm: Option<f64>,
}

/// One photograph, decoded.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    path: PathBuf,
    width: usize,
    height: usize,
    samples: Samples,
    /// How it was exposed.
    pub exposure: Exposure,
    /// Its colour profile; none is taken for sRGB.
    pub profile: Option<Profile>,
    /// What else the camera noted.
    pub capture: Capture,
}

impl Frame {
    /// A frame of `width` x `height` pixels from interleaved RGB code values.
    ///
    /// # Panics
    /// When the number of samples does not fit the size, or the size is zero: decoders check before.
    pub fn new(path: PathBuf, width: usize, height: usize, samples: Samples, exposure: Exposure) -> Self {
        assert!(width > 0 && height > 0 && samples.len() == 3 * width * height, "a frame holds three samples a pixel");
        Frame { path, width, height, samples, exposure, profile: None, capture: Capture::default() }
    }

    /// The file it came from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Width in pixels, orientation applied.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels, orientation applied.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The code values.
    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    /// The chromaticities that the samples are of: the profile's, or sRGB's where there is no profile or it does not say.
    pub fn primaries(&self) -> Primaries {
        self.profile.as_ref().and_then(|profile| profile.primaries).unwrap_or(Primaries::SRGB)
    }

    /// The grey picture in which motion is sought: Ward's (54 R + 183 G + 19 B) / 256 (2003, section 2), at 8 bit whatever the depth.
    pub fn grey(&self) -> Plane<u8> {
        Plane::from_rows(self.width, self.height, |y, row| self.grey_row(y, None, row))
    }

    /// The grey picture as [`grey`](Self::grey) has it, but brightened by `stops` (0..=8) before it is rounded to 8 bit: of a dark frame
    /// much is between its codes, in its three channels and in the bits beyond the eighth.
    pub fn grey_brightened(&self, stops: u32) -> Plane<u8> {
        Plane::from_rows(self.width, self.height, |y, row| self.grey_row(y, Some(stops), row))
    }

    /// Row `y` of [`grey`](Self::grey) into `out`, or where there are `stops` of [`grey_brightened`](Self::grey_brightened).
    ///
    /// # Panics
    /// Where `y` or the length of `out` does not fit the size.
    pub fn grey_row(&self, y: usize, stops: Option<u32>, out: &mut [u8]) {
        assert_eq!(out.len(), self.width, "a row is as long as the frame is wide");
        let row = 3 * self.width * y..3 * self.width * (y + 1);
        match &self.samples {
            Samples::Eight(v) => vectorised(GreyOfEight { rgb: &v[row], stops, grey: out }),
            Samples::Sixteen(v) => vectorised(GreyOfSixteen { rgb: &v[row], stops, grey: out }),
        }
    }
}

/// A row of codes of 8 bit, and where its grey goes. All sums fit 16 bits: the weights add up to 256.
struct GreyOfEight<'a> {
    rgb: &'a [u8],
    stops: Option<u32>,
    grey: &'a mut [u8],
}

impl Loops for GreyOfEight<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let sum = |p: &[u8; 3]| 54 * u16::from(p[0]) + 183 * u16::from(p[1]) + 19 * u16::from(p[2]);
        let pixels = self.grey.iter_mut().zip(self.rgb.as_chunks::<3>().0);
        match self.stops {
            None => pixels.for_each(|(out, p)| *out = (sum(p) >> 8) as u8),
            Some(stops) => {
                let shift = 8 - stops.min(8);
                pixels.for_each(|(out, p)| *out = (sum(p) >> shift).min(255) as u8);
            }
        }
    }
}

/// A row of codes of 16 bit, and where its grey goes.
struct GreyOfSixteen<'a> {
    rgb: &'a [u16],
    stops: Option<u32>,
    grey: &'a mut [u8],
}

impl Loops for GreyOfSixteen<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let pixels = self.grey.iter_mut().zip(self.rgb.as_chunks::<3>().0);
        match self.stops {
            None => pixels
                .for_each(|(out, p)| *out = ((54 * (p[0] >> 8) + 183 * (p[1] >> 8) + 19 * (p[2] >> 8)) >> 8) as u8),
            Some(stops) => {
                let shift = 16 - stops.min(8);
                pixels.for_each(|(out, p)| {
                    let sum = 54 * u32::from(p[0]) + 183 * u32::from(p[1]) + 19 * u32::from(p[2]);
                    *out = (sum >> shift).min(255) as u8;
                });
            }
        }
    }
}

/// Frames of one size by rising relative exposure (then by path), and the one that the others are aligned to.
#[derive(Debug, Clone)]
pub struct Bracket {
    frames: Vec<Frame>,
    reference: usize,
}

impl Bracket {
    /// Orders `frames` by exposure and settles the reference.
    ///
    /// # Errors
    /// [`Error::TooFewFrames`], [`Error::SizeMismatch`], or [`Error::Option`] where the reference is no frame of the bracket.
    pub fn new(mut frames: Vec<Frame>, reference: &ReferenceChoice) -> Result<Self> {
        let Some(first) = frames.first() else {
            return Err(Error::TooFewFrames { given: 0 });
        };
        if frames.len() < 2 {
            return Err(Error::TooFewFrames { given: frames.len() });
        }
        if let Some(odd) = frames.iter().find(|f| (f.width, f.height) != (first.width, first.height)) {
            return Err(Error::SizeMismatch {
                path: odd.path.clone(),
                size: (odd.width, odd.height),
                other: first.path.clone(),
                other_size: (first.width, first.height),
            });
        }
        let chosen = reference::chosen(&frames, reference)?;
        frames
            .sort_by(|a, b| a.exposure.relative().total_cmp(&b.exposure.relative()).then_with(|| a.path.cmp(&b.path)));
        let reference = match chosen {
            Some(path) => frames.iter().position(|f| f.path == path).unwrap_or(0),
            None => match reference {
                ReferenceChoice::AutoExcept(except) => reference::best(&frames, except),
                _ => reference::best(&frames, &[]),
            },
        };
        Ok(Bracket { frames, reference })
    }

    /// The same frames in the same order, the exposure of each corrected by so many stops: order is by the exposures as loaded.
    ///
    /// # Panics
    /// Where there is not one correction for each frame.
    pub fn corrected(mut self, stops: &[f64]) -> Self {
        assert_eq!(stops.len(), self.frames.len(), "one correction a frame");
        for (frame, &stops) in self.frames.iter_mut().zip(stops) {
            frame.exposure = frame.exposure.corrected(stops);
        }
        self
    }

    /// The frames by rising exposure.
    pub fn frames(&self) -> &[Frame] {
        &self.frames
    }

    /// The index of the reference in [`frames`](Self::frames).
    pub fn reference_index(&self) -> usize {
        self.reference
    }

    /// Which frame is meant by `path`: the one read from it, as given or by another way to the same file; or the only one whose file has
    /// that name.
    pub fn named(&self, path: &Path) -> Option<usize> {
        reference::named(&self.frames, path)
    }

    /// The frame that the others are aligned to, and whose rectangle the result has.
    pub fn reference(&self) -> &Frame {
        &self.frames[self.reference]
    }

    /// Width of every frame, in pixels.
    pub fn width(&self) -> usize {
        self.frames[0].width
    }

    /// Height of every frame, in pixels.
    pub fn height(&self) -> usize {
        self.frames[0].height
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(name: &str, width: usize, ev: f64) -> Frame {
        let exposure = Exposure::given(ev).unwrap();
        Frame::new(name.into(), width, 2, Samples::Eight(vec![128; 6 * width]), exposure)
    }

    #[test]
    fn grey_is_wards_at_either_depth() {
        let of = |samples| Frame::new("a".into(), 1, 1, samples, Exposure::given(0.0).unwrap()).grey().at(0, 0);
        assert_eq!(of(Samples::Eight(vec![10, 200, 30])), ((54 * 10 + 183 * 200 + 19 * 30) >> 8) as u8);
        assert_eq!(of(Samples::Sixteen(vec![0x0AFF, 0xC800, 0x1E10])), of(Samples::Eight(vec![10, 200, 30])));
        assert_eq!(of(Samples::Eight(vec![255; 3])), 255);
    }

    #[test]
    fn a_brightened_grey_keeps_what_rounding_loses() {
        let of = |samples| Frame::new("a".into(), 1, 1, samples, Exposure::given(0.0).unwrap());
        // (54 + 2 * 183) / 256 = 1.64, of which 1 is left; times 64 it is 105.
        let dark = of(Samples::Eight(vec![1, 2, 0]));
        assert_eq!([0, 6, 8].map(|stops| dark.grey_brightened(stops).at(0, 0)), [1, 105, 255]);
        // 0.64 of a code at 8 bit.
        let deep = of(Samples::Sixteen(vec![164, 164, 164]));
        assert_eq!([0, 6].map(|stops| deep.grey_brightened(stops).at(0, 0)), [0, 41]);
        let plain = of(Samples::Eight(vec![10, 200, 30]));
        assert_eq!(plain.grey_brightened(0), plain.grey());
    }

    #[test]
    fn rows_of_grey_are_the_definition_pixel_by_pixel() {
        // Longer than any vector, and no multiple of one.
        let (width, height) = (203, 3);
        let codes: Vec<u16> = (0..3 * width * height).map(|i| (i * 40_503 % 65_536) as u16).collect();
        let eight = Samples::Eight(codes.iter().map(|c| (c >> 8) as u8).collect());
        for samples in [eight, Samples::Sixteen(codes)] {
            let frame = Frame::new("a".into(), width, height, samples, Exposure::given(0.0).unwrap());
            let sixteen = |i: usize| match frame.samples() {
                Samples::Eight(v) => u32::from(v[i]) << 8,
                Samples::Sixteen(v) => u32::from(v[i]),
            };
            let sum = |i: usize, bits: u32| {
                54 * (sixteen(3 * i) >> bits) + 183 * (sixteen(3 * i + 1) >> bits) + 19 * (sixteen(3 * i + 2) >> bits)
            };
            let slow = |stops: Option<u32>, i: usize| match stops {
                None => sum(i, 8) >> 8,
                Some(stops) => (sum(i, 0) >> (16 - stops)).min(255),
            };
            let mut row = vec![0; width];
            for stops in [None, Some(0), Some(2), Some(6), Some(8)] {
                for y in 0..height {
                    frame.grey_row(y, stops, &mut row);
                    assert!((0..width).all(|x| u32::from(row[x]) == slow(stops, y * width + x)), "{stops:?}");
                }
            }
        }
    }

    #[test]
    fn frames_go_by_exposure_then_by_path_and_a_number_by_the_order_given() {
        let frames = vec![frame("c", 3, 1.0), frame("b", 3, -1.0), frame("a", 3, 1.0)];
        let bracket = Bracket::new(frames, &ReferenceChoice::Number(1)).unwrap();
        let names: Vec<_> = bracket.frames().iter().map(|f| f.path().to_str().unwrap()).collect();
        assert_eq!(names, ["b", "a", "c"]);
        assert_eq!((bracket.reference_index(), bracket.width(), bracket.height()), (2, 3, 2));
    }

    #[test]
    fn one_frame_or_two_sizes_are_no_bracket() {
        let auto = ReferenceChoice::Auto;
        assert!(matches!(Bracket::new(vec![frame("a", 3, 0.0)], &auto), Err(Error::TooFewFrames { given: 1 })));
        let odd = Bracket::new(vec![frame("a", 3, 0.0), frame("b", 4, 1.0)], &auto);
        assert!(matches!(odd, Err(Error::SizeMismatch { size: (4, 2), other_size: (3, 2), .. })));
    }
}
