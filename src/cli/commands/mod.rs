//! Commands of the program, each in the file of its name.
//!
//! In: parsed arguments. Out: an exit code. Each file holds the arguments and help of its command, and `run`, which
//! turns them into options of the library. Arguments that several commands share are in `arguments`.

pub(crate) mod align;
pub(crate) mod batch;
pub(crate) mod compare;
pub(crate) mod completions;
pub(crate) mod inspect;
pub(crate) mod man;
pub(crate) mod merge;
pub(crate) mod response;
pub(crate) mod tonemap;
