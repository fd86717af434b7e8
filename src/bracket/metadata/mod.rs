//! Metadata of a frame other than its exposure.
//!
//! In: EXIF. Out: camera, lens and settings (`capture`), the time it was taken (`moment`), and the fields that results carry (`carried`). Exposure
//! is read in [`exposure`](super::exposure).

pub(crate) mod capture;
pub(crate) mod carried;
pub(crate) mod moment;
