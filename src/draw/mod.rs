//! Drawing: the one layer that every picture of a report is made with.
//!
//! In: marks, numbers, text and pixels. Out: SVG, HTML text, PNG and JPEG files in memory. [`svg`] is a page with marks on it, [`plot`] axes
//! and what is measured along them, [`text`] the widths and outlines of letters, [`scale`] pictures in fewer pixels, [`image`] their
//! files, [`markup`] text and numbers made safe for XML and HTML. What is drawn is the business of [`inspect`](crate::inspect),
//! [`page`](crate::page) and [`compare`](crate::compare).

pub mod image;
pub mod markup;
pub mod plot;
pub mod scale;
pub mod svg;
pub mod text;
