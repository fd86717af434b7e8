//! Markup: text and numbers escaped for XML and HTML, and number formats.
//!
//! In: names of files and cameras, and numbers. Out: text for XML and HTML. Cost: negligible. Source: XML 1.0 (W3C),
//! section 2.2 (characters); the HTML standard (WHATWG), section 13.1 (writing documents): only `&`, `<`, `>` and
//! both quotes have a meaning in text and in quoted attributes.

use std::path::Path;

/// Returns a number rounded to hundredths, without trailing zeros.
pub fn number(v: f64) -> String {
    let text = format!("{v:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

/// Escapes text for use between tags and in quoted attributes of XML and HTML. Characters that XML 1.0 forbids, some
/// invisible ones (the soft hyphen, the zero-width space, U+2060 to U+206F, U+FEFF), and those that change the
/// direction of the text become the replacement character.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\t' | '\n' | '\r' => out.push(' '),
            '\u{ad}'
            | '\u{61c}'
            | '\u{200b}'
            | '\u{200e}'..='\u{200f}'
            | '\u{202a}'..='\u{202e}'
            | '\u{2060}'..='\u{206f}'
            | '\u{feff}'
            | '\u{fffe}'
            | '\u{ffff}' => out.push('\u{fffd}'),
            c if c.is_control() => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// Returns the name of a file without its folder.
pub fn file_name(path: &str) -> String {
    Path::new(path).file_name().map_or_else(|| path.to_owned(), |name| name.to_string_lossy().into_owned())
}

/// Returns a number with its sign (a minus sign, not a hyphen) and with `decimals` decimals. Numbers that are rounded
/// to zero have no sign.
pub fn signed(v: f64, decimals: usize) -> String {
    let text = format!("{:.decimals$}", v.abs());
    if text.chars().all(|c| c == '0' || c == '.') {
        text
    } else if v < 0.0 {
        format!("\u{2212}{text}")
    } else {
        format!("+{text}")
    }
}

/// Returns a fraction as a percentage, with one decimal below 10 %.
pub fn percent(share: f64) -> String {
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
    fn texts_are_escaped_and_file_names_have_no_folder() {
        let hostile = "<img src=x onerror=\"a('b')\">&\n\u{7}\u{202e}\u{200b}\u{feff}gpj";
        let safe = escape(hostile);
        assert_eq!(
            safe,
            "&lt;img src=x onerror=&quot;a(&#39;b&#39;)&quot;&gt;&amp; \u{fffd}\u{fffd}\u{fffd}\u{fffd}gpj"
        );
        assert_eq!(file_name("a/b/<c>.jpg"), "<c>.jpg");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!([1.0, -0.001, 2.504, 1e4].map(number), ["1", "0", "2.5", "10000"]);
    }

    #[test]
    fn numbers_are_as_people_read_them() {
        assert_eq!([1.5, -0.25, -0.001].map(|v| signed(v, 2)), ["+1.50", "\u{2212}0.25", "0.00"]);
        let percents = [0.0, 0.0001, 0.034, 0.5].map(percent);
        assert_eq!(percents, ["0\u{a0}%", "&lt;\u{a0}0.1\u{a0}%", "3.4\u{a0}%", "50\u{a0}%"]);
    }
}
