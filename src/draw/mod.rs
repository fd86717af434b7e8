//! Drawing: the one layer that every picture of a report is made with.
//!
//! In: marks, numbers, text and pixels. Out: SVG, HTML text, PNG and JPEG files in memory. [`svg`] is a page with marks on it, [`plot`] axes
//! and what is measured along them, [`text`] the widths and outlines of letters, [`scale`] pictures in fewer pixels, [`image`] their
//! files, [`markup`] text and numbers made safe for XML and HTML. What is drawn is the business of [`inspect`](crate::inspect),
//! [`page`](crate::page) and [`compare`](crate::compare).

pub(crate) mod image;
pub(crate) mod markup;
pub(crate) mod plot;
pub(crate) mod scale;
pub(crate) mod svg;
pub(crate) mod text;
