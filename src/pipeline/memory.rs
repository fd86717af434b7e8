//! Brackets in memory: no file is read or written.
//!
//! In: a [`Bracket`] of frames from [`Frame::from_image`](crate::bracket::Frame::from_image) or
//! [`Frame::new`](crate::bracket::Frame::new). Out: an [`Outcome`]. Cost: the same as a run on files, but without
//! decoding and writing.

use super::stages::Run;
use super::threads::in_own_pool;
use super::{Options, Outcome, Watch, merge_loaded, validate};
use crate::bracket::{Bracket, LoadOptions};
use crate::error::{Error, Result};

/// Aligns, calibrates, merges and tone-maps `bracket`.
///
/// `options.load` and all options that name a file must have their defaults. The work is done on the caller's rayon
/// pool or, if [`threads`](Options::threads) is given, on a pool with that number of threads.
///
/// # Errors
/// [`Error::Option`] for options that are out of range or need files; [`Error::Cancelled`]; [`Error::NothingAligned`]
/// and [`Error::NoOverlap`] if the frames do not show one scene. A frame is named by its path, which need not exist.
pub fn merge_bracket(bracket: Bracket, options: &Options, watch: Watch) -> Result<Outcome> {
    in_own_pool(options.threads, || {
        refuse_files(options)?;
        validate(options)?;
        let (prepared, results) = merge_loaded(Run::new(options, watch), bracket, None, true)?;
        results.outcome(prepared)
    })
}

/// Rejects options that have no effect without files.
fn refuse_files(options: &Options) -> Result<()> {
    let given = [
        ("load", options.load != LoadOptions::default()),
        ("outputs", !options.outputs.is_empty()),
        ("pictures", !options.pictures.is_empty()),
        ("response_file", options.response_file.is_some()),
        ("save_response", options.save_response.is_some()),
        ("save_aligned", options.save_aligned.is_some()),
        ("displacements", options.displacements.is_some()),
        ("ghost_mask", options.ghost_mask.is_some()),
        ("transforms", options.transforms.is_some()),
        ("report", options.report.is_some()),
    ];
    match given.into_iter().find(|(_, is_given)| *is_given) {
        None => Ok(()),
        Some((option, _)) => {
            let reason =
                "it applies to photographs that are read from files; leave it at its default for a bracket in memory"
                    .to_owned();
            Err(Error::Option { option, reason })
        }
    }
}
