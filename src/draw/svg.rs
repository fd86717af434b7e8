//! Drawings: pages of lines, circles, pictures and text, as one self-contained SVG file or as pixels.
//!
//! In: marks in pixels of the page, x to the right, y down. Out: SVG 1.1 without scripts or links, or pixels. In SVG,
//! text is drawn by the viewer. Pixels are drawn by resvg, with the letter outlines of [`text`]. Cost: some tens of
//! bytes per mark; 0.1 us per drawn pixel. Source: SVG 1.1 (2nd ed., W3C 2011), chapters 8 (paths), 10 (text) and 5.7
//! (image).

use super::image::{data_url, png_rgb};
use super::markup::{escape, number};
use super::text;
use crate::plane::Plane;
use resvg::{tiny_skia, usvg};
use std::fmt::Write;

/// Fonts for the viewer. The layout is computed with the font of [`text`], and none of these fonts is wider.
const FONTS: &str = "'DejaVu Sans Condensed', Arial, Helvetica, sans-serif";

/// An sRGB colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Colour(pub u8, pub u8, pub u8);

impl Colour {
    /// The background.
    pub const WHITE: Colour = Colour(255, 255, 255);
    /// The colour of letters and frames.
    pub const INK: Colour = Colour(26, 26, 26);
    /// The colour of secondary text.
    pub const FAINT: Colour = Colour(110, 110, 110);
    /// The colour of grid lines.
    pub const GRID: Colour = Colour(224, 224, 224);

    /// Returns red, green and blue.
    pub fn rgb(self) -> [u8; 3] {
        [self.0, self.1, self.2]
    }

    /// Returns the colour at position `place`, 0 to 1, along `scale`, which has at least two colours.
    pub fn between(scale: &[[f64; 3]], place: f64) -> Colour {
        let at = place.clamp(0.0, 1.0) * (scale.len() - 1) as f64;
        let below = (at as usize).min(scale.len() - 2);
        let part = at - below as f64;
        let [r, g, b] =
            [0, 1, 2].map(|c| (scale[below][c] + part * (scale[below + 1][c] - scale[below][c])).round() as u8);
        Colour(r, g, b)
    }

    /// Returns the colour as in SVG and CSS.
    pub fn hex(self) -> String {
        format!("#{:02x}{:02x}{:02x}", self.0, self.1, self.2)
    }
}

/// A rectangle of the page, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Area {
    /// Its left edge.
    pub x: f64,
    /// Its upper edge.
    pub y: f64,
    /// Its width.
    pub width: f64,
    /// Its height.
    pub height: f64,
}

/// The stroke of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pen {
    /// Its colour.
    pub colour: Colour,
    /// Its width in pixels.
    pub width: f64,
    /// Opacity, from 0 (invisible) to 1.
    pub opacity: f64,
}

/// The point of a text that is at the given position.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// The start of the text.
    Start,
    /// The middle of the text.
    Middle,
    /// The end of the text.
    End,
}

impl Anchor {
    /// Returns the name of the anchor in SVG, and the fraction of the text before the position.
    fn terms(self) -> (&'static str, f64) {
        match self {
            Anchor::Start => ("start", 0.0),
            Anchor::Middle => ("middle", 0.5),
            Anchor::End => ("end", 1.0),
        }
    }
}

/// The data of a path: lines and circles with the same stroke.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Path(String);

impl Path {
    /// Adds a line.
    pub fn line(&mut self, from: (f64, f64), to: (f64, f64)) {
        self.points(&[from, to]);
    }

    /// Adds lines from point to point; adds nothing if a coordinate is not finite.
    pub fn points(&mut self, points: &[(f64, f64)]) {
        if points.iter().any(|p| !p.0.is_finite() || !p.1.is_finite()) {
            return;
        }
        for (i, (x, y)) in points.iter().enumerate() {
            let _ = write!(self.0, "{}{} {}", if i == 0 { 'M' } else { 'L' }, number(*x), number(*y));
        }
    }

    /// Adds a circle.
    pub fn circle(&mut self, centre: (f64, f64), radius: f64) {
        let (left, y, r, d) = (number(centre.0 - radius), number(centre.1), number(radius), number(2.0 * radius));
        let _ = write!(self.0, "M{left} {y}a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0 -{d} 0");
    }
}

/// A page with marks.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    width: usize,
    height: usize,
    title: String,
    marks: Vec<Mark>,
    clips: usize,
}

#[derive(Debug, Clone, PartialEq)]
enum Mark {
    /// An SVG element with a final line feed.
    Svg(String),
    /// A line of text, with its position in `transform`.
    Text { transform: String, size: f64, anchor: Anchor, colour: Colour, text: String },
}

impl Mark {
    /// Writes the mark as SVG. Text is written as outlines if `is_outlined`, otherwise as text.
    fn write(&self, is_outlined: bool, svg: &mut String) {
        let _ = match self {
            Mark::Svg(element) => write!(svg, "{element}"),
            Mark::Text { transform, size, anchor, colour, text } if is_outlined => {
                let (path, unit) = text::outlines(text, *size);
                let left = number(-anchor.terms().1 * text::width(text, *size));
                let transform = format!("{transform} translate({left} 0) scale({unit:.6})");
                writeln!(svg, "<path transform=\"{transform}\" fill=\"{}\" d=\"{path}\"/>", colour.hex())
            }
            Mark::Text { transform, size, anchor, colour, text } => {
                let (anchor, size) = (anchor.terms().0, number(*size));
                let (colour, text) = (colour.hex(), escape(text));
                writeln!(
                    svg,
                    "<text transform=\"{transform}\" font-size=\"{size}\" text-anchor=\"{anchor}\" fill=\"{colour}\">{text}</text>"
                )
            }
        };
    }
}

impl Drawing {
    /// Creates a white page of `width` x `height` pixels; `title` is for screen readers.
    pub fn new(width: usize, height: usize, title: &str) -> Self {
        Drawing { width, height, title: title.to_owned(), marks: Vec::new(), clips: 0 }
    }

    /// Returns the width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Draws `path` with `pen`.
    pub fn stroke(&mut self, path: &Path, pen: Pen) {
        self.put_path(path, pen, "");
    }

    /// Draws `path` with a dashed line.
    pub fn stroke_dashed(&mut self, path: &Path, pen: Pen) {
        self.put_path(path, pen, " stroke-dasharray=\"6 5\"");
    }

    fn put_path(&mut self, path: &Path, pen: Pen, more: &str) {
        if path.0.is_empty() {
            return;
        }
        let (colour, width, opacity) = (pen.colour.hex(), number(pen.width), number(pen.opacity));
        self.put(format!(
            "<path fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-opacity=\"{opacity}\" \
             stroke-linejoin=\"round\" stroke-linecap=\"round\"{more} d=\"{}\"/>",
            path.0
        ));
    }

    /// Fills the inside of `path`.
    pub fn fill(&mut self, path: &Path, colour: Colour, opacity: f64) {
        let (colour, opacity) = (colour.hex(), number(opacity));
        self.put(format!("<path fill=\"{colour}\" fill-opacity=\"{opacity}\" d=\"{}\"/>", path.0));
    }

    /// Draws a filled rectangle.
    pub fn fill_area(&mut self, area: Area, colour: Colour) {
        self.put(format!("<rect {} fill=\"{}\"/>", attributes(area), colour.hex()));
    }

    /// Draws the outline of a rectangle.
    pub fn outline(&mut self, area: Area, pen: Pen) {
        let (colour, width) = (pen.colour.hex(), number(pen.width));
        self.put(format!("<rect {} fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\"/>", attributes(area)));
    }

    /// Draws a picture, given as a PNG file, that fills `area`; magnified pixels stay square.
    pub fn picture(&mut self, area: Area, png: &[u8]) {
        self.put(format!(
            "<image {} preserveAspectRatio=\"none\" image-rendering=\"optimizeSpeed\" xlink:href=\"{}\"/>",
            attributes(area),
            data_url("png", png)
        ));
    }

    /// Calls `draw`, and clips the marks that it draws to `area`.
    pub fn clipped(&mut self, area: Area, draw: impl FnOnce(&mut Drawing)) {
        self.clips += 1;
        let (clip, sides) = (format!("clip{}", self.clips), attributes(area));
        self.put(format!("<clipPath id=\"{clip}\"><rect {sides}/></clipPath>\n<g clip-path=\"url(#{clip})\">"));
        draw(self);
        self.put("</g>".into());
    }

    /// Draws a line of text of `size` pixels, with its base line at `y`.
    pub fn text(&mut self, (x, y): (f64, f64), size: f64, anchor: Anchor, colour: Colour, text: &str) {
        let transform = format!("translate({} {})", number(x), number(y));
        self.marks.push(Mark::Text { transform, size, anchor, colour, text: text.to_owned() });
    }

    /// Draws a line of text that reads upwards, centred at the position.
    pub fn text_upwards(&mut self, (x, y): (f64, f64), size: f64, colour: Colour, text: &str) {
        let transform = format!("translate({} {}) rotate(-90)", number(x), number(y));
        self.marks.push(Mark::Text { transform, size, anchor: Anchor::Middle, colour, text: text.to_owned() });
    }

    fn put(&mut self, element: String) {
        self.marks.push(Mark::Svg(element + "\n"));
    }

    /// Returns the page as SVG. Text stays text, which the viewer draws with its own fonts.
    pub fn to_svg(&self) -> String {
        self.written(false)
    }

    fn written(&self, is_outlined: bool) -> String {
        let (w, h, title) = (self.width, self.height, escape(&self.title));
        let mut svg = format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\" \
             xmlns:xlink=\"http://www.w3.org/1999/xlink\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\" \
             font-family=\"{FONTS}\" xml:space=\"preserve\">\n<title>{title}</title>\n\
             <rect width=\"{w}\" height=\"{h}\" fill=\"#ffffff\"/>\n",
        );
        self.marks.iter().for_each(|mark| mark.write(is_outlined, &mut svg));
        svg + "</svg>\n"
    }

    /// Draws the page as pixels with resvg; the letters are the outlines of [`text`].
    ///
    /// # Errors
    /// A message if a side is too long.
    pub fn to_pixels(&self) -> Result<Plane<[u8; 3]>, String> {
        let tree = usvg::Tree::from_str(&self.written(true), &usvg::Options::default()).map_err(|e| e.to_string())?;
        let size = tree.size().to_int_size();
        let pixels = tiny_skia::Pixmap::new(size.width(), size.height());
        let mut pixels = pixels.ok_or_else(|| format!("a page of {} x {}", size.width(), size.height()))?;
        resvg::render(&tree, tiny_skia::Transform::identity(), &mut pixels.as_mut());
        // The page is opaque everywhere, so premultiplied colours are the colours themselves.
        let rgb = pixels.data().chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect();
        Ok(Plane::from_vec(size.width() as usize, size.height() as usize, rgb))
    }

    /// Returns the page as a PNG file.
    ///
    /// # Errors
    /// A message if a side is too long.
    pub fn to_png(&self) -> Result<Vec<u8>, String> {
        png_rgb(&self.to_pixels()?)
    }
}

fn attributes(a: Area) -> String {
    let [x, y, w, h] = [a.x, a.y, a.width, a.height].map(number);
    format!("x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\"")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::image::png_grey;

    const RED: Colour = Colour(220, 0, 0);

    fn page() -> Drawing {
        let mut page = Drawing::new(60, 40, "a < b & \"c\"\u{1}");
        let chess =
            Plane::from_rows(2, 2, |y, row| (0..2).for_each(|x| row[x] = if (x + y) % 2 == 0 { 40 } else { 200 }));
        page.picture(Area { x: 0.0, y: 0.0, width: 20.0, height: 20.0 }, &png_grey(&chess).unwrap());
        let mut path = Path::default();
        path.circle((40.0, 20.0), 5.0);
        path.line((f64::NAN, 0.0), (1.0, 1.0));
        page.fill(&path, RED, 1.0);
        page.clipped(Area { x: 0.0, y: 30.0, width: 10.0, height: 10.0 }, |inside| {
            inside.fill_area(Area { x: 0.0, y: 30.0, width: 60.0, height: 5.0 }, Colour::INK);
        });
        page.text((5.0, 38.0), 10.0, Anchor::Start, Colour::INK, "<&> \u{7} 窓");
        page
    }

    #[test]
    fn markup_is_well_formed_for_any_text() {
        let svg = page().to_svg();
        let tree = usvg::roxmltree::Document::parse(&svg).unwrap();
        let words: Vec<_> = tree
            .descendants()
            .filter(|n| n.has_tag_name("title") || n.has_tag_name("text"))
            .filter_map(|n| n.text())
            .collect();
        assert_eq!(words, ["a < b & \"c\"\u{fffd}", "<&> \u{fffd} 窓"]);
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn pixels_are_where_the_marks_are() {
        let pixels = page().to_pixels().unwrap();
        assert_eq!((pixels.width(), pixels.height()), (60, 40));
        // The picture, magnified ten times without blur; the circle; the clipped bar; the background.
        assert_eq!([(9, 9), (10, 9), (19, 19)].map(|(x, y)| pixels.at(x, y)[0]), [40, 200, 40]);
        assert_eq!((pixels.at(40, 20), pixels.at(40, 28)), ([220, 0, 0], [255; 3]));
        assert_eq!((pixels.at(5, 32), pixels.at(57, 32)), ([26; 3], [255; 3]));
        assert!(Drawing::new(usize::MAX, 1, "too wide").to_pixels().is_err());
    }
}
