//! Arguments that several commands share: frames, alignment, output, threads and memory.

use crate::cli::arguments::choice::choice;
use crate::cli::heading::{ALIGNMENT, INPUT, OUTPUT, RESOURCES};
use crate::cli::process::memory;
use clap::Args;
use clap::builder::{PathBufValueParser, TypedValueParser};
use hdralign::align::bitmaps::MtbOptions;
use hdralign::align::preset::{Preset, PresetTransform};
use hdralign::align::{AlignMode, AlignOptions, Local, RobustMethod};
use hdralign::bracket::{LoadOptions, ReferenceChoice};
use hdralign::limits::Limits;
use hdralign::pipeline::{Crop, Options};
use hdralign::scratch::MemoryLimit;
use hdralign::write;
use std::path::{Path, PathBuf};

/// Exposures and method of alignment.
#[derive(Debug, Args)]
pub struct Method {
    /// Set the exposures in EV, one for each photograph, in the order of the photographs in the command
    ///
    /// With -e=-2,0,2 the first photograph is the darkest. *.jpg stands for the files in the order of their names.
    /// These exposures replace those in EXIF, and are used even if the brightness of the photographs contradicts them
    #[arg(short, long, help_heading = INPUT, value_name = "EV,...", value_delimiter = ',', allow_hyphen_values = true)]
    ev: Option<Vec<f64>>,

    /// Set the alignment method; auto tries several and checks the results
    #[arg(long, help_heading = ALIGNMENT, value_parser = choice::<AlignMode>(), default_value_t, value_name = "METHOD")]
    align: AlignMode,

    /// Follow what one homography for each frame cannot: the lens, a rolling shutter, or depth; with --align auto
    #[arg(long, help_heading = ALIGNMENT, hide_short_help = true, value_parser = choice::<Local>(), default_value_t, value_name = "WHEN")]
    local: Local,

    /// Set the largest rotation that auto and mtb try with bitmaps, in degrees, clockwise and counterclockwise
    #[arg(long, help_heading = ALIGNMENT, hide_short_help = true, value_name = "DEG", default_value_t = MtbOptions::default().max_rotation_deg, allow_negative_numbers = true)]
    max_rotation: f64,

    /// Set the robust estimator, which separates right from wrong feature matches; for experts
    #[arg(long, help_heading = ALIGNMENT, hide_short_help = true, value_parser = choice::<RobustMethod>(), default_value_t, value_name = "METHOD")]
    robust: RobustMethod,
}

/// Threads, memory, and the options of every command that reads photographs.
#[derive(Debug, Args)]
#[command(next_help_heading = RESOURCES)]
pub struct Work {
    /// Set the number of threads [default: one for each core]
    ///
    /// Results do not depend on it
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,

    /// Limit the memory, for example 4GB [default on Linux: 3/4 of free memory]
    ///
    /// GB is 10^9 bytes, GiB 2^30. Data that do not fit are kept in a temporary file in the --scratch folder. Results
    /// do not depend on the limit. On systems other than Linux there is no limit by default
    #[arg(long, value_name = "SIZE", value_parser = memory::size)]
    max_memory: Option<u64>,

    #[command(flatten)]
    pub largest: Largest,

    /// Set the folder for temporary data that do not fit into memory; it must exist
    ///
    /// By default merge and batch use the folder of the results, the other commands the system's temporary folder
    #[arg(long, hide_short_help = true, value_name = "FOLDER")]
    scratch: Option<PathBuf>,

    /// Exit with code 3 if the result is degraded (may be inaccurate)
    #[arg(long, help_heading = OUTPUT, long_help = STRICT)]
    pub strict: bool,

    /// Replace existing files
    #[arg(short, long, help_heading = OUTPUT)]
    pub force: bool,

    /// Print no progress, summary or warnings, only errors and file names
    ///
    /// Use -q in scripts. The option -q does not change what is printed to stdout: the names of the result files, JSON,
    /// or the list of `batch --dry-run`. Errors go to stderr. Without -q, progress is shown if stderr is a terminal
    #[arg(short, long, help_heading = OUTPUT)]
    pub quiet: bool,
}

/// The help of `--strict`. Lines have at most 90 characters, so that they are not wrapped.
const STRICT: &str = "\
Exit with code 3 if the result is degraded (may be inaccurate)

A result is degraded if a warning reports that
- a frame could not be aligned, or only with a confidence below 0.5
- a frame was too dark or too bright to align, and other frames show that the camera moved
- the frames overlap by less than half, or two of them have the same pixels
- the flash fired in some frames only, or the camera changed parts of frames (phones)
- an exposure is missing, was estimated, or contradicts the pixels
- the response could not be recovered, is of another camera, or contradicts the pixels
- `hdralign response`: the brackets are of different cameras
- `batch --shared-response`: a bracket could not be used for the response of its camera
Degraded results are written, too. The exposure and the pixels of a frame
that you exclude are checked, too, but not its alignment";

/// Limit on the size of images.
#[derive(Debug, Args)]
pub struct Largest {
    /// Limit the pixels of an image, for example 800M or 2G [default: 500M]; larger images are rejected before they are
    /// decoded
    #[arg(long, help_heading = RESOURCES, hide_short_help = true, value_name = "N", value_parser = memory::count)]
    max_pixels: Option<u64>,
}

impl Largest {
    /// Returns the limit in pixels if the user gave it.
    pub fn given(&self) -> Option<u64> {
        self.max_pixels
    }

    /// Returns the limit in pixels: the value that the user gave, or else the default.
    pub fn pixels(&self) -> u64 {
        self.max_pixels.unwrap_or(Limits::MAX_PIXELS)
    }
}

/// Limits of the commands that read whole files.
#[derive(Debug, Args)]
pub struct Reading {
    #[command(flatten)]
    largest: Largest,

    /// Limit the memory, for example 4GB [default on Linux: 3/4 of free memory]
    ///
    /// GB is 10^9 bytes, GiB 2^30. Files that need more are rejected. On systems other than Linux there is no limit by default
    #[arg(long, help_heading = RESOURCES, value_name = "SIZE", value_parser = memory::size)]
    max_memory: Option<u64>,
}

impl Reading {
    /// Returns the limits of the library for these arguments.
    pub fn limits(&self) -> Limits {
        let memory = allowed(self.max_memory).map(|bytes| bytes.saturating_sub(MemoryLimit::PROGRAM));
        Limits { max_pixels: self.largest.pixels(), memory }
    }
}

/// Returns the memory limit in bytes: `given`, or else three quarters of the free memory. Returns `None` if the free
/// memory is not known.
fn allowed(given: Option<u64>) -> Option<u64> {
    given.or_else(|| Some(memory::free()? / 4 * 3))
}

/// The photographs, and how they are aligned.
#[derive(Debug, Args)]
pub struct Aligned {
    /// The photographs of one bracket: JPEG, PNG, TIFF or DNG, in any order
    #[arg(required = true, value_name = "IMAGES")]
    pub images: Vec<PathBuf>,

    /// Set the reference frame: its file name, or its number (1 is the first)
    ///
    /// The other frames are aligned to it, and the results show its view. The number is its position in the command. By
    /// default, the reference is the best exposed frame
    #[arg(long, help_heading = INPUT, value_name = "FRAME")]
    reference: Option<String>,

    #[command(flatten)]
    method: Method,

    /// Exclude a photograph; may be repeated
    #[arg(long, help_heading = INPUT, hide_short_help = true, value_name = "FILE")]
    leave_out: Vec<PathBuf>,

    /// Use a photograph without aligning it; may be repeated
    #[arg(long, help_heading = ALIGNMENT, hide_short_help = true, value_name = "FILE")]
    unmoved: Vec<PathBuf>,
}

/// The part of the reference frame in the results.
#[derive(Debug, Args)]
pub struct Cut {
    /// Crop the results: common (the area that all frames cover), none, or X,Y,WIDTH,HEIGHT
    ///
    /// X,Y,WIDTH,HEIGHT is the part to keep, in pixels of the reference frame, counted from its top left corner. With
    /// `X,Y,WIDTH,HEIGHT` or `none`, some pixels may be covered by fewer frames than others
    #[arg(short = 'C', long, help_heading = OUTPUT, default_value_t, value_name = "AREA")]
    pub crop: Crop,
}

/// The photographs, how they are aligned, and a file for their transforms.
#[derive(Debug, Args)]
pub struct Common {
    #[command(flatten)]
    pub aligned: Aligned,

    /// Read the transforms from FILE (JSON) if it exists, otherwise write them to it. An existing file is never
    /// replaced, even with --force
    #[arg(long, help_heading = ALIGNMENT, hide_short_help = true, value_name = "FILE")]
    transforms: Option<PathBuf>,
}

/// Options on the results of `merge` and `align`.
#[derive(Debug, Args)]
pub struct Results {
    #[command(flatten)]
    cut: Cut,

    /// Write a report: .html for people, .json for programs
    #[arg(long, help_heading = OUTPUT, value_name = "FILE", value_parser = PathBufValueParser::new().try_map(report_file))]
    report: Option<PathBuf>,

    /// Print a JSON report for scripts instead of the names of the results
    ///
    /// It is printed to stdout; everything else goes to stderr
    #[arg(long, help_heading = OUTPUT)]
    pub json: bool,

    /// Print a line for each frame and the times of the main stages
    #[arg(short, long, help_heading = OUTPUT, conflicts_with = "quiet")]
    pub verbose: bool,

    #[command(flatten)]
    pub work: Work,
}

/// Parses the path of the report file. `-` means standard output in other programs. It is rejected here with a
/// message that names the option for this, `--json`.
fn report_file(path: PathBuf) -> Result<PathBuf, &'static str> {
    if path.as_os_str() == "-" { Err("give --json for the report on standard output") } else { Ok(path) }
}

impl Method {
    /// Returns the options of the library for these arguments. Library options without an argument in this group have
    /// their defaults.
    pub fn options(&self) -> Options {
        Options {
            load: LoadOptions { ev: self.ev.clone(), ..LoadOptions::default() },
            align: AlignOptions {
                mode: self.align,
                local: self.local,
                robust: self.robust,
                mtb: MtbOptions { max_rotation_deg: self.max_rotation, ..MtbOptions::default() },
                ..AlignOptions::default()
            },
            ..Options::default()
        }
    }
}

impl Work {
    /// Returns the memory limit. Data that do not fit are kept in the folder of `--scratch`, or else in `folder`.
    pub fn memory(&self, folder: impl FnOnce() -> PathBuf) -> Option<MemoryLimit> {
        Some(MemoryLimit { bytes: allowed(self.max_memory)?, folder: self.scratch.clone().unwrap_or_else(folder) })
    }
}

impl Aligned {
    /// Returns the options of the library for these arguments and for `work`. All other library options have their
    /// defaults.
    pub fn options(&self, work: &Work) -> Options {
        let options = self.method.options();
        Options {
            load: LoadOptions {
                reference: self.reference(),
                max_pixels: work.largest.pixels(),
                memory: work.memory(std::env::temp_dir),
                ..options.load
            },
            align: AlignOptions { given: self.given(), ..options.align },
            write: write::Options { overwrite: work.force, ..write::Options::default() },
            threads: work.threads,
            ..options
        }
    }

    /// Returns the frames that the user excluded or marked as unmoved.
    fn given(&self) -> Vec<Preset> {
        let all = |paths: &[PathBuf], place: PresetTransform| {
            paths.iter().map(|p| Preset { path: p.clone(), place: place.clone() }).collect::<Vec<_>>()
        };
        [all(&self.leave_out, PresetTransform::Excluded), all(&self.unmoved, PresetTransform::Unmoved)].concat()
    }

    /// Returns the choice of the reference frame. A number is the position of a photograph, unless a photograph has
    /// this number as its path.
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

impl Results {
    /// Returns the file for the report.
    pub fn report(&self) -> Option<&Path> {
        self.report.as_deref()
    }

    /// Returns the options of the library for these arguments and for `common`. All other library options have their
    /// defaults.
    pub fn options(&self, common: &Common) -> Options {
        Options {
            crop: self.cut.crop,
            transforms: common.transforms.clone(),
            report: self.report.clone(),
            ..common.aligned.options(&self.work)
        }
    }
}
