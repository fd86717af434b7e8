//! hdralign
pub mod align;
pub mod bracket;
pub mod error;
pub mod merge;
pub mod plane;
pub mod pyramid;
pub mod response;
pub mod tonemap;
pub mod write;
