//! Plots: curves and bars in the page's own colours, so that they are right in the light and in the dark.
//!
//! In: numbers. Out: inline SVG whose strokes, fills and letters are classes of the page's style sheet. Cost: some
//! bytes a point. Source: SVG 2
//! (W3C), chapters 9 (paths) and 11 (text).

use super::markup::escape;
use std::fmt::Write;

/// One axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Axis {
    pub from: f64,
    pub to: f64,
    /// Where there are lines, and what stands there; nothing where it is empty.
    pub ticks: Vec<(f64, String)>,
    /// What it is, with its unit.
    pub name: String,
}

impl Axis {
    /// From `from` to `to`, widened to round numbers, with about `count` ticks.
    pub fn round(from: f64, to: f64, count: usize, name: &str) -> Self {
        let step = round_step(from, to, count);
        let (first, last) = ((from / step).floor() as i64, (to / step).ceil() as i64);
        Axis { from: first as f64 * step, to: last as f64 * step, ..Axis::exact(from, to, count, name, (first, last)) }
    }

    /// From `from` to `to` as they are, with ticks at the round numbers between.
    pub fn within(from: f64, to: f64, count: usize, name: &str) -> Self {
        let step = round_step(from, to, count);
        let inner = ((from / step).ceil() as i64, (to / step).floor() as i64);
        Axis::exact(from, to, count, name, inner)
    }

    fn exact(from: f64, to: f64, count: usize, name: &str, (first, last): (i64, i64)) -> Self {
        let step = round_step(from, to, count);
        let decimals = (0..6).find(|d| {
            let scaled = step * libm::exp10(f64::from(*d));
            (scaled - scaled.round()).abs() < 1e-6
        });
        let label = |v: f64| format!("{:.*}", decimals.unwrap_or(6) as usize, v + 0.0).replace('-', "\u{2212}");
        let ticks = (first..=last).map(|i| i as f64 * step).map(|v| (v, label(v))).collect();
        Axis { from, to, ticks, name: name.to_owned() }
    }
}

/// The round number of which about `count` lie between.
fn round_step(from: f64, to: f64, count: usize) -> f64 {
    let rough = (to - from).max(1e-9) / count.max(1) as f64;
    let power = libm::exp10(libm::floor(libm::log10(rough)));
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= rough).unwrap_or(rough)
}

/// Room around a plot, in its own pixels.
const LEFT: f64 = 46.0;
const RIGHT: f64 = 12.0;
const ABOVE: f64 = 14.0;
const BELOW: f64 = 42.0;

/// A plot that is being drawn.
#[derive(Debug, Clone)]
pub(super) struct Plot {
    size: (f64, f64),
    /// Room below the axis for more.
    more: f64,
    x: Axis,
    y: Axis,
    body: String,
}

impl Plot {
    /// Of `size` pixels, with `more` below for what else there is along the x axis.
    pub fn new(size: (f64, f64), more: f64, x: Axis, y: Axis) -> Self {
        let mut plot = Plot { size, more, x, y, body: String::new() };
        plot.axes();
        plot
    }

    /// Where `v` lies from the left.
    pub fn x(&self, v: f64) -> f64 {
        let share = (v - self.x.from) / (self.x.to - self.x.from).max(1e-9);
        LEFT + share.clamp(0.0, 1.0) * (self.size.0 - LEFT - RIGHT)
    }

    /// Where `v` lies from the top.
    pub fn y(&self, v: f64) -> f64 {
        let share = (v - self.y.from) / (self.y.to - self.y.from).max(1e-9);
        let bottom = self.bottom();
        bottom - share.clamp(0.0, 1.0) * (bottom - ABOVE)
    }

    /// The lower end of the plot proper.
    pub fn bottom(&self) -> f64 {
        self.size.1 - BELOW - self.more
    }

    fn axes(&mut self) {
        let (right, bottom) = (self.size.0 - RIGHT, self.bottom());
        let mut out = String::new();
        for (v, words) in &self.y.ticks {
            let y = self.y(*v);
            let _ = write!(out, r#"<path class="grid" d="M{LEFT} {y:.1}H{right}"/>"#);
            let _ = write!(out, r#"<text x="{}" y="{:.1}" class="end">{}</text>"#, LEFT - 6.0, y + 4.0, escape(words));
        }
        for (v, words) in &self.x.ticks {
            let x = self.x(*v);
            let _ = write!(out, r#"<path class="grid" d="M{x:.1} {ABOVE}V{bottom}"/>"#);
            let y = bottom + self.more + 16.0;
            let _ = write!(out, r#"<text x="{x:.1}" y="{y:.1}" class="mid">{}</text>"#, escape(words));
        }
        let (middle, down) = ((LEFT + right) / 2.0, (ABOVE + bottom) / 2.0);
        let (x, y) = (escape(&self.x.name), escape(&self.y.name));
        let _ = write!(out, r#"<text x="{middle:.1}" y="{:.1}" class="mid name">{x}</text>"#, self.size.1 - 6.0);
        let _ = writeln!(out, r#"<text transform="translate(11 {down:.1}) rotate(-90)" class="mid name">{y}</text>"#);
        self.body.push_str(&out);
    }

    /// A curve through `points`, of the style sheet's `class`.
    pub fn curve(&mut self, class: &str, points: impl Iterator<Item = (f64, f64)>) {
        let mut path = String::new();
        for (x, y) in points.filter(|p| p.0.is_finite() && p.1.is_finite()) {
            let letter = if path.is_empty() { 'M' } else { 'L' };
            let _ = write!(path, "{letter}{:.1} {:.1}", self.x(x), self.y(y));
        }
        let _ = writeln!(self.body, r#"<path class="curve {class}" d="{path}"/>"#);
    }

    /// A bar from `x` to `x + width`, from the axis up to `y`.
    pub fn bar(&mut self, class: &str, (x, width): (f64, f64), y: f64) {
        let (left, right, top) = (self.x(x), self.x(x + width), self.y(y));
        let (w, h) = ((right - left - 0.6).max(0.4), self.bottom() - top);
        let _ =
            write!(self.body, r#"<rect class="{class}" x="{left:.1}" y="{top:.1}" width="{w:.1}" height="{h:.1}"/>"#);
    }

    /// A line down the plot at `x`, with words above it.
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

    /// What else there is, as SVG.
    pub fn put(&mut self, svg: &str) {
        self.body.push_str(svg);
    }

    /// The plot, with words for those who do not see it.
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
    fn axes_are_round_and_named_and_points_are_where_they_belong() {
        let axis = Axis::round(-3.1, 4.2, 4, "x, stops");
        assert_eq!((axis.from, axis.to), (-4.0, 6.0));
        let words: Vec<&str> = axis.ticks.iter().map(|t| t.1.as_str()).collect();
        assert_eq!(words, ["\u{2212}4", "\u{2212}2", "0", "2", "4", "6"]);
        let inner = Axis::within(-3.1, 4.2, 4, "x");
        assert_eq!((inner.from, inner.ticks.len(), inner.ticks[0].0), (-3.1, 4, -2.0));
        let plot = Plot::new((400.0, 200.0), 0.0, axis, Axis::round(0.0, 0.5, 5, "y"));
        assert_eq!((plot.x(-4.0), plot.x(6.0), plot.y(0.0)), (LEFT, 400.0 - RIGHT, 200.0 - BELOW));
        // What lies outside is at the edge.
        assert_eq!((plot.x(99.0), plot.y(9.0)), (400.0 - RIGHT, ABOVE));
        let svg = plot.finish("", "a < b");
        assert!(svg.contains("x, stops") && svg.contains("a &lt; b") && svg.contains(">0.1<"));
    }
}
