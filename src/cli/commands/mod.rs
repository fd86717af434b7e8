//! The commands, each in a file of its name: its arguments, and the call of the library that they stand for.

pub(crate) mod align;
pub(crate) mod batch;
pub(crate) mod compare;
pub(crate) mod completions;
pub(crate) mod inspect;
pub(crate) mod man;
pub(crate) mod merge;
pub(crate) mod response;
pub(crate) mod tonemap;
