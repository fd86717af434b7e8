//! The commands of the program. Each is in the file with its name.
//!
//! In: parsed arguments. Out: an exit code. Each file contains the arguments and the help of its command, and a
//! function `run`. Except in `completions` and `man`, `run` converts the arguments to options of the library and calls
//! it. Arguments that several commands share are in `arguments`.

pub(crate) mod align;
pub(crate) mod batch;
pub(crate) mod compare;
pub(crate) mod completions;
pub(crate) mod inspect;
pub(crate) mod man;
pub(crate) mod merge;
pub(crate) mod response;
pub(crate) mod tonemap;
