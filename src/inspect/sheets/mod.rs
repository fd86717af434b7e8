//! Sheets: everything that is drawn of a bracket, each kind in the file of its name.
//!
//! In: what an [inspection](super) found. Out: [drawings](crate::draw::svg), and pictures for a page. Cost: some tenths of a second a sheet.

pub(super) mod curves;
mod edges;
pub(crate) mod keypoints;
mod layout;
pub(super) mod matches;
pub(crate) mod overlay;
pub(super) mod photograph;
pub(crate) mod response;
pub(super) mod views;
