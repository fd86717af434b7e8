//! Aligns a bracket of differently exposed photographs, recovers the camera's response, merges the frames to linear
//! radiance, and tone-maps it.
//!
//! From files to files, like the command `hdralign merge`:
//!
//! ```no_run
//! use hdralign::pipeline::{self, Options};
//!
//! # fn main() -> hdralign::error::Result<()> {
//! let images = ["IMG_1.jpg".into(), "IMG_2.jpg".into(), "IMG_3.jpg".into()];
//! let options = Options { outputs: vec!["room.exr".into(), "room.png".into()], ..Options::default() };
//! let report = pipeline::run(&images, &options, &pipeline::unwatched)?;
//! for frame in &report.frames {
//!     println!("{}: {:?}, confidence {:.2}", frame.path, frame.alignment.status, frame.alignment.confidence);
//! }
//! # Ok(())
//! # }
//! ```
//!
//! From memory to memory, without files. The caller chooses the thread pool, and may cancel the run:
//!
//! ```
//! use hdralign::bracket::{Bracket, Frame, ReferenceChoice, exposure::Exposure};
//! use hdralign::pipeline::{self, Options};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/testdata/window");
//! let mut frames = Vec::new();
//! for (i, ev) in [(1, -4.0), (3, 0.0), (5, 4.0)] {
//!     let image = image::open(format!("{folder}/window_{i}.jpg"))?;
//!     let exposure = Exposure::given(ev).ok_or("not finite")?;
//!     frames.push(Frame::from_image(format!("{ev} EV"), image, exposure)?);
//! }
//! let bracket = Bracket::new(frames, &ReferenceChoice::Auto)?;
//! let result = pipeline::merge_bracket(bracket, &Options::default(), &pipeline::unwatched)?;
//!
//! let radiance = image::Rgb32FImage::from(result.radiance.pixels);
//! let picture = image::RgbImage::from(result.display.pixels);
//! assert_eq!(radiance.dimensions(), picture.dimensions());
//! # Ok(())
//! # }
//! ```
//!
//! Alignment only:
//!
//! ```
//! use hdralign::align::{AlignOptions, align};
//! use hdralign::bracket::{LoadOptions, load};
//! # use std::path::PathBuf;
//!
//! # fn main() -> hdralign::error::Result<()> {
//! # let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/testdata/window");
//! # let images: Vec<PathBuf> = (1..=5).map(|i| PathBuf::from(format!("{folder}/window_{i}.jpg"))).collect();
//! let (bracket, _warnings) = load(&images, &LoadOptions::default())?;
//! let (alignment, _warnings) = align(&bracket, &AlignOptions::default())?;
//! for (frame, placement) in bracket.frames().iter().zip(&alignment.placements) {
//!     println!("{}: {:?}, confidence {:.2}", frame.path().display(), placement.model(), placement.confidence());
//! }
//! # assert!(alignment.placements.iter().all(|placement| placement.confidence() > 0.5));
//! # Ok(())
//! # }
//! ```
//!
//! # The pipeline
//!
//! [`pipeline::run`] runs all stages: [load](bracket::load) → [align](align::align) → [response](response::recover) →
//! [merge](merge::merge) → [tonemap](tonemap::tonemap) → [write](write::write) → [report](report::Report). Each stage
//! borrows its input and returns a new value; each can be called separately.
//!
//! # Terms
//!
//! - **Bracket**: differently exposed photographs of one scene. **Frame**: one photograph of a bracket, as pixel
//!   values of the camera. The other frames are aligned to the **reference** frame.
//! - **Pixel value** (code value) Z: the stored integer, 0..=255 or 0..=65535, encoded by the camera.
//! - **Exposure** X = E Δt: the light collected by a pixel. **Relative exposure** of a frame: t · ISO / N², with the
//!   exposure time t and the f-number N. **EV**: log2 of the relative exposure.
//! - **Response** g(Z) = ln X: the logarithmic exposure of a pixel value. **Radiance** E: exposure divided by time.
//! - **Transform**: maps a position in the reference frame to a position in another frame. (0, 0) is the centre of the
//!   top-left pixel, x to the right, y down.
//! - **MTB**: median threshold bitmap (Ward 2003), the pixels brighter than the median. The exclusion bitmap excludes
//!   pixels close to the median from comparison.
//!
//! # Layers
//!
//! The modules are listed from the lowest layer to the highest. A module uses only those before it: [`error`],
//! [`limits`], `intake`, `tiff_file`, [`simd`], [`plane`], `statistics`, [`scratch`], `budget`, [`pyramid`], `pixel`,
//! [`bracket`], [`align`], [`response`], [`merge`], [`tonemap`], [`mod@write`], [`read`], [`report`], `draw`,
//! [`inspect`], [`compare`], `page`, [`pipeline`], [`batch`], and the program's `cli`. In the folder of a stage,
//! `mod.rs` has the main types and the entry function, which may be a re-export.
//!
//! # Reproducible results
//!
//! Results do not depend on the number of threads, on the processor, or on the order of the inputs (unless exposures or
//! the reference are given by position). Parallel work is split into fixed parts, such as bands of rows, and the
//! results of the parts are combined in a fixed order. The functions exp, ln, pow and similar ones come from one
//! portable implementation.
//!
//! # Stability
//!
//! Items that this documentation does not show (`#[doc(hidden)]`) are public only for the program, the tests, the
//! benchmarks and the fuzz targets. They may change in any release.

pub mod align;
#[doc(hidden)]
pub mod batch;
pub mod bracket;
mod budget;
#[doc(hidden)]
pub mod compare;
mod draw;
pub mod error;
#[doc(hidden)]
pub mod inspect;
mod intake;
pub mod limits;
pub mod merge;
mod page;
pub mod pipeline;
mod pixel;
pub mod plane;
#[doc(hidden)]
pub mod pyramid;
pub mod read;
pub mod report;
pub mod response;
#[doc(hidden)]
pub mod scratch;
#[doc(hidden)]
pub mod simd;
mod statistics;
mod tiff_file;
pub mod tonemap;
pub mod write;
