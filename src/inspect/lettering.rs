//! Lettering: text as strokes, so that a drawing looks the same in every viewer and needs no font.
//!
//! In: text. Out: for each character a path and how far it goes on. Cost: a search in a table of some ninety glyphs. The glyphs were drawn
//! for this program, after the proportions of technical lettering: capitals from 0 down to the base line at 14, small letters from 5,
//! descenders to 18; round pens, [`PEN`] wide.

/// Units of the glyphs in the size of a text.
const EM: f64 = 20.0;
/// The base line, below the top of the capitals, in units.
pub(super) const BASE: f64 = 14.0;
/// Width of the pen, in units.
pub(super) const PEN: f64 = 1.5;
/// Room on either side of a glyph, in units.
const BEARING: f64 = 1.7;
/// What a space goes on, in units.
const SPACE: f64 = 6.5;

/// A glyph: its width in units and its path.
type Glyph = (f64, &'static str);

/// What stands for a character that is not in the table: an empty box.
const UNKNOWN: Glyph = (7.0, "M0 0H7V14H0Z");

/// Pixels in a unit of a text of `size` pixels.
pub(super) fn unit(size: f64) -> f64 {
    size / EM
}

/// Width of `text` at `size` pixels, in pixels.
pub(crate) fn width(text: &str, size: f64) -> f64 {
    text.chars().map(advance).sum::<f64>() * unit(size)
}

/// The glyphs of `text` at `size` pixels: how far each is from the beginning, in pixels, and its path in units.
pub(super) fn set(text: &str, size: f64) -> Vec<(f64, &'static str)> {
    let mut at = 0.0;
    let mut placed = Vec::new();
    for c in text.chars() {
        if c != ' ' {
            placed.push(((at + BEARING) * unit(size), glyph(c).1));
        }
        at += advance(c);
    }
    placed
}

/// `text` in lines no wider than `most` pixels, broken at spaces; a word that is wider by itself loses its end to dots.
pub(super) fn wrap(text: &str, size: f64, most: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        let word = shorten(word, size, most);
        match lines.last_mut() {
            Some(line) if width(&format!("{line} {word}"), size) <= most => {
                line.push(' ');
                line.push_str(&word);
            }
            _ => lines.push(word),
        }
    }
    lines
}

/// `text`, its end replaced by dots where it is wider than `most` pixels.
pub(crate) fn shorten(text: &str, size: f64, most: f64) -> String {
    if width(text, size) <= most {
        return text.to_owned();
    }
    let mut short: String = text.to_owned();
    while !short.is_empty() && width(&format!("{short}..."), size) > most {
        short.pop();
    }
    short + "..."
}

fn advance(c: char) -> f64 {
    if c == ' ' { SPACE } else { glyph(c).0 + 2.0 * BEARING }
}

#[rustfmt::skip]
fn glyph(c: char) -> Glyph {
    match c {
        '0' => (8.0, "M4 0C1.2 0 0 3 0 7S1.2 14 4 14 8 11 8 7 6.8 0 4 0Z"),
        '1' => (8.0, "M1.6 3L5 0V14"),
        '2' => (8.0, "M.5 3.6C.5 1.5 2 0 4 0S7.6 1.5 7.6 3.7C7.6 6.6 4 9 .2 14H8"),
        '3' => (8.0, "M.6 2.4C1.2 .9 2.4 0 4 0 6.1 0 7.5 1.3 7.5 3.3S6 6.6 3.2 6.6C6.2 6.6 8 8 8 10.3S6.3 14 4 14C2.1 14 .7 13.1 0 11.5"),
        '4' => (8.0, "M6 14V0L0 9.8H8"),
        '5' => (8.0, "M7.2 0H1.4L.8 6.2C1.6 5.4 2.7 5 3.9 5 6.3 5 8 6.8 8 9.4S6.3 14 3.9 14C2.1 14 .7 13.2 0 11.7"),
        '6' => (8.0, "M7.2 1.6C6.6 .6 5.6 0 4.5 0 1.6 0 0 3 0 8.6V9.5C0 12.2 1.7 14 4 14S8 12.2 8 9.6 6.3 5.3 4 5.3 0 7 0 9.5"),
        '7' => (8.0, "M0 0H8L3 14"),
        '8' => (8.0, "M4 6.5C2 6.5 .6 5.2 .6 3.2S2 0 4 0 7.4 1.2 7.4 3.2 6 6.5 4 6.5C1.7 6.5 0 8 0 10.2S1.7 14 4 14 8 12.5 8 10.2 6.3 6.5 4 6.5Z"),
        '9' => (8.0, "M.8 12.4C1.4 13.4 2.4 14 3.5 14 6.4 14 8 11 8 5.4V4.5C8 1.8 6.3 0 4 0S0 1.8 0 4.4 1.7 8.7 4 8.7 8 7 8 4.5"),
        'A' => (10.0, "M0 14L5 0 10 14M1.8 9.3H8.2"),
        'B' => (8.5, "M0 6.5H4.3C6.5 6.5 7.8 5.2 7.8 3.2S6.5 0 4.3 0H0V14H4.8C7.1 14 8.5 12.4 8.5 10.2S7.1 6.5 4.8 6.5H4"),
        'C' => (10.0, "M10 3C9 1.1 7.4 0 5.4 0 2.2 0 0 2.8 0 7S2.2 14 5.4 14C7.4 14 9 12.9 10 11"),
        'D' => (9.5, "M0 0H3.8C7.4 0 9.5 2.6 9.5 7S7.4 14 3.8 14H0Z"),
        'E' => (7.5, "M7.5 0H0V14H7.5M0 6.6H6.4"),
        'F' => (7.2, "M7.2 0H0V14M0 6.8H6.2"),
        'G' => (10.3, "M10 3C9 1.1 7.4 0 5.4 0 2.2 0 0 2.8 0 7S2.2 14 5.4 14C8.3 14 10.3 12.2 10.3 9.2V7.4H6"),
        'H' => (9.5, "M0 0V14M9.5 0V14M0 6.7H9.5"),
        'I' => (0.0, "M0 0V14"),
        'J' => (6.0, "M6 0V9.8C6 12.5 4.8 14 2.9 14 1.4 14 .4 13.2 0 11.8"),
        'K' => (9.0, "M0 0V14M8.6 0L0 8.8M3 5.8L9 14"),
        'L' => (7.0, "M0 0V14H7"),
        'M' => (11.0, "M0 14V0L5.5 9.5 11 0V14"),
        'N' => (9.5, "M0 14V0L9.5 14V0"),
        'O' => (11.0, "M5.5 0C2.2 0 0 2.8 0 7S2.2 14 5.5 14 11 11.2 11 7 8.8 0 5.5 0Z"),
        'P' => (8.2, "M0 14V0H4.4C6.8 0 8.2 1.5 8.2 3.9S6.8 7.8 4.4 7.8H0"),
        'Q' => (11.0, "M5.5 0C2.2 0 0 2.8 0 7S2.2 14 5.5 14 11 11.2 11 7 8.8 0 5.5 0ZM6.8 10.6L10.6 14.8"),
        'R' => (8.8, "M0 14V0H4.4C6.8 0 8.2 1.5 8.2 3.8S6.8 7.5 4.4 7.5H0M4.6 7.5L8.8 14"),
        'S' => (8.4, "M7.8 2.8C7.2 1 5.9 0 4.2 0 2 0 .5 1.3 .5 3.4S1.9 6.2 4.2 6.8C6.8 7.4 8.4 8.3 8.4 10.4S6.7 14 4.3 14C2.1 14 .6 12.9 0 11"),
        'T' => (9.0, "M0 0H9M4.5 0V14"),
        'U' => (9.4, "M0 0V8.8C0 12 1.8 14 4.7 14S9.4 12 9.4 8.8V0"),
        'V' => (10.0, "M0 0L5 14 10 0"),
        'W' => (14.0, "M0 0L3.5 14 7 1 10.5 14 14 0"),
        'X' => (9.4, "M0 0L9.4 14M9.4 0L0 14"),
        'Y' => (9.4, "M0 0L4.7 7.2 9.4 0M4.7 7.2V14"),
        'Z' => (9.0, "M.3 0H8.7L0 14H9"),
        'a' => (6.8, "M.6 6.7C1.2 5.6 2.3 5 3.6 5 5.6 5 6.8 6.1 6.8 8.2V14M6.8 9H3.6C1.4 9 0 9.9 0 11.5S1.2 14 3 14C5.2 14 6.8 12.7 6.8 10.6"),
        'b' => (7.4, "M0 0V14M0 9.5C0 6.8 1.6 5 3.8 5S7.4 6.8 7.4 9.5 5.9 14 3.8 14 0 12.2 0 9.5"),
        'c' => (6.6, "M6.6 6.9C5.9 5.7 4.9 5 3.7 5 1.5 5 0 6.8 0 9.5S1.5 14 3.7 14C4.9 14 5.9 13.3 6.6 12.1"),
        'd' => (7.4, "M7.4 0V14M7.4 9.5C7.4 6.8 5.8 5 3.6 5S0 6.8 0 9.5 1.5 14 3.6 14 7.4 12.2 7.4 9.5"),
        'e' => (7.4, "M.1 9.3H7.4C7.4 6.7 6 5 3.8 5S0 6.8 0 9.5 1.5 14 3.8 14C5.2 14 6.3 13.4 7 12.2"),
        'f' => (4.6, "M4.8 .2C4.4 0 4 0 3.6 0 2.1 0 1.4 1 1.4 2.8V14M0 5H4.2"),
        'g' => (7.4, "M7.4 9.5C7.4 6.8 5.8 5 3.6 5S0 6.8 0 9.5 1.5 14 3.6 14 7.4 12.2 7.4 9.5M7.4 5V14.4C7.4 16.8 6 18.2 3.8 18.2 2.3 18.2 1.1 17.6 .4 16.5"),
        'h' => (7.0, "M0 0V14M0 9C0 6.6 1.5 5 3.6 5S7 6.4 7 9V14"),
        'i' => (0.0, "M0 5V14M0 1.1V1.2"),
        'j' => (1.6, "M1.6 5V15.6C1.6 17.4 .9 18.2 -.6 18.2M1.6 1.1V1.2"),
        'k' => (6.8, "M0 0V14M6.2 5L0 10.4M2.4 8.4L6.8 14"),
        'l' => (0.6, "M0 0V12.4C0 13.6 .4 14 1.2 14"),
        'm' => (11.4, "M0 5V14M0 8.6C0 6.4 1.2 5 3 5S5.7 6.2 5.7 8.6V14M5.7 8.6C5.7 6.4 6.9 5 8.7 5S11.4 6.2 11.4 8.6V14"),
        'n' => (7.0, "M0 5V14M0 9C0 6.6 1.5 5 3.6 5S7 6.4 7 9V14"),
        'o' => (7.6, "M3.8 5C1.5 5 0 6.8 0 9.5S1.5 14 3.8 14 7.6 12.2 7.6 9.5 6.1 5 3.8 5Z"),
        'p' => (7.4, "M0 5V18M0 9.5C0 6.8 1.6 5 3.8 5S7.4 6.8 7.4 9.5 5.9 14 3.8 14 0 12.2 0 9.5"),
        'q' => (7.4, "M7.4 5V18M7.4 9.5C7.4 6.8 5.8 5 3.6 5S0 6.8 0 9.5 1.5 14 3.6 14 7.4 12.2 7.4 9.5"),
        'r' => (4.4, "M0 5V14M0 9.2C0 6.6 1.4 5 3.4 5 3.8 5 4.1 5.1 4.4 5.2"),
        's' => (6.0, "M5.6 6.8C5 5.6 4.2 5 3 5 1.4 5 .3 5.9 .3 7.2S1.3 9 3 9.3C4.9 9.7 6 10.2 6 11.6S4.8 14 3.1 14C1.6 14 .5 13.3 0 12.1"),
        't' => (4.6, "M1.5 1.6V11.6C1.5 13.3 2.2 14 3.6 14 4 14 4.3 14 4.6 13.8M0 5H4.4"),
        'u' => (7.0, "M0 5V10C0 12.6 1.3 14 3.4 14S7 12.4 7 10M7 5V14"),
        'v' => (7.4, "M0 5L3.7 14 7.4 5"),
        'w' => (11.0, "M0 5L2.8 14 5.5 5.4 8.2 14 11 5"),
        'x' => (7.0, "M0 5L7 14M7 5L0 14"),
        'y' => (7.4, "M0 5L3.8 14M7.4 5L3.2 15.6C2.6 17.3 1.9 18.2 .4 18.1"),
        'z' => (6.6, "M.2 5H6.4L0 14H6.6"),
        '.' => (0.2, "M.1 13.8V14"),
        ',' => (0.6, "M.6 13.4L-.2 16.4"),
        ':' => (0.2, "M.1 6V6.2M.1 13.8V14"),
        ';' => (0.6, "M.6 6V6.2M.6 13.4L-.2 16.4"),
        '-' => (5.0, "M0 9H5"),
        '+' => (8.0, "M0 8H8M4 4V12"),
        '=' => (8.0, "M0 6.2H8M0 9.8H8"),
        '<' => (8.0, "M8 3.6L0 8 8 12.4"),
        '>' => (8.0, "M0 3.6L8 8 0 12.4"),
        '/' => (6.0, "M0 16L6 -1"),
        '\\' => (6.0, "M0 -1L6 16"),
        '|' => (0.0, "M0 -1V17"),
        '(' => (3.0, "M3 -1C1 1 0 4 0 7.5S1 14 3 16"),
        ')' => (3.0, "M0 -1C2 1 3 4 3 7.5S2 14 0 16"),
        '[' => (3.0, "M3 -1H0V16H3"),
        ']' => (3.0, "M0 -1H3V16H0"),
        '%' => (11.6, "M2.3 0C.9 0 0 1.2 0 3.2S.9 6.4 2.3 6.4 4.6 5.2 4.6 3.2 3.7 0 2.3 0ZM9.6 0L2 14M9.3 7.6C7.9 7.6 7 8.8 7 10.8S7.9 14 9.3 14 11.6 12.8 11.6 10.8 10.7 7.6 9.3 7.6Z"),
        '_' => (8.0, "M0 16H8"),
        '\'' => (0.0, "M0 0V3.4"),
        '"' => (3.0, "M0 0V3.4M3 0V3.4"),
        '!' => (0.2, "M.1 0V9.6M.1 13.8V14"),
        '?' => (6.6, "M0 3C.4 1.1 1.6 0 3.3 0 5.3 0 6.6 1.2 6.6 3.1 6.6 6 3.2 6.4 3.2 9.8M3.2 13.8V14"),
        '#' => (9.0, "M3.4 0L1.8 14M7.4 0L5.8 14M.8 4.6H9M0 9.4H8.2"),
        '~' => (8.0, "M0 9C1 7.2 2.4 7 4 8S7 8.8 8 7"),
        '°' => (3.6, "M1.8 0C.7 0 0 .8 0 1.8S.7 3.6 1.8 3.6 3.6 2.8 3.6 1.8 2.9 0 1.8 0Z"),
        '×' => (6.0, "M0 5L6 11M6 5L0 11"),
        _ => UNKNOWN,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_of_one_width_and_text_is_the_sum_of_its_parts() {
        assert!(('0'..='9').all(|c| glyph(c).0 == 8.0));
        let whole = width("f/8, ISO 100", 17.0);
        let parts: f64 = ["f/8,", " ", "ISO", " ", "100"].iter().map(|t| width(t, 17.0)).sum();
        assert!((whole - parts).abs() < 1e-9);
        assert_eq!(set("a b", 20.0).len(), 2);
        assert!(set("ab", 20.0)[1].0 > width("a", 20.0));
    }

    #[test]
    fn every_glyph_is_a_path_and_only_strangers_are_boxes() {
        for c in (' '..='~').filter(|c| !"$&*@^`{}\u{20}".contains(*c)) {
            let (w, path) = glyph(c);
            assert!(path.starts_with('M') && (0.0..=14.0).contains(&w), "{c}");
            assert_ne!(path, UNKNOWN.1, "{c}");
        }
        assert_eq!(glyph('窓'), UNKNOWN);
    }

    #[test]
    fn lines_keep_within_their_width_and_lose_no_word() {
        let text = "pixels that count in neither bitmap are left out of the share";
        let lines = wrap(text, 16.0, 200.0);
        assert!(lines.len() > 1 && lines.iter().all(|l| width(l, 16.0) <= 200.0));
        assert_eq!(lines.join(" "), text);
        let short = shorten("a-very-long-name-of-a-photograph.jpg", 16.0, 120.0);
        assert!(short.ends_with("...") && width(&short, 16.0) <= 120.0);
    }
}
