//! Plots of curves and bars that use the colours of the page, in light and dark mode.
//!
//! In: numbers. Out: inline SVG styled by classes of the page's style sheet. Cost: a few bytes per point. Source:
//! SVG 2 (W3C), chapters 9 (paths) and 11 (text).

use super::markup::escape;
use crate::draw::plot::{Axis, Plot};
use crate::draw::svg::Area;
use std::fmt::Write;

/// Margin to the left of a plot, in px.
const LEFT: f64 = 46.0;
/// Margin to the right of a plot, in px.
const RIGHT: f64 = 12.0;
/// Margin above a plot, in px.
const ABOVE: f64 = 14.0;
/// Margin below a plot, in px.
const BELOW: f64 = 42.0;

/// A plot under construction.
#[derive(Debug, Clone)]
pub(super) struct Figure {
    size: (f64, f64),
    /// Height of an extra area between the plot and the labels of its x axis, in px.
    more: f64,
    plot: Plot,
    body: String,
}

impl Figure {
    /// Creates a plot of `size` px, with an extra area of height `more` between the plot and the labels of its x axis.
    pub fn new(size: (f64, f64), more: f64, x: Axis, y: Axis) -> Self {
        let (width, height) = (size.0 - LEFT - RIGHT, size.1 - ABOVE - BELOW - more);
        let plot = Plot { area: Area { x: LEFT, y: ABOVE, width, height }, x, y };
        let mut figure = Figure { size, more, plot, body: String::new() };
        figure.axes();
        figure
    }

    /// Returns the x position of `v`, clamped to the plot.
    pub fn x(&self, v: f64) -> f64 {
        self.plot.x(v.max(self.plot.x.from).min(self.plot.x.to))
    }

    /// Returns the y position of `v`, clamped to the plot.
    fn y(&self, v: f64) -> f64 {
        self.plot.y(v.max(self.plot.y.from).min(self.plot.y.to))
    }

    /// Returns the y position of the lower edge of the plot.
    pub fn bottom(&self) -> f64 {
        self.plot.bottom()
    }

    fn axes(&mut self) {
        let (right, bottom) = (self.size.0 - RIGHT, self.bottom());
        let mut out = String::new();
        for (v, words) in &self.plot.y.ticks {
            let y = self.y(*v);
            let _ = write!(out, r#"<path class="grid" d="M{LEFT} {y:.1}H{right}"/>"#);
            let _ = write!(out, r#"<text x="{}" y="{:.1}" class="end">{}</text>"#, LEFT - 6.0, y + 4.0, escape(words));
        }
        for (v, words) in &self.plot.x.ticks {
            let x = self.x(*v);
            let _ = write!(out, r#"<path class="grid" d="M{x:.1} {ABOVE}V{bottom}"/>"#);
            let y = bottom + self.more + 16.0;
            let _ = write!(out, r#"<text x="{x:.1}" y="{y:.1}" class="mid">{}</text>"#, escape(words));
        }
        let (middle, down) = ((LEFT + right) / 2.0, (ABOVE + bottom) / 2.0);
        let (x, y) = (escape(&self.plot.x.name), escape(&self.plot.y.name));
        let _ = write!(out, r#"<text x="{middle:.1}" y="{:.1}" class="mid name">{x}</text>"#, self.size.1 - 6.0);
        let _ = writeln!(out, r#"<text transform="translate(11 {down:.1}) rotate(-90)" class="mid name">{y}</text>"#);
        self.body.push_str(&out);
    }

    /// Adds a curve through `points` with the style `class`.
    pub fn curve(&mut self, class: &str, points: impl Iterator<Item = (f64, f64)>) {
        let mut path = String::new();
        for (x, y) in points.filter(|p| p.0.is_finite() && p.1.is_finite()) {
            let letter = if path.is_empty() { 'M' } else { 'L' };
            let _ = write!(path, "{letter}{:.1} {:.1}", self.x(x), self.y(y));
        }
        let _ = writeln!(self.body, r#"<path class="curve {class}" d="{path}"/>"#);
    }

    /// Adds a bar from `x` to `x + width`, from the axis up to `y`.
    pub fn bar(&mut self, class: &str, (x, width): (f64, f64), y: f64) {
        let (left, right, top) = (self.x(x), self.x(x + width), self.y(y));
        let (w, h) = ((right - left - 0.6).max(0.4), self.bottom() - top);
        let _ =
            write!(self.body, r#"<rect class="{class}" x="{left:.1}" y="{top:.1}" width="{w:.1}" height="{h:.1}"/>"#);
    }

    /// Adds a vertical line at `x`, labelled with `words`.
    pub fn mark(&mut self, x: f64, words: &str) {
        let (at, bottom) = (self.x(x), self.bottom());
        let anchor = match (at - LEFT) / (self.size.0 - LEFT - RIGHT) {
            share if share < 0.15 => "start",
            share if share > 0.85 => "end",
            _ => "mid",
        };
        let _ = write!(self.body, r#"<path class="mark" d="M{at:.1} {ABOVE}V{bottom}"/>"#);
        let _ = writeln!(self.body, r#"<text x="{at:.1}" y="10" class="found {anchor}">{}</text>"#, escape(words));
    }

    /// Adds `svg` to the drawing.
    pub fn put(&mut self, svg: &str) {
        self.body.push_str(svg);
    }

    /// Returns the plot as SVG with the alternative text `words`.
    pub fn finish(self, class: &str, words: &str) -> String {
        let (w, h) = self.size;
        let words = escape(words);
        format!(
            "<svg class=\"plot {class}\" viewBox=\"0 0 {w} {h}\" role=\"img\" aria-label=\"{words}\">\n{}</svg>\n",
            self.body
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_escaped_and_points_outside_are_moved_to_the_edge() {
        let (x, y) = (Axis::round(-4.0, 6.0, 5, "x, stops"), Axis::round(0.0, 0.5, 5, "y"));
        let figure = Figure::new((400.0, 200.0), 0.0, x, y);
        assert_eq!((figure.x(-4.0), figure.x(6.0), figure.y(0.0)), (LEFT, 400.0 - RIGHT, 200.0 - BELOW));
        assert_eq!((figure.x(99.0), figure.y(9.0)), (400.0 - RIGHT, ABOVE));
        let svg = figure.finish("", "a < b");
        assert!(svg.contains("x, stops") && svg.contains("a &lt; b") && svg.contains(">0.1<"));
    }
}
