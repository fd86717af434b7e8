//! The files of a run: its inputs and outputs, checked before any work.
//!
//! In: the photographs and [`Options`]. Out: the output files; the options with transforms read from a file. Cost:
//! system calls for each name, and reading the file of transforms.

pub(crate) mod curves;
pub(crate) mod names;

use super::{Options, validate};
use crate::align::transforms_file::SavedAlignment;
use crate::bracket::ReferenceChoice;
use crate::error::Result;
use crate::report;
use crate::response::file;
use crate::write::{self, Target, aligned, displacements};
use std::path::PathBuf;

/// Whether the file of transforms exists, so that it is read and not written.
fn takes_transforms(options: &Options) -> bool {
    options.transforms.as_ref().is_some_and(|path| path.exists())
}

/// Returns every file that a run on `images` writes.
///
/// # Errors
/// [`Error::Option`](crate::error::Error::Option) if two aligned frames would have the same name.
pub fn targets(images: &[PathBuf], options: &Options) -> Result<Vec<Target>> {
    let mut files = Target::of("-o", &options.outputs);
    files.extend(Target::of("--picture", &options.pictures));
    files.extend(Target::of("--save-response", options.save_response.as_slice()));
    files.extend(Target::of("--report", options.report.as_slice()));
    files.extend(Target::of("--ghost-mask", options.ghost_mask.as_slice()));
    if !takes_transforms(options) {
        files.extend(Target::of("--transforms", options.transforms.as_slice()));
    }
    if let Some(prefix) = &options.save_aligned {
        files.extend(Target::of("--save-aligned", &aligned::names("--save-aligned", prefix, images)?));
    }
    if let Some(prefix) = &options.displacements {
        files.extend(Target::of("--displacements", &displacements::names(prefix, images)?));
    }
    Ok(files)
}

/// Returns every file that a run on `images` reads.
fn sources(images: &[PathBuf], options: &Options) -> Vec<PathBuf> {
    let transforms = options.transforms.iter().filter(|_| takes_transforms(options));
    images.iter().chain(&options.response_file).chain(transforms).cloned().collect()
}

/// Checks all options, and that all files can be written.
pub(super) fn check(images: &[PathBuf], options: &Options) -> Result<()> {
    validate(options)?;
    options.write.check(&options.results()?)?;
    for path in [&options.response_file, &options.save_response].into_iter().flatten() {
        file::Format::of(path)?;
    }
    if let Some(path) = &options.report {
        report::Format::of(path)?;
    }
    write::png::mask::check(options.ghost_mask.as_deref(), options.deghost.is_on())?;
    write::check_targets(&targets(images, options)?, &sources(images, options), options.write.overwrite)
}

/// Returns `options` and, if the file of transforms exists, its path and content.
///
/// If the file exists, the returned options contain its transforms and, unless the user has chosen a reference, its
/// reference. They no longer name the file, so that the run does not write it.
pub(super) fn with_transforms(
    images: &[PathBuf],
    options: &Options,
) -> Result<(Options, Option<(PathBuf, SavedAlignment)>)> {
    let mut options = options.clone();
    let Some(path) = options.transforms.take_if(|path| path.exists()) else {
        return Ok((options, None));
    };
    let saved = SavedAlignment::read(&path)?;
    saved.check_names(images, &path)?;
    let is_open = match &options.load.reference {
        ReferenceChoice::Auto => true,
        ReferenceChoice::AutoExcept(left_out) => !left_out.contains(&saved.reference),
        ReferenceChoice::Number(_) | ReferenceChoice::File(_) => false,
    };
    if is_open {
        options.load.reference = ReferenceChoice::File(saved.reference.clone());
    }
    options.align.given.extend(saved.frames.iter().cloned());
    Ok((options, Some((path, saved))))
}
