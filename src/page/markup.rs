//! HTML of file names, pictures and figures.
//!
//! In: names and pictures. Out: HTML. Cost: none.

use crate::draw::image::Picture;
use crate::draw::markup;
pub(in crate::page) use crate::draw::markup::{escape, percent, signed};

/// Returns the name of a file without its folder, escaped.
pub(in crate::page) fn file_name(path: &str) -> String {
    escape(&markup::file_name(path))
}

/// Returns `picture` with the alternative text `alt`, which is escaped here.
pub(in crate::page) fn img(picture: &Picture, alt: &str) -> String {
    let Picture { address, width, height } = picture;
    format!(r#"<img src="{address}" width="{width}" height="{height}" alt="{}" decoding="async">"#, escape(alt))
}

/// Returns `picture` as a figure; `alt` is escaped, `caption` is HTML.
pub(in crate::page) fn figure(picture: &Picture, alt: &str, caption: &str) -> String {
    format!("<figure>{}<figcaption>{caption}</figcaption></figure>\n", img(picture, alt))
}
