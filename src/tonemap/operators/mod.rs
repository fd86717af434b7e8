//! The published operators, each in the file of its first author.
//!
//! In: a scene, or its overview. Out: tones. None uses another.

pub mod drago;
pub mod durand;
pub mod fattal;
pub mod mantiuk06;
pub mod mantiuk08;
pub mod reinhard;
