//! Pictures of the page, gathered while the frames are there.

pub(super) mod evidence;
pub(super) mod frames;
pub(super) mod overlays;
