//! The operating system process of the program: memory, signals, panics, and temporary files of earlier runs.
//!
//! `memory` determines how much memory is free, and parses sizes. `cgroup` reads the limits of Linux control groups.
//! `allocator` makes the allocator return freed memory to the system. `interrupt` handles signals, and `panics`
//! handles panics. `leftovers` removes temporary files of killed runs.

pub(crate) mod allocator;
pub(crate) mod cgroup;
pub(crate) mod interrupt;
pub(crate) mod leftovers;
pub(crate) mod memory;
pub(crate) mod panics;
