//! Text: the widths and outlines of letters, for layout and for drawings in pixels.
//!
//! In: text and its size in pixels. Out: widths, lines, and SVG path data. Cost: about 0.2 us per letter. Source: the
//! font beside this file, DejaVu Sans Condensed 2.37 with its Latin, Greek and Cyrillic letters (`font/README.md`).
//! No other font is used, so that a drawing has the same pixels on every machine. In drawings in pixels, letters of
//! other scripts are boxes. SVG files contain the text itself, so there the viewer draws all letters.

use std::fmt::Write;
use std::sync::LazyLock;
use ttf_parser::{Face, OutlineBuilder};

static FACE: LazyLock<Option<Face<'static>>> =
    LazyLock::new(|| Face::parse(include_bytes!("font/DejaVuSansCondensed.ttf"), 0).ok());

/// Number of font units per em. An em is the size of the text.
const EM: f64 = 2048.0;

/// Returns the width of a letter in units of the font. A letter that is not in the font has the width of a box.
fn advance(face: &Face, c: char) -> u32 {
    face.glyph_hor_advance(face.glyph_index(c).unwrap_or_default()).unwrap_or_default().into()
}

/// Returns the width of `text` at `size` pixels, in pixels.
pub fn width(text: &str, size: f64) -> f64 {
    let units: u32 = FACE.iter().flat_map(|face| text.chars().map(|c| advance(face, c))).sum();
    f64::from(units) * size / EM
}

/// Returns the outlines of `text` as SVG path data in units of the font, and the number of pixels per unit at `size`.
/// The origin is at the start of the text on its base line; x is to the right, y is down.
pub(super) fn outlines(text: &str, size: f64) -> (String, f64) {
    let mut outline = Outline::default();
    for (face, c) in FACE.iter().flat_map(|face| text.chars().map(move |c| (face, c))) {
        face.outline_glyph(face.glyph_index(c).unwrap_or_default(), &mut outline);
        outline.left += advance(face, c) as f32;
    }
    (outline.path, size / EM)
}

#[derive(Default)]
struct Outline {
    path: String,
    /// Left edge of the next letter, in units of the font.
    left: f32,
}

impl Outline {
    fn put(&mut self, command: char, points: &[(f32, f32)]) {
        self.path.push(command);
        for (x, y) in points {
            // A subtraction from 0 instead of a negation, because `-y` would print 0 as -0.
            let _ = write!(self.path, "{} {} ", self.left + x, 0.0 - y);
        }
    }
}

impl OutlineBuilder for Outline {
    fn move_to(&mut self, x: f32, y: f32) {
        self.put('M', &[(x, y)]);
    }

    fn line_to(&mut self, x: f32, y: f32) {
        self.put('L', &[(x, y)]);
    }

    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        self.put('Q', &[(x1, y1), (x, y)]);
    }

    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        self.put('C', &[(x1, y1), (x2, y2), (x, y)]);
    }

    fn close(&mut self) {
        self.put('Z', &[]);
    }
}

/// Returns `text` in lines of at most `most` pixels, broken at spaces; words that are longer than a line are shortened.
pub fn wrap(text: &str, size: f64, most: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ') {
        let word = shorten(word, size, most);
        match lines.last_mut() {
            Some(line) if width(&format!("{line} {word}"), size) <= most => *line += &format!(" {word}"),
            _ => lines.push(word),
        }
    }
    lines
}

/// Returns `text`, with dots instead of its end if it is wider than `most` pixels.
pub fn shorten(text: &str, size: f64, most: f64) -> String {
    if width(text, size) <= most {
        return text.to_owned();
    }
    let mut short = text.to_owned();
    while short.pop().is_some() && width(&short, size) + width("...", size) > most {}
    short + "..."
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn font_has_latin_greek_and_cyrillic_letters_of_their_own_widths() {
        let face = FACE.as_ref().unwrap();
        assert_eq!(f64::from(face.units_per_em()), EM);
        assert!((' '..='~').chain("éßŁőşπЖ°×−µ".chars()).all(|c| face.glyph_index(c).is_some()));
        assert_eq!(face.glyph_index('窓'), None);
        // All digits have the same width, 1172 units in the font.
        assert!(('0'..='9').all(|c| advance(face, c) == 1172));
        assert!((width("f/8", 17.0) - ["f", "/", "8"].map(|t| width(t, 17.0)).iter().sum::<f64>()).abs() < 1e-9);
    }

    #[test]
    fn outlines_follow_each_other() {
        let (one, unit) = outlines("I", 2048.0);
        let (two, _) = outlines("II", 2048.0);
        assert!(one.starts_with('M') && one.ends_with('Z') && two.starts_with(&one) && two[one.len()..].ends_with("Z"));
        assert_eq!(unit, 1.0);
        // A space has no outline; a letter that is not in the font is drawn as a box.
        assert_eq!(outlines(" ", 10.0).0, "");
        assert!(outlines("窓", 10.0).0.contains('Z'));
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
