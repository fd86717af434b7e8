//! The published operators, one file for each first author.
//!
//! In: a scene. Out: tones. The operators do not depend on each other.

pub mod drago;
pub mod durand;
pub mod fattal;
pub mod mantiuk06;
pub mod mantiuk08;
pub mod reinhard;
