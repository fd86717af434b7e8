//! The page of a sheet: a title, a legend, space for the drawing, and notes below it.
//!
//! In: texts. Out: a [`Drawing`], and the upper left corner of the space for the content. Cost: negligible.

use crate::draw::svg::{Anchor, Area, Colour, Drawing, Path, Pen};
use crate::draw::text;

/// Size of the font of the title, in pixels.
pub(super) const TITLE: f64 = 22.0;
/// Size of the font of other text, in pixels.
pub(super) const TEXT: f64 = 17.0;
/// Width of the empty margin of the page, in pixels.
const MARGIN: f64 = 20.0;
/// Distance between two lines of text, divided by the font size.
const LEADING: f64 = 1.45;
/// Width of the colour sample of a legend entry, in pixels.
const SAMPLE: f64 = 34.0;
/// Distance between two entries of the legend, in pixels.
const GAP: f64 = 28.0;
/// Smallest width of a page, in pixels, so that its texts have room.
const LEAST_WIDTH: f64 = 700.0;

/// Background of the legend samples of keypoints and lines, whose colours are chosen for a dark photograph behind
/// them.
const DARK: Colour = Colour(56, 56, 56);

/// An entry of the legend: a colour and its meaning.
pub(super) struct Entry {
    pub(super) mark: Mark,
    pub(super) colour: Colour,
    pub(super) words: String,
}

/// The shape that is drawn as the sample of a legend entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mark {
    /// A circle with a tick, on a dark background.
    Keypoint,
    /// A line, on a dark background.
    Line,
    /// A filled rectangle.
    Patch,
}

/// A drawing with title, legend and notes. `corner` is the upper left corner of the space for its content.
pub(super) struct Page {
    pub(super) drawing: Drawing,
    pub(super) corner: (f64, f64),
}

impl Page {
    /// Creates a page with space for content of `size` pixels.
    pub(super) fn new(title: &str, legend: &[Entry], size: (f64, f64), notes: &str) -> Self {
        let inner = size.0.max(LEAST_WIDTH - 2.0 * MARGIN);
        let lines = if notes.is_empty() { Vec::new() } else { text::wrap(notes, TEXT, inner) };
        let rows = rows(legend, inner);
        let line = TEXT * LEADING;
        let first = MARGIN + TITLE;
        let legend_from = first + 0.75 * TITLE;
        let content_from =
            if rows.is_empty() { first + 0.6 * TITLE } else { legend_from + rows.len() as f64 * line + 8.0 };
        let below = content_from + size.1 + 0.4 * line;
        let height = below + lines.len() as f64 * line + MARGIN * 0.6;
        let mut drawing = Drawing::new((inner + 2.0 * MARGIN).ceil() as usize, height.ceil() as usize, title);
        let title = text::shorten(title, TITLE, inner);
        drawing.text((MARGIN, first - 3.0), TITLE, Anchor::Start, Colour::INK, &title);
        for (i, row) in rows.iter().enumerate() {
            let mut x = MARGIN;
            let y = legend_from + (i as f64 + 0.5) * line;
            for entry in row {
                sample(&mut drawing, (x, y), entry);
                drawing.text((x + SAMPLE + 9.0, y + 0.35 * TEXT), TEXT, Anchor::Start, Colour::INK, &entry.words);
                x += entry_width(entry);
            }
        }
        for (i, words) in lines.iter().enumerate() {
            let y = below + (i as f64 + 0.8) * line;
            drawing.text((MARGIN, y), TEXT, Anchor::Start, Colour::FAINT, words);
        }
        Page { drawing, corner: (MARGIN, content_from.round()) }
    }
}

/// Divides the entries of the legend into rows that are at most `most` pixels wide.
fn rows(legend: &[Entry], most: f64) -> Vec<Vec<&Entry>> {
    let mut rows: Vec<(f64, Vec<&Entry>)> = Vec::new();
    for entry in legend {
        let width = entry_width(entry);
        match rows.last_mut() {
            Some((taken, row)) if *taken + width - GAP <= most => {
                *taken += width;
                row.push(entry);
            }
            _ => rows.push((width, vec![entry])),
        }
    }
    rows.into_iter().map(|(_, row)| row).collect()
}

fn entry_width(entry: &Entry) -> f64 {
    SAMPLE + 9.0 + text::width(&entry.words, TEXT) + GAP
}

fn sample(drawing: &mut Drawing, (x, y): (f64, f64), entry: &Entry) {
    let area = Area { x, y: y - 9.0, width: SAMPLE, height: 18.0 };
    let pen = Pen { colour: entry.colour, width: 1.8, opacity: 1.0 };
    let mut path = Path::default();
    match entry.mark {
        Mark::Patch => {
            drawing.fill_area(area, entry.colour);
            return drawing.outline(area, Pen { colour: Colour::FAINT, width: 0.8, opacity: 1.0 });
        }
        Mark::Line => path.line((x + 5.0, y), (x + SAMPLE - 5.0, y)),
        Mark::Keypoint => {
            path.circle((x + SAMPLE / 2.0, y), 6.0);
            path.line((x + SAMPLE / 2.0, y), (x + SAMPLE / 2.0 + 6.0, y));
        }
    }
    drawing.fill_area(area, DARK);
    drawing.stroke(&path, pen);
}
