//! Brackets: differently exposed photographs of one scene, decoded and sorted by exposure.
//!
//! In: paths. Out: a [`Bracket`] of [`Frame`]s by rising exposure. Frames keep the pixel values that the camera wrote
//! (8 or 16 bit, camera-encoded, orientation applied), three integers per pixel, in memory or, where memory is limited,
//! on disk. Cost: the decoders, which run in parallel, one frame per thread.

pub mod colour;
mod decode;
pub mod exposure;
mod from_image;
mod grey;
#[doc(hidden)]
pub mod header;
mod load;
mod metadata;
mod photograph;
mod raw;
mod reference;
mod window;

pub use load::{LoadOptions, load, load_with_progress};
pub(crate) use load::{differing_profiles, load_for};
#[doc(hidden)]
pub use photograph::Photograph;
pub(crate) use raw::MergedMosaic;
pub use raw::{Pattern, Raw};
pub use reference::ReferenceChoice;
pub(crate) use reference::named;
#[doc(hidden)]
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

/// File extensions of the photographs read from a folder, compared without case.
pub(crate) const EXTENSIONS: [&str; 8] = ["jpg", "jpeg", "jpe", "jfif", "png", "tif", "tiff", "dng"];

/// Pixel values: interleaved RGB by rows.
#[doc(hidden)]
#[derive(Debug, Clone, PartialEq)]
pub enum Samples {
    /// 0..=255.
    Eight(Vec<u8>),
    /// 0..=65535.
    Sixteen(Vec<u16>),
}

impl Samples {
    /// The largest possible pixel value: 255 or 65535.
    pub fn max(&self) -> u16 {
        match self {
            Samples::Eight(_) => u8::MAX.into(),
            Samples::Sixteen(_) => u16::MAX,
        }
    }

    /// Number of values: three per pixel.
    pub fn len(&self) -> usize {
        match self {
            Samples::Eight(v) => v.len(),
            Samples::Sixteen(v) => v.len(),
        }
    }

    /// Whether there are no values.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Size in memory, in bytes.
    pub(crate) fn bytes(&self) -> u64 {
        match self {
            Samples::Eight(v) => v.len() as u64,
            Samples::Sixteen(v) => 2 * v.len() as u64,
        }
    }
}

/// Capture data other than the exposure; copied to the outputs.
#[doc(hidden)]
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Capture {
    /// EXIF Make.
    pub make: Option<String>,
    /// EXIF Model.
    pub model: Option<String>,
    /// EXIF DateTimeOriginal or else DateTime, as `YYYY:MM:DD HH:MM:SS`.
    pub date: Option<String>,
    /// Time of the exposure, to the precision that the camera writes.
    pub taken: Option<header::Moment>,
    /// EXIF LensModel.
    pub lens: Option<String>,
    /// EXIF FocalLength, in millimetres.
    pub focal_length_mm: Option<f64>,
    /// The EXIF fields that are valid for the results too, as a TIFF block; the GPS position is included only on
    /// request.
    pub exif: Option<Vec<u8>>,
}

/// Number of rows read at a time when a whole frame is processed by rows: 16 bands, so that all threads have work.
const READ_ROWS: usize = 16 * BAND_ROWS;

/// One decoded photograph of a bracket.
#[derive(Debug, Clone)]
pub struct Frame {
    path: PathBuf,
    width: usize,
    height: usize,
    store: Store,
    /// Number of sampled pixels that are well exposed: see [`reference::well_exposed`].
    well_exposed: u64,
    /// Exposure of the frame.
    pub exposure: Exposure,
    /// Colour profile of the frame; sRGB is assumed where there is none.
    pub profile: Option<Profile>,
    /// What the camera raw file shows from which the frame was read; none for other files. The response of a raw frame
    /// is known (sRGB), and its profile has the colours of the camera.
    pub raw: Option<Raw>,
    /// Other capture data.
    pub capture: Capture,
    /// Why the frame is excluded from the merge unless the user includes it, for example because the flash fired.
    pub excluded: Option<String>,
}

impl Frame {
    /// Whether the frame was read from a camera raw file.
    pub fn is_raw(&self) -> bool {
        self.raw.is_some()
    }

    /// Creates a frame of `width` x `height` pixels from interleaved RGB pixel values.
    ///
    /// # Panics
    /// If the number of samples does not match the size, or the size is zero; decoders check both.
    pub fn new(path: PathBuf, width: usize, height: usize, samples: Samples, exposure: Exposure) -> Self {
        let well_exposed = reference::well_exposed(&samples, width);
        Frame::stored(path, (width, height), Store::Held(samples), well_exposed, exposure)
    }

    /// Same as [`new`](Self::new), but the pixel values may be on disk, and the well-exposed pixels are already
    /// counted.
    fn stored(path: PathBuf, size: (usize, usize), store: Store, well_exposed: u64, exposure: Exposure) -> Self {
        let (width, height) = size;
        assert!(
            width > 0 && height > 0 && store.len() == 3 * width * height,
            "a frame has three samples for each pixel"
        );
        Frame {
            path,
            width,
            height,
            store,
            well_exposed,
            exposure,
            profile: None,
            raw: None,
            capture: Capture::default(),
            excluded: None,
        }
    }

    /// Path of the file that the frame was read from.
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

    /// The largest possible pixel value: 255 or 65535.
    pub fn max(&self) -> u16 {
        self.store.max()
    }

    /// Size of a row in memory, in bytes.
    pub fn row_bytes(&self) -> u64 {
        self.store.bytes() / self.height as u64
    }

    /// Reads the pixel values of a range of rows.
    ///
    /// # Errors
    /// [`Error::Scratch`] where the frame is on disk and cannot be read.
    ///
    /// # Panics
    /// If the rows are outside the frame: here, or when the values of the window are used.
    pub fn window(&self, rows: Range<usize>) -> Result<Window<'_>> {
        self.store.window((self.width, self.height), rows)
    }

    /// Reads all pixel values.
    ///
    /// # Errors
    /// [`Error::Scratch`] where the frame is on disk and cannot be read.
    pub fn whole(&self) -> Result<Window<'_>> {
        self.window(0..self.height)
    }

    /// Primaries of the pixel values: those of the profile, or sRGB's where there is no profile or its primaries are
    /// unknown.
    pub fn primaries(&self) -> Primaries {
        self.profile.as_ref().and_then(|profile| profile.primaries).unwrap_or(Primaries::SRGB)
    }

    /// Computes the grey image used for alignment: (54 R + 183 G + 19 B) / 256 (Ward 2003, section 2). The result has 8
    /// bits for frames of 8 and of 16 bits.
    ///
    /// # Errors
    /// [`Error::Scratch`] where the frame is on disk and cannot be read.
    pub fn grey(&self) -> Result<Plane<u8>> {
        self.greys(None)
    }

    /// Same as [`grey`](Self::grey), but brightened by `stops` (0..=8) before rounding to 8 bits. This keeps detail of
    /// a dark frame that rounding would lose.
    ///
    /// # Errors
    /// [`Error::Scratch`] where the frame is on disk and cannot be read.
    pub fn grey_brightened(&self, stops: u32) -> Result<Plane<u8>> {
        self.greys(Some(stops))
    }

    /// Computes [`grey`](Self::grey), or [`grey_brightened`](Self::grey_brightened) where `stops` is given.
    pub(crate) fn greys(&self, stops: Option<u32>) -> Result<Plane<u8>> {
        let mut grey = Plane::filled(self.width, self.height, 0);
        // The frame is read in parts, so that a frame on disk is never held in memory as a whole.
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

/// Scratch file and memory budget of a bracket whose frames do not fit into memory.
#[derive(Debug, Clone)]
struct OnDisk {
    scratch: Arc<Scratch>,
    budget: Budget,
}

/// Frames of one size, sorted by rising relative exposure, then by path, and the index of the reference frame.
#[derive(Debug, Clone)]
pub struct Bracket {
    frames: Vec<Frame>,
    reference: usize,
    on_disk: Option<OnDisk>,
}

impl Bracket {
    /// Sorts `frames` by exposure and chooses the reference frame.
    ///
    /// # Errors
    /// [`Error::TooFewFrames`], [`Error::SizeMismatch`], or [`Error::Option`] where the reference is not a frame of the
    /// bracket.
    pub fn new(mut frames: Vec<Frame>, reference: &ReferenceChoice) -> Result<Self> {
        let [first, _, ..] = &frames[..] else {
            return Err(Error::TooFewFrames { given: frames.len() });
        };
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

    /// Replaces the reference frame by the frame with index `reference`.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn with_reference(self, reference: usize) -> Self {
        assert!(reference < self.frames.len(), "there is no frame {reference}");
        Bracket { reference, ..self }
    }

    /// Returns the index of the best-exposed frame for which `is_open` is true, if any.
    pub(crate) fn best_of(&self, is_open: impl Fn(usize) -> bool) -> Option<usize> {
        reference::best_of(&self.frames, is_open)
    }

    /// Corrects the exposure of each frame by a number of stops. The frames stay in the order of the exposures as
    /// loaded, even if the corrected exposures are in another order.
    ///
    /// # Panics
    /// If there is not one correction per frame.
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

    /// Index of the reference frame in [`frames`](Self::frames).
    pub fn reference_index(&self) -> usize {
        self.reference
    }

    /// The scratch file that holds the frames, where they exceed the memory limit.
    pub fn scratch(&self) -> Option<&Arc<Scratch>> {
        self.on_disk.as_ref().map(|on_disk| &on_disk.scratch)
    }

    /// The memory budget, where the frames exceed the memory limit.
    pub(crate) fn budget(&self) -> Option<&Budget> {
        self.on_disk.as_ref().map(|on_disk| &on_disk.budget)
    }

    /// Number of threads that fit into the memory budget; `None` where memory is sufficient.
    pub(crate) fn threads(&self) -> Option<usize> {
        self.budget().map(|budget| budget.threads(rayon::current_num_threads()))
    }

    /// Number of frames that may be compared at a time: all where memory is sufficient, else one per thread.
    pub(crate) fn at_once(&self) -> usize {
        if self.on_disk.is_some() { rayon::current_num_threads() } else { self.frames.len() }
    }

    /// Number of frames in which features may be detected at a time: one per thread where memory is sufficient, else
    /// one.
    pub(crate) fn detected_at_once(&self) -> usize {
        if self.on_disk.is_some() { 1 } else { rayon::current_num_threads() }
    }

    /// Applies `map` to every frame and returns the results in the order of the frames. `map` reads a whole frame, so
    /// frames on disk are processed one at a time.
    pub(crate) fn map_whole<R: Send>(&self, map: impl Fn(&Frame) -> R + Sync) -> Vec<R> {
        let at_once = if self.on_disk.is_some() { 1 } else { self.frames.len() };
        map_at_once(self.frames.len(), at_once, |i| map(&self.frames[i]))
    }

    /// Returns the index of the frame read from `path` or from another path to the same file, else of the only frame
    /// with that file name.
    pub fn named(&self, path: &Path) -> Option<usize> {
        reference::named(&reference::paths(&self.frames), path)
    }

    /// The frame that the others are aligned to; the result has its size and shows the same view.
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
    fn one_frame_or_two_sizes_are_an_error() {
        let auto = ReferenceChoice::Auto;
        assert!(matches!(Bracket::new(vec![frame("a", 3, 0.0)], &auto), Err(Error::TooFewFrames { given: 1 })));
        let odd = Bracket::new(vec![frame("a", 3, 0.0), frame("b", 4, 1.0)], &auto);
        assert!(matches!(odd, Err(Error::SizeMismatch { size: (4, 2), other_size: (3, 2), .. })));
    }
}
