//! Arguments that several commands share, in groups that clap flattens into a command.
//!
//! In: values of the command line. Out: options of the library. `input` has frames, alignment, output and resources; `recovery` the response;
//! `merging`, `radiance`, `picture`, `tone` and `adjust` the stages after it; `choice` parses the library's enums.

pub(crate) mod adjust;
pub(crate) mod choice;
pub(crate) mod input;
pub(crate) mod merging;
pub(crate) mod picture;
pub(crate) mod radiance;
pub(crate) mod recovery;
pub(crate) mod tone;
