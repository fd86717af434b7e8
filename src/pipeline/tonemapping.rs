//! Tone mapping of an existing radiance map: read, tonemap, write, report.
//!
//! In: a radiance map in a file and [`TonemapOptions`]. Out: the requested files, and a [`TonemapReport`]. Cost: the
//! sum of the stages; the report has the time of each.

use super::threads::in_pool;
use super::{Stage, Watch, announce};
use crate::bracket::colour::Space;
use crate::budget;
use crate::error::{Error, Result};
use crate::limits::Limits;
use crate::merge::Photographed;
use crate::merge::radiance::gamut;
use crate::pipeline::stages::picture::{Each, Picture};
use crate::pipeline::stages::results::Results;
use crate::read;
use crate::report::WarningReport;
use crate::report::tonemapped::TonemapReport;
use crate::tonemap::Operator;
use crate::write::{self, Output, Target};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Tone mapping options, and the output files.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TonemapOptions {
    /// Tone mapping operator.
    pub operator: Operator,
    /// Linear colour space of written radiance; `None` for the colour space of the input file.
    pub colour: Option<Space>,
    /// Output files of pictures and, to convert the input, of radiance maps; the extension selects the format.
    pub outputs: Vec<PathBuf>,
    /// Output files that are always pictures, even with the extension `.tif`.
    pub pictures: Vec<PathBuf>,
    /// Encoding of the files, and whether existing files are replaced.
    pub write: write::Options,
    /// Largest number of threads; `None` for those of rayon's current thread pool (by default one per core). The
    /// results do not depend on it.
    pub threads: Option<usize>,
    /// Limits for reading the file.
    pub limits: Limits,
}

impl TonemapOptions {
    /// Returns the output files of radiance maps and pictures.
    fn results(&self) -> Result<Vec<Output>> {
        Ok([Output::results(&self.outputs)?, Output::pictures(&self.pictures)?].concat())
    }
}

/// Tone-maps the radiance map `input` and writes the requested files. If `merge` wrote the map as floats, the picture
/// has the same pixels as the picture that `merge` wrote beside the map. Its EXIF data contain only what the header of
/// the map contains.
///
/// # Errors
/// Those of [`read::read_within`] and of writing; [`Error::Option`] if the allowed memory is not enough. On an error
/// there are no new files.
pub fn tonemap_file(input: &Path, options: &TonemapOptions, watch: Watch) -> Result<TonemapReport> {
    in_pool(options.threads, || {
        options.operator.validate()?;
        options.write.check(&options.results()?)?;
        // If the input is a photograph `x.png`, the default name of the result is `x.png`, too. The error must be about
        // the input, not about this name.
        read::check(input)?;
        let targets = [Target::of("-o", &options.outputs), Target::of("--picture", &options.pictures)].concat();
        write::check_targets(&targets, &[input.to_owned()], options.write.overwrite)?;
        let began = Instant::now();
        announce(watch, Stage::Load)?;
        let contents = read::read_within(input, &options.limits)?;
        let size = (contents.map.pixels.width(), contents.map.pixels.height());
        let threads = budget::tonemapping(&options.limits, size, rayon::current_num_threads());
        let refused =
            |reason| Error::Option { option: "--max-memory", reason: format!("{}: {reason}", input.display()) };
        in_pool(Some(threads.map_err(refused)?), || tonemapped(input, contents, options, began, watch))
    })
}

/// Writes the files of `options` from the `contents` of the file `input`; `began` is the time at which reading began.
fn tonemapped(
    input: &Path,
    contents: read::Contents,
    options: &TonemapOptions,
    began: Instant,
    watch: Watch,
) -> Result<TonemapReport> {
    let mut warnings = contents.warnings(input);
    let read::Contents { map, metadata, .. } = contents;
    let (map, repaired) = read::repair(map);
    warnings.extend(repaired.warnings(input));
    let (map, outside) = match options.colour {
        Some(space) => gamut::converted(map, space),
        None => (map, 0),
    };
    warnings.extend(gamut::warning(outside));
    let mut report = TonemapReport::new(input, &map, &metadata);
    report.operator = options.operator.clone();
    report.adjust = options.write.picture.adjust;
    report.time_s.load = Some(began.elapsed().as_secs_f64());
    announce(watch, Stage::Tonemap)?;
    let since = Instant::now();
    let size = (map.pixels.width(), map.pixels.height());
    let photographed = Photographed::read(&metadata.comments);
    let each: Each = &|see| see(0, &map);
    let (shape, made) = ((size, map.primaries), &options.write.picture);
    let picture = Picture::toned(each, shape, photographed, &options.operator, made)?;
    report.white_balance = picture.light;
    warnings.extend(picture.warning(made));
    report.time_s.tonemap = Some(since.elapsed().as_secs_f64());
    announce(watch, Stage::Write)?;
    let since = Instant::now();
    // Headers name the program that writes the file: hdralign, even if another program wrote the input.
    let metadata = write::Metadata { software: write::Metadata::default().software, ..metadata };
    warnings.extend(options.write.picture.size.warning(size));
    let results = Results {
        outputs: options.results()?,
        options: &options.write,
        metadata,
        size,
        primaries: map.primaries,
        bright: report.radiance.p99_9,
    };
    let (files, mapping) = results.written(each, &picture, None)?;
    let mut pending = Vec::new();
    for written in files {
        warnings.extend(written.warnings);
        report.outputs.push(written.file.target().to_string_lossy().into_owned());
        pending.push(written.file);
    }
    write::commit(pending, options.write.overwrite)?;
    let mapping = mapping.as_secs_f64();
    report.time_s.tonemap = report.time_s.tonemap.map(|time| time + mapping);
    report.time_s.write = Some(since.elapsed().as_secs_f64() - mapping);
    report.time_s.total = began.elapsed().as_secs_f64();
    report.not_number_pixels = repaired.not_numbers;
    report.infinite_pixels = repaired.infinite;
    report.negative_pixels = repaired.negative;
    report.warnings = warnings.iter().map(WarningReport::from).collect();
    Ok(report)
}
