//! Arguments that several commands share, in groups that clap flattens into a command.
//!
//! In: values of the command line. Out: options of the library. `input` holds the arguments on frames, alignment,
//! output and resources, `recovery` those on the response, and `merging`, `radiance`, `picture`, `tone` and `adjust`
//! those on the later stages. `choice` parses the enums of the library.

pub(crate) mod adjust;
pub(crate) mod choice;
pub(crate) mod input;
pub(crate) mod merging;
pub(crate) mod picture;
pub(crate) mod radiance;
pub(crate) mod recovery;
pub(crate) mod tone;
