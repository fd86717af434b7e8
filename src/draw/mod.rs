//! Drawing: this module makes every picture of a report.
//!
//! In: marks, numbers, text and pixels. Out: SVG, HTML text, PNG and JPEG files in memory. [`svg`] draws pages of
//! marks, [`plot`] draws axes and curves, [`text`] measures and outlines letters, [`scale`] reduces pictures, [`image`]
//! encodes pictures, and [`markup`] escapes text. [`inspect`](crate::inspect), [`page`](crate::page) and
//! [`compare`](crate::compare) decide what is drawn.

pub(crate) mod image;
pub(crate) mod markup;
pub(crate) mod plot;
pub(crate) mod scale;
pub(crate) mod svg;
pub(crate) mod text;
