//! Drawings: lines, circles, pictures and lettering as one self-contained SVG, and the same SVG as pixels.
//!
//! In: marks in pixels of the page, x to the right, y down. Out: SVG 1.1 without scripts, fonts or links; its pixels by resvg. Cost: some
//! tens of bytes a mark; 0.1 us a pixel drawn. Source: SVG 1.1 (2nd ed., W3C 2011), chapters 8 (paths) and 5.7 (image).

use super::lettering;
use crate::plane::Plane;
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use resvg::{tiny_skia, usvg};
use std::fmt::Write;

/// A colour, sRGB.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Colour(pub u8, pub u8, pub u8);

impl Colour {
    /// Paper.
    pub const WHITE: Colour = Colour(255, 255, 255);
    /// Letters and frames.
    pub const INK: Colour = Colour(26, 26, 26);
    /// Secondary words.
    pub const FAINT: Colour = Colour(110, 110, 110);
    /// Lines behind a curve.
    pub const GRID: Colour = Colour(224, 224, 224);

    fn hex(self) -> String {
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

/// A pen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pen {
    /// Its colour.
    pub colour: Colour,
    /// Its width in pixels.
    pub width: f64,
    /// 0 (not to be seen) to 1.
    pub opacity: f64,
}

/// Which part of a text is at its place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Anchor {
    /// Its beginning.
    Start,
    /// Its middle.
    Middle,
    /// Its end.
    End,
}

/// The data of a path: many lines and circles that one pen draws.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Path(String);

impl Path {
    /// A line.
    pub fn line(&mut self, from: (f64, f64), to: (f64, f64)) {
        self.points(&[from, to]);
    }

    /// Lines from point to point; nothing where one of them is no number.
    pub fn points(&mut self, points: &[(f64, f64)]) {
        if points.iter().any(|p| !p.0.is_finite() || !p.1.is_finite()) {
            return;
        }
        for (i, (x, y)) in points.iter().enumerate() {
            let _ = write!(self.0, "{}{} {}", if i == 0 { 'M' } else { 'L' }, number(*x), number(*y));
        }
    }

    /// A circle.
    pub fn circle(&mut self, centre: (f64, f64), radius: f64) {
        let (left, y, r, d) = (number(centre.0 - radius), number(centre.1), number(radius), number(2.0 * radius));
        let _ = write!(self.0, "M{left} {y}a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0 -{d} 0");
    }
}

/// A page with marks on it.
#[derive(Debug, Clone, PartialEq)]
pub struct Drawing {
    width: usize,
    height: usize,
    title: String,
    body: String,
    clips: usize,
}

impl Drawing {
    /// White paper of `width` x `height` pixels; `title` is for readers that do not see.
    pub fn new(width: usize, height: usize, title: &str) -> Self {
        Drawing { width, height, title: title.to_owned(), body: String::new(), clips: 0 }
    }

    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// What `path` holds, by `pen`.
    pub fn stroke(&mut self, path: &Path, pen: Pen) {
        self.put_path(path, pen, "");
    }

    /// The same in dashes.
    pub fn stroke_dashed(&mut self, path: &Path, pen: Pen) {
        self.put_path(path, pen, " stroke-dasharray=\"6 5\"");
    }

    fn put_path(&mut self, path: &Path, pen: Pen, more: &str) {
        if path.0.is_empty() {
            return;
        }
        let (colour, width, opacity) = (pen.colour.hex(), number(pen.width), number(pen.opacity));
        let _ = writeln!(
            self.body,
            "<path fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\" stroke-opacity=\"{opacity}\" \
             stroke-linejoin=\"round\" stroke-linecap=\"round\"{more} d=\"{}\"/>",
            path.0
        );
    }

    /// The inside of what `path` encloses.
    pub fn fill(&mut self, path: &Path, colour: Colour, opacity: f64) {
        let (colour, opacity) = (colour.hex(), number(opacity));
        let _ = writeln!(self.body, "<path fill=\"{colour}\" fill-opacity=\"{opacity}\" d=\"{}\"/>", path.0);
    }

    /// A rectangle, filled.
    pub fn fill_area(&mut self, area: Area, colour: Colour) {
        let _ = writeln!(self.body, "<rect {} fill=\"{}\"/>", attributes(area), colour.hex());
    }

    /// The edge of a rectangle.
    pub fn outline(&mut self, area: Area, pen: Pen) {
        let (colour, width) = (pen.colour.hex(), number(pen.width));
        let edge = format!("fill=\"none\" stroke=\"{colour}\" stroke-width=\"{width}\"");
        let _ = writeln!(self.body, "<rect {} {edge}/>", attributes(area));
    }

    /// A picture, given as a PNG file, that fills `area`; magnified, its pixels stay squares.
    pub fn picture(&mut self, area: Area, png: &[u8]) {
        let _ = writeln!(
            self.body,
            "<image {} preserveAspectRatio=\"none\" image-rendering=\"optimizeSpeed\" \
             xlink:href=\"data:image/png;base64,{}\"/>",
            attributes(area),
            BASE64.encode(png)
        );
    }

    /// What `draw` draws, but only within `area`.
    pub fn clipped(&mut self, area: Area, draw: impl FnOnce(&mut Drawing)) {
        self.clips += 1;
        let clip = format!("clip{}", self.clips);
        let _ = writeln!(self.body, "<clipPath id=\"{clip}\"><rect {}/></clipPath>", attributes(area));
        let _ = writeln!(self.body, "<g clip-path=\"url(#{clip})\">");
        draw(self);
        self.body.push_str("</g>\n");
    }

    /// A line of text of `size` pixels, its base line at `y`.
    pub fn text(&mut self, (x, y): (f64, f64), size: f64, anchor: Anchor, colour: Colour, text: &str) {
        let before = match anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => lettering::width(text, size) / 2.0,
            Anchor::End => lettering::width(text, size),
        };
        self.put_text(&format!("translate({} {})", number(x - before), number(y)), size, colour, text);
    }

    /// A line of text that goes upwards, its middle at the place.
    pub fn text_upwards(&mut self, (x, y): (f64, f64), size: f64, colour: Colour, text: &str) {
        let below = y + lettering::width(text, size) / 2.0;
        self.put_text(&format!("translate({} {}) rotate(-90)", number(x), number(below)), size, colour, text);
    }

    fn put_text(&mut self, place: &str, size: f64, colour: Colour, text: &str) {
        let unit = lettering::unit(size);
        let _ = writeln!(
            self.body,
            "<g transform=\"{place}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{}\" stroke-linecap=\"round\" \
             stroke-linejoin=\"round\"><title>{}</title>",
            colour.hex(),
            number(lettering::PEN),
            escape(text)
        );
        for (at, path) in lettering::set(text, size) {
            let (x, y, scale) = (number(at), number(-lettering::BASE * unit), format!("{unit:.4}"));
            let _ = writeln!(self.body, "<path transform=\"translate({x} {y}) scale({scale})\" d=\"{path}\"/>");
        }
        self.body.push_str("</g>\n");
    }

    /// The page as SVG.
    pub fn to_svg(&self) -> String {
        let (w, h) = (self.width, self.height);
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg xmlns=\"http://www.w3.org/2000/svg\" \
             xmlns:xlink=\"http://www.w3.org/1999/xlink\" width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {w} {h}\">\n\
             <title>{}</title>\n<rect width=\"{w}\" height=\"{h}\" fill=\"#ffffff\"/>\n{}</svg>\n",
            escape(&self.title),
            self.body
        )
    }
}

/// The pixels of `svg`, as resvg draws it; the reason where it is no SVG.
pub fn rasterise(svg: &str) -> Result<Plane<[u8; 3]>, String> {
    let tree = usvg::Tree::from_str(svg, &usvg::Options::default()).map_err(|e| e.to_string())?;
    let size = tree.size().to_int_size();
    let pixels = tiny_skia::Pixmap::new(size.width(), size.height());
    let mut pixels = pixels.ok_or_else(|| format!("a page of {} x {}", size.width(), size.height()))?;
    resvg::render(&tree, tiny_skia::Transform::identity(), &mut pixels.as_mut());
    // The paper is white and opaque everywhere, so nothing is premultiplied.
    let rgb = pixels.data().chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect();
    Ok(Plane::from_vec(size.width() as usize, size.height() as usize, rgb))
}

fn attributes(a: Area) -> String {
    let [x, y, w, h] = [a.x, a.y, a.width, a.height].map(number);
    format!("x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\"")
}

/// A number to a hundredth, no longer than it must be.
fn number(v: f64) -> String {
    let text = format!("{v:.2}");
    let text = text.trim_end_matches('0').trim_end_matches('.');
    if text == "-0" { "0".into() } else { text.into() }
}

/// Text for use between tags and in quoted attributes, of XML as of HTML. Characters that XML 1.0 forbids, that would not be seen, or that would
/// turn the order of those around them, become the replacement character.
pub(crate) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            '\t' | '\n' | '\r' => out.push(' '),
            '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{fffe}' | '\u{ffff}' => out.push('\u{fffd}'),
            c if c.is_control() => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inspect::picture::png_grey;

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
    fn it_is_well_formed_whatever_the_text() {
        let svg = page().to_svg();
        let tree = usvg::roxmltree::Document::parse(&svg).unwrap();
        let titles: Vec<_> = tree.descendants().filter(|n| n.has_tag_name("title")).filter_map(|n| n.text()).collect();
        assert_eq!(titles, ["a < b & \"c\"\u{fffd}", "<&> \u{fffd} 窓"]);
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn pixels_are_where_the_marks_are() {
        let pixels = rasterise(&page().to_svg()).unwrap();
        assert_eq!((pixels.width(), pixels.height()), (60, 40));
        // The picture, magnified ten times without blur; the circle; the clipped bar; the paper.
        assert_eq!([(9, 9), (10, 9), (19, 19)].map(|(x, y)| pixels.at(x, y)[0]), [40, 200, 40]);
        assert_eq!((pixels.at(40, 20), pixels.at(40, 28)), ([220, 0, 0], [255; 3]));
        assert_eq!((pixels.at(5, 32), pixels.at(57, 32)), ([26; 3], [255; 3]));
        assert!(rasterise("<svg").is_err());
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!([1.0, -0.001, 2.504, 1e4].map(number), ["1", "0", "2.5", "10000"]);
    }
}
