//! Arguments that the commands share.

use crate::cli::arguments::choice::choice;
use crate::cli::heading::{ALIGNMENT, INPUT, OUTPUT, RESOURCES};
use crate::cli::process::memory;
use clap::Args;
use clap::builder::{PathBufValueParser, TypedValueParser};
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
    /// Set the exposures in EV, one for each photograph in the order given, instead of those of EXIF
    #[arg(short, long, help_heading = INPUT, value_name = "EV,EV,...", value_delimiter = ',', allow_hyphen_values = true)]
    ev: Option<Vec<f64>>,

    /// Set the alignment method
    #[arg(long, help_heading = ALIGNMENT, value_parser = choice::<AlignMode>(), default_value_t, value_name = "METHOD")]
    align: AlignMode,

    /// Set the largest rotation searched with bitmaps, in degrees to either side
    #[arg(long, help_heading = ALIGNMENT, hide_short_help = true, value_name = "DEG", default_value_t = MtbOptions::default().max_rotation_deg, allow_negative_numbers = true)]
    max_rotation: f64,

    /// Set the robust estimator for feature matches
    #[arg(long, help_heading = ALIGNMENT, hide_short_help = true, value_parser = choice::<RobustMethod>(), default_value_t, value_name = "METHOD")]
    robust: RobustMethod,
}

/// Threads, memory, and what is replaced and printed.
#[derive(Debug, Args)]
#[command(next_help_heading = RESOURCES)]
pub struct Work {
    /// Set the number of threads [default: one for each core]; results do not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,

    /// Limit the memory, as 500MB or 4GB [default: three quarters of what is free]
    ///
    /// What does not fit is kept in a temporary file in the --scratch folder. Results do not depend on it
    #[arg(long, value_name = "SIZE", value_parser = memory::size)]
    max_memory: Option<u64>,

    #[command(flatten)]
    pub largest: Largest,

    /// Set the folder for what does not fit into memory [default: that of the first result, or the system's temporary folder]
    #[arg(long, hide_short_help = true, value_name = "FOLDER")]
    scratch: Option<PathBuf>,

    /// Exit with 3 when the result is doubtful
    ///
    /// That is: a frame was left out or is doubtful, the frames overlap by less than half, or an exposure or the response was guessed
    #[arg(long, help_heading = OUTPUT)]
    pub strict: bool,

    /// Replace existing files
    #[arg(short, long, help_heading = OUTPUT)]
    pub force: bool,

    /// No progress, summary or warnings; results are still listed on stdout
    #[arg(short, long, help_heading = OUTPUT)]
    pub quiet: bool,
}

/// How large what is read may be.
#[derive(Debug, Args)]
pub struct Largest {
    /// Limit the pixels of an image, as 800M or 2G [default: 500M]; larger images are rejected before they are decoded
    #[arg(long, help_heading = RESOURCES, hide_short_help = true, value_name = "N", value_parser = memory::count)]
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

    /// Limit the memory, as 500MB or 4GB [default: three quarters of what is free]; files that need more are rejected
    #[arg(long, help_heading = RESOURCES, value_name = "SIZE", value_parser = memory::size)]
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

    /// Set the frame that the others are aligned to: its number in the order given, from 1, or its file name
    #[arg(long, help_heading = INPUT, value_name = "N|FILE")]
    reference: Option<String>,

    #[command(flatten)]
    method: Method,

    /// Leave this photograph out; may be repeated
    #[arg(long, help_heading = INPUT, hide_short_help = true, value_name = "FILE")]
    leave_out: Vec<PathBuf>,

    /// Do not align this photograph: it did not move; may be repeated
    #[arg(long, help_heading = ALIGNMENT, hide_short_help = true, value_name = "FILE")]
    unmoved: Vec<PathBuf>,

    #[command(flatten)]
    pub work: Work,
}

/// Which part of the reference is shown.
#[derive(Debug, Args)]
pub struct Cut {
    /// Crop the results: to the area that all frames cover, not at all, or to these pixels of the reference frame
    ///
    /// Where not all frames cover the area, those that do are merged
    #[arg(short = 'C', long, help_heading = OUTPUT, default_value_t, value_name = "common|none|X,Y,WIDTH,HEIGHT")]
    pub crop: Crop,
}

/// The same, and how what comes of it is cut and told.
#[derive(Debug, Args)]
pub struct Common {
    #[command(flatten)]
    pub aligned: Aligned,

    /// Read the transforms from FILE (JSON), or write them to it where it does not exist; it is never replaced
    #[arg(long, help_heading = ALIGNMENT, hide_short_help = true, value_name = "FILE")]
    transforms: Option<PathBuf>,

    #[command(flatten)]
    cut: Cut,

    /// Write a report: .html to look at, .json for programs
    #[arg(long, help_heading = OUTPUT, value_name = "FILE", value_parser = PathBufValueParser::new().try_map(report_file))]
    report: Option<PathBuf>,

    /// Print the report as JSON to stdout instead of the files written
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,

    /// Print a line for each frame and the time of each stage
    #[arg(short, long, help_heading = OUTPUT, conflicts_with = "quiet")]
    pub verbose: bool,
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
                mode: self.align,
                robust: self.robust,
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
