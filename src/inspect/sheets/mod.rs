//! Sheets: the drawings of an inspection, and the drawing of a response. `edges`, `overlay` and `views` draw edges.
//!
//! In: the data of an [inspection](super). Out: [drawings](crate::draw::svg), and pictures for the HTML report. Cost:
//! some tenths of a second per sheet.

pub(super) mod curves;
mod edges;
pub(crate) mod keypoints;
mod layout;
pub(super) mod matches;
pub(crate) mod overlay;
pub(super) mod photograph;
pub(crate) mod response;
pub(super) mod views;
