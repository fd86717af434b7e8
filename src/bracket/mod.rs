//! The bracket: differently exposed photographs of one scene, decoded and ordered.
//!
//! In: paths. Out: a [`Bracket`] of [`Frame`]s by rising exposure. Frames keep the code values the camera wrote (8 or 16 bit,
//! camera-encoded, orientation applied): three values a pixel, never floats; in memory, or on disk where memory is limited. Cost: that of the
//! decoders, one frame per thread.

pub mod colour;
mod decode;
pub mod exposure;
mod from_image;
mod grey;
pub mod header;
mod load;
mod metadata;
mod photograph;
mod reference;
mod window;

pub use load::{LoadOptions, load, load_with_progress};
pub(crate) use load::{differing_profiles, load_for};
pub use photograph::Photograph;
pub use reference::ReferenceChoice;
pub(crate) use reference::named;
pub use window::{Codes, Window};

use crate::budget::Budget;
use crate::error::{Error, Result};
use crate::plane::{BAND_ROWS, Plane, map_at_once};
use crate::scratch::Scratch;
use colour::{Primaries, Profile};
use exposure::Exposure;
use rayon::prelude::*;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use window::Store;

/// Extensions of the photographs that are taken from a folder, in any case.
pub(crate) const EXTENSIONS: [&str; 7] = ["jpg", "jpeg", "jpe", "jfif", "png", "tif", "tiff"];

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

    /// What they take in memory.
    pub(crate) fn bytes(&self) -> u64 {
        match self {
            Samples::Eight(v) => v.len() as u64,
            Samples::Sixteen(v) => 2 * v.len() as u64,
        }
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
    /// The moment of the exposure, to the digits that the camera writes.
    pub taken: Option<header::Moment>,
    /// EXIF LensModel.
    pub lens: Option<String>,
    /// EXIF FocalLength, in millimetres.
    pub focal_length_mm: Option<f64>,
    /// All of the EXIF that is true of the results too, as a TIFF block; where it was taken only if that was asked for.
    pub exif: Option<Vec<u8>>,
}

/// Rows that are read at once of a frame of which all rows are wanted one by one: bands enough for all threads.
const READ_ROWS: usize = 16 * BAND_ROWS;

/// One photograph, decoded.
#[derive(Debug, Clone)]
pub struct Frame {
    path: PathBuf,
    width: usize,
    height: usize,
    store: Store,
    /// How much it shows: see [`reference::well_exposed`].
    well_exposed: u64,
    /// How it was exposed.
    pub exposure: Exposure,
    /// Its colour profile; none is taken for sRGB.
    pub profile: Option<Profile>,
    /// What else the camera noted.
    pub capture: Capture,
    /// Why it is not to be merged, unless the user says otherwise: its light is not that of the others.
    pub excluded: Option<String>,
}

impl Frame {
    /// A frame of `width` x `height` pixels from interleaved RGB code values.
    ///
    /// # Panics
    /// When the number of samples does not fit the size, or the size is zero: decoders check before.
    pub fn new(path: PathBuf, width: usize, height: usize, samples: Samples, exposure: Exposure) -> Self {
        let well_exposed = reference::well_exposed(&samples, width);
        Frame::stored(path, (width, height), Store::Held(samples), well_exposed, exposure)
    }

    /// As [`new`](Self::new), of codes that are anywhere and were looked at before.
    fn stored(path: PathBuf, size: (usize, usize), store: Store, well_exposed: u64, exposure: Exposure) -> Self {
        let (width, height) = size;
        assert!(width > 0 && height > 0 && store.len() == 3 * width * height, "a frame holds three samples a pixel");
        Frame {
            path,
            width,
            height,
            store,
            well_exposed,
            exposure,
            profile: None,
            capture: Capture::default(),
            excluded: None,
        }
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

    /// The largest code value: 255 or 65535.
    pub fn max(&self) -> u16 {
        self.store.max()
    }

    /// What a row takes in memory, in bytes.
    pub fn row_bytes(&self) -> u64 {
        self.store.bytes() / self.height as u64
    }

    /// The code values of some of its rows.
    ///
    /// # Errors
    /// [`Error::Scratch`], where the frame is on disk.
    ///
    /// # Panics
    /// When it has no such rows.
    pub fn window(&self, rows: Range<usize>) -> Result<Window<'_>> {
        self.store.window((self.width, self.height), rows)
    }

    /// All of its code values.
    ///
    /// # Errors
    /// [`Error::Scratch`], where the frame is on disk.
    pub fn whole(&self) -> Result<Window<'_>> {
        self.window(0..self.height)
    }

    /// The chromaticities that the samples are of: the profile's, or sRGB's where there is no profile or it does not say.
    pub fn primaries(&self) -> Primaries {
        self.profile.as_ref().and_then(|profile| profile.primaries).unwrap_or(Primaries::SRGB)
    }

    /// The grey picture in which motion is sought: Ward's (54 R + 183 G + 19 B) / 256 (2003, section 2), at 8 bit whatever the depth.
    ///
    /// # Errors
    /// [`Error::Scratch`], where the frame is on disk.
    pub fn grey(&self) -> Result<Plane<u8>> {
        self.greys(None)
    }

    /// The grey picture as [`grey`](Self::grey) has it, but brightened by `stops` (0..=8) before it is rounded to 8 bit: of a dark frame
    /// much is between its codes, in its three channels and in the bits beyond the eighth.
    ///
    /// # Errors
    /// [`Error::Scratch`], where the frame is on disk.
    pub fn grey_brightened(&self, stops: u32) -> Result<Plane<u8>> {
        self.greys(Some(stops))
    }

    /// The [`grey`](Self::grey) picture, or where there are `stops` the [`grey_brightened`](Self::grey_brightened) one.
    pub(crate) fn greys(&self, stops: Option<u32>) -> Result<Plane<u8>> {
        let mut grey = Plane::filled(self.width, self.height, 0);
        // By parts, so that of a frame on disk the codes are never there as a whole.
        for first in (0..self.height).step_by(READ_ROWS) {
            let window = self.window(first..self.height.min(first + READ_ROWS))?;
            let rows = &mut grey.as_mut_slice()[first * self.width..][..window.rows().len() * self.width];
            rows.par_chunks_mut(BAND_ROWS * self.width).enumerate().for_each(|(band, rows)| {
                for (k, row) in rows.chunks_exact_mut(self.width).enumerate() {
                    window.grey_row(first + band * BAND_ROWS + k, stops, row);
                }
            });
        }
        Ok(grey)
    }
}

/// Where the frames of a bracket are that do not fit into memory, and what does fit.
#[derive(Debug, Clone)]
struct OnDisk {
    scratch: Arc<Scratch>,
    budget: Budget,
}

/// Frames of one size by rising relative exposure (then by path), and the one that the others are aligned to.
#[derive(Debug, Clone)]
pub struct Bracket {
    frames: Vec<Frame>,
    reference: usize,
    on_disk: Option<OnDisk>,
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
        let chosen = reference::chosen(&reference::paths(&frames), reference)?;
        frames
            .sort_by(|a, b| a.exposure.relative().total_cmp(&b.exposure.relative()).then_with(|| a.path.cmp(&b.path)));
        let reference = match chosen {
            Some(path) => frames.iter().position(|f| f.path == path).unwrap_or(0),
            None => match reference {
                ReferenceChoice::AutoExcept(except) => reference::best(&frames, except),
                _ => reference::best(&frames, &[]),
            },
        };
        Ok(Bracket { frames, reference, on_disk: None })
    }

    /// The same frames, but that with index `reference` is the one that the others are aligned to.
    ///
    /// # Panics
    /// Where there is no such frame.
    pub fn with_reference(self, reference: usize) -> Self {
        assert!(reference < self.frames.len(), "the reference is one of the frames");
        Bracket { reference, ..self }
    }

    /// The index of the frame that sees the most of those that `is_open` tells; none where there is none.
    pub(crate) fn best_of(&self, is_open: impl Fn(usize) -> bool) -> Option<usize> {
        reference::best_of(&self.frames, is_open)
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

    /// The scratch file that the frames are on, where they do not fit into the memory allowed.
    pub fn scratch(&self) -> Option<&Arc<Scratch>> {
        self.on_disk.as_ref().map(|on_disk| &on_disk.scratch)
    }

    /// What fits into memory at a time, where the frames do not.
    pub(crate) fn budget(&self) -> Option<&Budget> {
        self.on_disk.as_ref().map(|on_disk| &on_disk.budget)
    }

    /// How many of the threads that there are fit into the memory allowed; none where all do.
    pub(crate) fn threads(&self) -> Option<usize> {
        self.budget().map(|budget| budget.threads(rayon::current_num_threads()))
    }

    /// How many frames may be compared at a time: all where memory is enough, else one a thread.
    pub(crate) fn at_once(&self) -> usize {
        if self.on_disk.is_some() { rayon::current_num_threads() } else { self.frames.len() }
    }

    /// How many frames may have their features sought at a time: one a thread where memory is enough, else one.
    pub(crate) fn detected_at_once(&self) -> usize {
        if self.on_disk.is_some() { 1 } else { rayon::current_num_threads() }
    }

    /// `map` of every frame, in order, which reads the frame as a whole.
    pub(crate) fn map_whole<R: Send>(&self, map: impl Fn(&Frame) -> R + Sync) -> Vec<R> {
        let at_once = if self.on_disk.is_some() { 1 } else { self.frames.len() };
        map_at_once(self.frames.len(), at_once, |i| map(&self.frames[i]))
    }

    /// Which frame is meant by `path`: the one read from it, as given or by another way to the same file; or the only one whose file has
    /// that name.
    pub fn named(&self, path: &Path) -> Option<usize> {
        reference::named(&reference::paths(&self.frames), path)
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
