//! The difference picture: the expected picture, the difference in false colours, and the actual picture side by side,
//! with a legend.
//!
//! In: both files and the differences of their pixels. Out: a PNG. Cost: some tenths of a second.
//!
//! Pictures with more than 1200 pixels on a side are reduced by an integer factor. A pixel of the reduced difference
//! shows the largest difference in its block, so that single pixels stay visible. Small pictures are enlarged. A
//! radiance v of either file is shown as the square root of v / (v + m), where m is the median of the positive green
//! values of the expected map. Because m is the same for both files, a gain between them is visible. Where nothing
//! differs, the middle panel shows the expected picture, dimmed.

use super::input::{Input, Pixels};
use super::radiance::percentile;
use super::{Limits, Magnitudes, Unit};
use crate::draw::scale::Cells;
use crate::draw::svg::{Anchor, Area, Colour, Drawing, Path as Line, Pen};
use crate::draw::text::{shorten, width};
use crate::error::{Error, Result};
use crate::plane::Plane;
use crate::tonemap::display::codes::Colours;
use crate::write::{self, Format, Metadata, Pending, Target, png};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Largest side of a panel, in pixels.
const MOST: usize = 1200;
/// Small pictures are enlarged to a side of at most this many pixels.
const LEAST: usize = 360;
/// Margin to the left and right of the panels, in pixels.
const MARGIN: usize = 20;
/// Gap between two panels, in pixels.
const GAP: usize = 10;
/// Space above the panels for title and headings, in pixels.
const ABOVE: usize = 76;
/// Space below the panels for the legend, in pixels.
const BELOW: usize = 104;
/// Size of the title, in pixels.
const TITLE: f64 = 22.0;
/// Size of other text, in pixels.
const TEXT: f64 = 16.0;
/// Number of decades that the scale of the false colours covers.
const DECADES: f64 = 3.0;

/// Colour of pixels that are not in both files. Also the colour of pixels that are different, if one of their
/// values is NaN or infinite, either in a file or after conversion.
const NOTHING: Colour = Colour(255, 0, 200);
/// Colours below the tolerance: dark to light blue.
const WITHIN: [[f64; 3]; 2] = [[20.0, 40.0, 110.0], [90.0, 160.0, 235.0]];
/// Colours from the tolerance to the end of the scale: violet, red, orange, yellow, white.
const BEYOND: [[f64; 3]; 5] =
    [[120.0, 20.0, 110.0], [215.0, 40.0, 60.0], [250.0, 140.0, 20.0], [250.0, 225.0, 60.0], [255.0; 3]];

/// The text and marks of the difference picture.
pub(super) struct Words<'a> {
    pub title: &'a str,
    pub limits: &'a Limits,
    /// The pixel with the largest difference, to mark with a ring.
    pub largest: Option<(usize, usize)>,
}

/// Checks that the difference picture can be written to `path`, before any work is done.
///
/// # Errors
/// [`Error::UnknownExtension`], and those of the check of targets.
pub(super) fn check(path: &Path, inputs: &[PathBuf], overwrite: bool) -> Result<()> {
    if !matches!(Format::of(path), Ok(Format::Png)) {
        return Err(Error::UnknownExtension { path: path.to_owned(), known: ".png" });
    }
    write::check_targets(&Target::of("--diff", &[path.to_owned()]), inputs, overwrite)
}

/// Writes the difference picture. Without magnitudes (if the sizes differ), pixels that are not in both files are
/// marked.
///
/// # Errors
/// [`Error::Write`], [`Error::OutputExists`].
pub(super) fn write(
    path: &Path,
    overwrite: bool,
    (a, b): (&Input, &Input),
    magnitudes: Option<&Magnitudes>,
    words: &Words,
) -> Result<()> {
    let failed = |reason: String| Error::Write { path: path.to_owned(), source: std::io::Error::other(reason) };
    let page = page((a, b), magnitudes, words).map_err(failed)?;
    let size = (page.width(), page.height());
    let writer = png::Writer::new(Pending::create(path)?, size, &Metadata::default(), Colours::Srgb)?;
    write::commit(vec![write::push_all(Box::new(writer), &page)?.file], overwrite)
}

/// Draws the whole page: title, headings, panels and legend.
fn page(
    (a, b): (&Input, &Input),
    magnitudes: Option<&Magnitudes>,
    words: &Words,
) -> std::result::Result<Plane<[u8; 3]>, String> {
    let ((aw, ah), (bw, bh)) = (a.size(), b.size());
    let size = (aw.max(bw), ah.max(bh));
    let fit = Cells::within(size, LEAST, MOST);
    let middle = middle_of(a);
    let shown = |input: &Input| fit.picture(size, |columns, rows| mean(input, middle, columns, rows));
    let scale = magnitudes.map(|m| Scale::of(m, words.limits));
    let dimmed = |columns: Range<usize>, rows: Range<usize>| {
        let [r, g, b] = mean(a, middle, columns, rows).map(f64::from);
        [(0.35 * (0.2126 * r + 0.7152 * g + 0.0722 * b)) as u8; 3]
    };

    let difference = fit.picture(size, |columns, rows| {
        let (Some(magnitudes), Some(scale)) = (magnitudes, &scale) else {
            let is_missing = columns.start >= aw.min(bw) || rows.start >= ah.min(bh);
            return if is_missing { NOTHING.rgb() } else { dimmed(columns, rows) };
        };
        let most =
            rows.clone().flat_map(|y| &magnitudes.plane.row(y)[columns.clone()]).fold(0.0, |m: f32, v| m.max(*v));
        if most > 0.0 { scale.colour(most).rgb() } else { dimmed(columns, rows) }
    });

    let (across, down) = fit.size(size);
    let width = (3 * across + 2 * GAP).max(3 * LEAST / 2) + 2 * MARGIN;
    // A wide page is usually viewed at a reduced size, so its text is larger.
    let zoom = (width as f64 / 1500.0).clamp(1.0, 2.2);
    let (above, below) = ((ABOVE as f64 * zoom) as usize, (BELOW as f64 * zoom) as usize);
    let height = above + down + below;
    let mut drawing = Drawing::new(width, height, words.title);
    let room = (width - 2 * MARGIN) as f64;
    let title = shorten(words.title, TITLE * zoom, room);
    drawing.text((MARGIN as f64, 36.0 * zoom), TITLE * zoom, Anchor::Start, Colour::INK, &title);
    let headings = [format!("expected: {}", a.name()), "difference".into(), format!("actual: {}", b.name())];
    let corners = [0, 1, 2].map(|i| MARGIN + i * (across + GAP));
    for (x, heading) in corners.iter().zip(&headings) {
        let heading = shorten(heading, TEXT * zoom, across as f64);
        let place = (*x as f64, above as f64 - 9.0 * zoom);
        drawing.text(place, TEXT * zoom, Anchor::Start, Colour::FAINT, &heading);
    }
    legend(&mut drawing, (above + down) as f64 + 16.0 * zoom, (room, zoom), scale.as_ref());
    let mut page = drawing.to_pixels()?;
    for (x, panel) in corners.iter().zip([shown(a), difference, shown(b)]) {
        for y in 0..panel.height() {
            page.row_mut(above + y)[*x..x + panel.width()].copy_from_slice(panel.row(y));
        }
    }
    if let Some((x, y)) = words.largest {
        let cell = |i: usize| i / fit.by * fit.times + fit.times / 2;
        let (left, right) = (corners[1], corners[1] + across);
        ring(&mut page, (left + cell(x), above + cell(y)), 14.0 * zoom, ((left, above), (right, above + down)));
    }
    Ok(page)
}

/// Draws the legend: the colours, their values, and the tolerance.
fn legend(drawing: &mut Drawing, y: f64, (room, zoom): (f64, f64), scale: Option<&Scale>) {
    let text = TEXT * zoom;
    let (left, below) = (MARGIN as f64, y + 54.0 * zoom);
    let sample = |drawing: &mut Drawing, x: f64, colour: Colour, words: &str| {
        let area = Area { x, y: below + 4.0 * zoom, width: 26.0 * zoom, height: 14.0 * zoom };
        drawing.fill_area(area, colour);
        drawing.text((x + 34.0 * zoom, below + 16.0 * zoom), text, Anchor::Start, Colour::FAINT, words);
        x + 58.0 * zoom + width(words, text)
    };
    let Some(scale) = scale else {
        sample(drawing, left, NOTHING, "in one file only");
        return;
    };
    let (bar, strips) = (room.min(640.0 * zoom), 128);
    for i in 0..strips {
        let width = bar / strips as f64;
        // Each strip is slightly wider than the distance to the next strip, so that there are no gaps.
        let area = Area { x: left + i as f64 * width, y, width: width + 0.4, height: 18.0 * zoom };
        drawing.fill_area(area, scale.at(i as f64 / (strips - 1) as f64));
    }
    let ticks = (0..=DECADES as i32).map(|k| scale.top * libm::exp10(f64::from(k) - DECADES));
    for (i, value) in ticks.enumerate() {
        let is_last = i as f64 == DECADES;
        let anchor = match i {
            0 => Anchor::Start,
            _ if is_last => Anchor::End,
            _ => Anchor::Middle,
        };
        let unit = if is_last { format!(" {}", scale.unit()) } else { String::new() };
        let place = (left + bar * i as f64 / DECADES, y + 38.0 * zoom);
        drawing.text(place, text, anchor, Colour::INK, &format!("{}{unit}", short(value)));
    }
    let place = scale.place(scale.tolerance);
    if scale.tolerance > 0.0 && (0.0..=1.0).contains(&place) {
        let mut line = Line::default();
        line.line((left + bar * place, y - 7.0 * zoom), (left + bar * place, y + 22.0 * zoom));
        drawing.stroke(&line, Pen { colour: Colour::INK, width: 2.0 * zoom, opacity: 1.0 });
    }
    let mut next = sample(drawing, left, Colour(70, 70, 70), "equal");
    if scale.tolerance > 0.0 {
        let words = format!("within {} {}", short(scale.tolerance), scale.unit());
        next = sample(drawing, next, Colour::between(&WITHIN, 0.7), &words);
    }
    let beyond = if scale.tolerance > 0.0 { "beyond" } else { "not equal" };
    next = sample(drawing, next, Colour::between(&BEYOND, 0.5), beyond);
    if scale.has_nothing {
        next = sample(drawing, next, NOTHING, "different, with NaN or infinity");
    }
    drawing.text((next, below + 16.0 * zoom), text, Anchor::Start, Colour::FAINT, "ring: the largest");
}

/// Formats a number with two significant digits, without trailing zeros.
fn short(value: f64) -> String {
    let digits = (1.0 - libm::floor(libm::log10(value.max(1e-9)))).clamp(0.0, 9.0) as usize;
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

/// The logarithmic scale of the false colours, which covers [`DECADES`] decades and ends at `top`.
struct Scale {
    unit: Unit,
    top: f64,
    tolerance: f64,
    has_nothing: bool,
}

impl Scale {
    fn of(magnitudes: &Magnitudes, limits: &Limits) -> Scale {
        let values = magnitudes.plane.as_slice();
        let most = values.iter().copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
        let tolerance = limits.tolerance_stops.or(limits.tolerance_de).unwrap_or(0.0);
        // The scale ends at the next number that is 1, 2 or 5 times a power of ten.
        let wanted = f64::from(most).max(tolerance).max(1e-6);
        let decade = libm::exp10(libm::floor(libm::log10(wanted)));
        let top = [1.0, 2.0, 5.0, 10.0].map(|k| k * decade).into_iter().find(|top| *top >= wanted * 0.999_999);
        let has_nothing = values.iter().any(|v| v.is_infinite());
        Scale { unit: magnitudes.unit, top: top.unwrap_or(wanted), tolerance, has_nothing }
    }

    fn unit(&self) -> &'static str {
        match self.unit {
            Unit::Stops => "stops",
            Unit::DeltaE => "dE",
        }
    }

    /// Returns the position of a value: 0 at the start of the scale, 1 at its end.
    fn place(&self, value: f64) -> f64 {
        1.0 + libm::log10(value.max(1e-12) / self.top) / DECADES
    }

    fn colour(&self, magnitude: f32) -> Colour {
        if magnitude.is_infinite() { NOTHING } else { self.at(self.place(magnitude.into())) }
    }

    fn at(&self, place: f64) -> Colour {
        // If the tolerance is 0, every difference exceeds it and has a colour of `BEYOND`.
        let border = if self.tolerance > 0.0 { self.place(self.tolerance).clamp(0.0, 1.0) } else { 0.0 };
        if place < border {
            Colour::between(&WITHIN, place / border)
        } else {
            Colour::between(&BEYOND, (place - border) / (1.0 - border).max(1e-9))
        }
    }
}

/// Draws a white ring with a black edge around a point of the page, clipped to the area between two corners.
fn ring(page: &mut Plane<[u8; 3]>, (x, y): (usize, usize), radius: f64, (from, to): ((usize, usize), (usize, usize))) {
    for row in from.1..to.1 {
        for column in from.0..to.0 {
            let away = libm::hypot(column as f64 - x as f64, row as f64 - y as f64) - radius;
            let colour = match away.abs() / radius * 12.0 {
                d if d <= 1.2 => [255; 3],
                d if d <= 2.4 => [0; 3],
                _ => continue,
            };
            page.row_mut(row)[column] = colour;
        }
    }
}

/// Returns the radiance that is shown as middle grey: the median of green. It is not used for pictures.
fn middle_of(input: &Input) -> f32 {
    let Pixels::Radiance(map, _) = &input.pixels else { return 1.0 };
    let pixels = map.pixels.as_slice();
    let step = pixels.len().div_ceil(1_000_000).max(1);
    percentile(pixels.iter().step_by(step).map(|p| p[1]), 0.5).unwrap_or(1.0)
}

/// Returns the mean of the pixels in `columns` and `rows` as they are shown; white if the picture has no pixels there.
fn mean(input: &Input, middle: f32, columns: Range<usize>, rows: Range<usize>) -> [u8; 3] {
    let (width, height) = input.size();
    let (columns, rows) = (columns.start..columns.end.min(width), rows.start..rows.end.min(height));
    let count = columns.len() * rows.len();
    if count == 0 {
        return [255; 3];
    }
    let mut sum = [0.0f32; 3];
    for y in rows {
        for x in columns.clone() {
            let shown = match &input.pixels {
                Pixels::Radiance(map, _) => map.pixels.at(x, y).map(|v| {
                    let v = if v.is_nan() { 0.0 } else { v.clamp(0.0, f32::MAX) };
                    // The square root approximates the encoding of displays.
                    255.0 * (v / (v + middle)).sqrt()
                }),
                Pixels::Display(photograph) => {
                    let unit = f32::from(photograph.samples.max()) / 255.0;
                    input.at(x, y).map(|code| code as f32 / unit)
                }
            };
            (0..3).for_each(|c| sum[c] += shown[c]);
        }
    }
    sum.map(|s| (s / count as f32).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_has_a_round_top_and_its_colours_grow_brighter() {
        let magnitudes = |most: f32| Magnitudes { plane: Plane::filled(3, 3, most), unit: Unit::Stops };
        let top = |most: f32| Scale::of(&magnitudes(most), &Limits::default()).top;
        // Computed powers of ten have relative errors of about 1e-16.
        for (most, expected) in [(0.02f32, 0.02), (0.021, 0.05), (0.9, 1.0), (3.0, 5.0), (700.0, 1000.0)] {
            assert!((top(most) / expected - 1.0).abs() < 1e-6, "{most}: {}", top(most));
        }
        let scale = Scale::of(&magnitudes(1.0), &Limits { tolerance_stops: Some(0.01), ..Limits::default() });
        assert!((scale.place(0.01) - 1.0 / 3.0).abs() < 1e-9 && scale.place(1.0) == 1.0);
        assert_eq!((scale.colour(1.0), scale.colour(f32::INFINITY)), (Colour::WHITE, NOTHING));
        // Blue within the tolerance, warm beyond it, and brighter for larger differences.
        let at = |i: i32| scale.at(f64::from(i) / 100.0).rgb().map(u32::from);
        assert!((0..33).all(|i| at(i)[2] > at(i)[0]) && (34..=100).all(|i| at(i)[0] >= at(i)[2]));
        let light = |i: i32| at(i).iter().sum::<u32>();
        assert!((0..32).chain(34..99).all(|i| light(i) <= light(i + 1) + 3));
        assert_eq!([0.001, 0.02, 1.0, 0.5, 200.0].map(short), ["0.001", "0.02", "1", "0.5", "200"]);
    }
}
