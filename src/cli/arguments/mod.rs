//! The arguments that several commands share, as groups of the help.

pub(crate) mod adjust;
pub(crate) mod choice;
pub(crate) mod input;
pub(crate) mod merging;
pub(crate) mod picture;
pub(crate) mod radiance;
pub(crate) mod recovery;
pub(crate) mod tone;
