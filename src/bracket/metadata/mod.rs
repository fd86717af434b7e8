//! Metadata of a frame other than its exposure.
//!
//! In: EXIF. Out: camera, lens and settings (`capture`), the time of the photograph (`moment`), and the fields that are
//! copied to results (`carried`). The exposure is read in [`exposure`](super::exposure).

pub(crate) mod capture;
pub(crate) mod carried;
pub(crate) mod moment;
