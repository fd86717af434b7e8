//! The process of the program: memory, signals, panics and files that an earlier run left behind.
//!
//! `memory` reads how much memory is free and parses sizes; `cgroup` has the limits of control groups, `allocator` returns freed memory to the
//! system. `interrupt` handles signals, `panics` panics of the program, `leftovers` temporary files of killed runs.

pub(crate) mod allocator;
pub(crate) mod cgroup;
pub(crate) mod interrupt;
pub(crate) mod leftovers;
pub(crate) mod memory;
pub(crate) mod panics;
