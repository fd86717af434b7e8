//! Markup: file names, pictures and figures as HTML.
//!
//! In: names and pictures. Out: HTML. Cost: none.

use crate::draw::image::Picture;
use crate::draw::markup;
pub(in crate::page) use crate::draw::markup::{escape, percent, signed};

/// The name of a file without its folder, escaped.
pub(in crate::page) fn file_name(path: &str) -> String {
    escape(&markup::file_name(path))
}

/// `picture` with words for those who do not see it, which are escaped here.
pub(in crate::page) fn img(picture: &Picture, alt: &str) -> String {
    let Picture { address, width, height } = picture;
    format!(r#"<img src="{address}" width="{width}" height="{height}" alt="{}" decoding="async">"#, escape(alt))
}

/// `picture` with what one sees of it; the caption is HTML.
pub(in crate::page) fn figure(picture: &Picture, alt: &str, caption: &str) -> String {
    format!("<figure>{}<figcaption>{caption}</figcaption></figure>\n", img(picture, alt))
}
