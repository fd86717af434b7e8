//! Sheets: the drawings of an inspection (`edges`, `overlay` and `views` are for edges), and that of a response.
//!
//! In: the data of an [inspection](super). Out: [drawings](crate::draw::svg), and pictures for a page. Cost: some
//! tenths of a second per sheet.

pub(super) mod curves;
mod edges;
pub(crate) mod keypoints;
mod layout;
pub(super) mod matches;
pub(crate) mod overlay;
pub(super) mod photograph;
pub(crate) mod response;
pub(super) mod views;
