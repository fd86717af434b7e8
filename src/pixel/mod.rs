//! Pixel encodings shared by readers and writers: half floats, RGBE and LogLuv.
//!
//! In: linear RGB or XYZ as floats. Out: stored pixels, and back. Files, headers and compression are in
//! [`crate::write`] and [`crate::read`]. Cost and source: see each encoding.

pub(crate) mod half;
pub(crate) mod logluv;
pub(crate) mod rgbe;
