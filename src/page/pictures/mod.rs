//! Pictures of the page, made while the frames are in memory.

pub(super) mod evidence;
pub(super) mod frames;
pub(super) mod overlays;
