//! Markup: text made safe for HTML, and numbers as people read them.
//!
//! In: whatever files and cameras are called, and numbers. Out: HTML text. Cost: none. Source: the HTML standard
//! (WHATWG), section 13.1 (writing
//! documents): `&`, `<`, `>` and both quotes are all that means something in text and in quoted attributes.

use super::encoded::Picture;
pub(super) use crate::inspect::drawing::escape;
use std::path::Path;

/// The name of a file without its folder, escaped.
pub(super) fn file_name(path: &str) -> String {
    escape(&Path::new(path).file_name().map_or_else(|| path.into(), |n| n.to_string_lossy()))
}

/// `picture` with words for those who do not see it, which are escaped here.
pub(super) fn img(picture: &Picture, alt: &str) -> String {
    let Picture { address, width, height } = picture;
    format!(r#"<img src="{address}" width="{width}" height="{height}" alt="{}" decoding="async">"#, escape(alt))
}

/// `picture` with what one sees of it; the caption is HTML.
pub(super) fn figure(picture: &Picture, alt: &str, caption: &str) -> String {
    format!("<figure>{}<figcaption>{caption}</figcaption></figure>\n", img(picture, alt))
}

/// A number with its sign, a true minus, and so many decimals; what rounds to nothing has no sign.
pub(super) fn signed(v: f64, decimals: usize) -> String {
    let text = format!("{:.decimals$}", v.abs());
    if text.chars().all(|c| c == '0' || c == '.') {
        text
    } else if v < 0.0 {
        format!("\u{2212}{text}")
    } else {
        format!("+{text}")
    }
}

/// A share as percents: to a tenth where it is small.
pub(super) fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    match percent {
        p if p <= 0.0 => "0\u{a0}%".into(),
        p if p < 0.1 => "&lt;\u{a0}0.1\u{a0}%".into(),
        p if p < 10.0 => format!("{p:.1}\u{a0}%"),
        p => format!("{p:.0}\u{a0}%"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_gets_out_of_its_place() {
        let hostile = "<img src=x onerror=\"a('b')\">&\n\u{7}\u{202e}gpj";
        let safe = escape(hostile);
        assert_eq!(safe, "&lt;img src=x onerror=&quot;a(&#39;b&#39;)&quot;&gt;&amp; \u{fffd}\u{fffd}gpj");
        assert_eq!(file_name("a/b/<c>.jpg"), "&lt;c&gt;.jpg");
    }

    #[test]
    fn numbers_are_as_people_read_them() {
        assert_eq!([1.5, -0.25, -0.001].map(|v| signed(v, 2)), ["+1.50", "\u{2212}0.25", "0.00"]);
        let percents = [0.0, 0.0001, 0.034, 0.5].map(percent);
        assert_eq!(percents, ["0\u{a0}%", "&lt;\u{a0}0.1\u{a0}%", "3.4\u{a0}%", "50\u{a0}%"]);
    }
}
