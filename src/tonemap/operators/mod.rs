//! The published operators, one file for each, named after its first author; `reinhard` contains `reinhard02` and
//! `reinhard02-local`.
//!
//! In: a scene. Out: tones. The operators do not depend on each other.

pub mod drago;
pub mod durand;
pub mod fattal;
pub mod mantiuk06;
pub mod mantiuk08;
pub mod reinhard;
