//! Arguments that the commands share.

use super::memory;
use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::{Args, ValueEnum};
use hdralign::align::bitmaps::MtbOptions;
use hdralign::align::preset::{Preset, PresetTransform};
use hdralign::align::{AlignMode, AlignOptions, RobustMethod};
use hdralign::bracket::{LoadOptions, ReferenceChoice};
use hdralign::limits::Limits;
use hdralign::pipeline::{Crop, Options};
use hdralign::scratch::MemoryLimit;
use hdralign::write;
use std::path::{Path, PathBuf};

/// How photographs are aligned, whichever they are.
#[derive(Debug, Args)]
pub struct Method {
    /// Exposures in EV, one for each photograph in the order given; they win over EXIF
    #[arg(short, long, value_name = "EV,EV,...", value_delimiter = ',', allow_hyphen_values = true)]
    ev: Option<Vec<f64>>,

    /// How the frames are aligned
    #[arg(long, value_enum, default_value_t, value_name = "METHOD")]
    align: AlignArg,

    /// Largest rotation that the bitmaps are searched for, in degrees to either side
    #[arg(long, value_name = "DEG", default_value_t = MtbOptions::default().max_rotation_deg, allow_negative_numbers = true)]
    max_rotation: f64,

    /// How matches of features that agree on a motion are told from wrong ones
    #[arg(long, value_enum, default_value_t, value_name = "METHOD")]
    robust: RobustArg,
}

/// What the machine may be used for, what may be replaced, and what is said.
#[derive(Debug, Args)]
pub struct Work {
    /// Threads that compute [default: one for each core]; the results are the same
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,

    /// Memory that may be used at most, as 500MB or 4GB [default: three quarters of what is free]; the results are the same. What does
    /// not fit is on disk for as long as it is needed
    #[arg(long, value_name = "SIZE", value_parser = memory::size)]
    max_memory: Option<u64>,

    #[command(flatten)]
    pub largest: Largest,

    /// The folder for what does not fit into memory [default: that of the first result, else the system's for temporary files]
    #[arg(long, value_name = "FOLDER")]
    scratch: Option<PathBuf>,

    /// Exit with 3 when a frame was left out or doubtful, the frames overlap by less than half, or an exposure or the response was guessed
    #[arg(long)]
    pub strict: bool,

    /// Replace files that exist
    #[arg(short, long)]
    pub force: bool,

    /// No progress, summary or warnings: errors alone on standard error; results are still listed on standard output
    #[arg(short, long)]
    pub quiet: bool,
}

/// How large what is read may be.
#[derive(Debug, Args)]
pub struct Largest {
    /// Pixels that a picture may have at most, as 800M or 2G [default: 500M]; what says to be larger is refused before it is decoded
    #[arg(long, value_name = "N", value_parser = memory::count)]
    max_pixels: Option<u64>,
}

impl Largest {
    /// Pixels, where the user says so.
    pub fn given(&self) -> Option<u64> {
        self.max_pixels
    }

    /// Pixels, as given or by default.
    pub fn pixels(&self) -> u64 {
        self.max_pixels.unwrap_or(Limits::MAX_PIXELS)
    }
}

/// What files that are read as they are may ask for.
#[derive(Debug, Args)]
pub struct Reading {
    #[command(flatten)]
    largest: Largest,

    /// Memory that may be used at most, as 500MB or 4GB [default: three quarters of what is free]; what takes more is refused
    #[arg(long, value_name = "SIZE", value_parser = memory::size)]
    max_memory: Option<u64>,
}

impl Reading {
    /// The same, as limits.
    pub fn limits(&self) -> Limits {
        let memory = allowed(self.max_memory).map(|bytes| bytes.saturating_sub(MemoryLimit::PROGRAM));
        Limits { max_pixels: self.largest.pixels(), memory }
    }
}

/// Bytes of memory that may be used: those `given`, or three quarters of what is free, where that can be told.
fn allowed(given: Option<u64>) -> Option<u64> {
    given.or_else(|| Some(memory::free()? / 4 * 3))
}

/// What the photographs are, and how they are aligned.
#[derive(Debug, Args)]
pub struct Aligned {
    /// The photographs of one bracket: JPEG, PNG or TIFF, in any order
    #[arg(required = true, value_name = "IMAGES")]
    pub images: Vec<PathBuf>,

    /// The photograph that the others are aligned to: its number in the order given, from 1, or its file name
    #[arg(long, value_name = "N|FILE")]
    reference: Option<String>,

    #[command(flatten)]
    method: Method,

    /// Leave this photograph out; may be repeated
    #[arg(long, value_name = "FILE")]
    leave_out: Vec<PathBuf>,

    /// This photograph did not move: take it as it lies; may be repeated
    #[arg(long, value_name = "FILE")]
    unmoved: Vec<PathBuf>,

    #[command(flatten)]
    pub work: Work,
}

/// Which part of the reference is shown.
#[derive(Debug, Args)]
pub struct Cut {
    /// Which part of the reference the results show: what all merged photographs show, all of it, or these of its pixels. Where not all
    /// photographs reach, those that do are merged
    #[arg(short = 'C', long, default_value_t, value_name = "common|none|X,Y,WIDTH,HEIGHT")]
    pub crop: Crop,
}

/// The same, and how what comes of it is cut and told.
#[derive(Debug, Args)]
pub struct Common {
    #[command(flatten)]
    pub aligned: Aligned,

    /// Transforms as JSON: taken from FILE where it exists, else found and written to it; never replaced
    #[arg(long, value_name = "FILE")]
    transforms: Option<PathBuf>,

    #[command(flatten)]
    cut: Cut,

    /// Write a report of everything that was done; the extension picks the format: .json (programs), .html (a page to look at)
    #[arg(long, value_name = "FILE", value_parser = PathBufValueParser::new().try_map(report_file))]
    report: Option<PathBuf>,

    /// Print the report to standard output instead of the paths written
    #[arg(long)]
    pub json: bool,

    /// Say more: a line for each frame, the time of each stage
    #[arg(short, long, conflicts_with = "quiet")]
    pub verbose: bool,
}

/// See [`AlignMode`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum AlignArg {
    /// Bitmaps, features and pixels, as far as needed, every result judged
    #[default]
    Auto,
    /// Median threshold bitmaps alone: shift and rotation
    Mtb,
    /// SIFT features alone: a homography
    Sift,
    /// The frames as they lie
    None,
}

/// See [`RobustMethod`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum RobustArg {
    /// The motion with which most agree within a threshold
    #[default]
    Ransac,
    /// The motion with the least median of squares: no threshold, but over half must be right
    Lmeds,
}

/// The file for the report; `-` is what other programs take for standard output.
fn report_file(path: PathBuf) -> Result<PathBuf, &'static str> {
    if path.as_os_str() == "-" { Err("give --json for the report on standard output") } else { Ok(path) }
}

impl Method {
    /// The library's options that these arguments stand for; all others as by default.
    pub fn options(&self) -> Options {
        Options {
            load: LoadOptions { ev: self.ev.clone(), ..LoadOptions::default() },
            align: AlignOptions {
                mode: match self.align {
                    AlignArg::Auto => AlignMode::Auto,
                    AlignArg::Mtb => AlignMode::Mtb,
                    AlignArg::Sift => AlignMode::Sift,
                    AlignArg::None => AlignMode::None,
                },
                robust: match self.robust {
                    RobustArg::Ransac => RobustMethod::Ransac,
                    RobustArg::Lmeds => RobustMethod::Lmeds,
                },
                mtb: MtbOptions { max_rotation_deg: self.max_rotation, ..MtbOptions::default() },
                ..AlignOptions::default()
            },
            ..Options::default()
        }
    }
}

impl Work {
    /// How much memory may be used; what does not fit goes to `folder`, unless another is named.
    pub fn memory(&self, folder: impl FnOnce() -> PathBuf) -> Option<MemoryLimit> {
        Some(MemoryLimit { bytes: allowed(self.max_memory)?, folder: self.scratch.clone().unwrap_or_else(folder) })
    }
}

impl Aligned {
    /// The library's options that these arguments stand for; all others as by default.
    pub fn options(&self) -> Options {
        let options = self.method.options();
        Options {
            load: LoadOptions {
                reference: self.reference(),
                max_pixels: self.work.largest.pixels(),
                memory: self.work.memory(std::env::temp_dir),
                ..options.load
            },
            align: AlignOptions { given: self.given(), ..options.align },
            write: write::Options { overwrite: self.work.force, ..write::Options::default() },
            threads: self.work.threads,
            ..options
        }
    }

    /// What the user says of single frames.
    fn given(&self) -> Vec<Preset> {
        let all = |paths: &[PathBuf], place: PresetTransform| {
            paths.iter().map(|p| Preset { path: p.clone(), place: place.clone() }).collect::<Vec<_>>()
        };
        [all(&self.leave_out, PresetTransform::Excluded), all(&self.unmoved, PresetTransform::Unmoved)].concat()
    }

    /// A number, unless a file of that name was given.
    fn reference(&self) -> ReferenceChoice {
        match &self.reference {
            None if self.leave_out.is_empty() => ReferenceChoice::Auto,
            None => ReferenceChoice::AutoExcept(self.leave_out.clone()),
            Some(text) => match text.parse() {
                Ok(number) if !self.images.iter().any(|i| i.as_os_str() == text.as_str()) => {
                    ReferenceChoice::Number(number)
                }
                _ => ReferenceChoice::File(text.into()),
            },
        }
    }
}

impl Common {
    /// The file for the report.
    pub fn report(&self) -> Option<&Path> {
        self.report.as_deref()
    }

    /// The library's options that these arguments stand for; all others as by default.
    pub fn options(&self) -> Options {
        Options {
            crop: self.cut.crop,
            transforms: self.transforms.clone(),
            report: self.report.clone(),
            ..self.aligned.options()
        }
    }
}
