//! What belongs to the process and not to a command: its memory, the signals that interrupt it, panics, and files that an earlier run left behind.

pub(crate) mod allocator;
pub(crate) mod cgroup;
pub(crate) mod interrupt;
pub(crate) mod leftovers;
pub(crate) mod memory;
pub(crate) mod panics;
