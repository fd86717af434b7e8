//! Plots: axes with round ticks, and the positions of values along them.
//!
//! In: ranges of numbers. Out: ticks with labels; positions on a page. Cost: negligible.

use super::svg::{Anchor, Area, Colour, Drawing, Path, Pen};
use std::f64::consts::LOG2_10;

/// Text size of the labels of ticks, in pixels.
const TICK: f64 = 15.0;
/// Text size of the names of axes, in pixels.
const NAME: f64 = 17.0;

/// An axis of a plot.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// Value at the lower end of the axis.
    pub from: f64,
    /// Value at the upper end of the axis.
    pub to: f64,
    /// Values of the ticks, with their labels.
    pub ticks: Vec<(f64, String)>,
    /// Name of the axis, with the unit.
    pub name: String,
}

impl Axis {
    /// Creates an axis from `from` to `to`, extended to round numbers, with about `count` ticks.
    pub fn round(from: f64, to: f64, count: usize, name: &str) -> Self {
        let step = round_step(from, to, count);
        let (first, last) = ((from / step).floor(), (to / step).ceil());
        Axis { from: first * step, to: last * step, ticks: ticks(step, first, last), name: name.to_owned() }
    }

    /// Creates an axis exactly from `from` to `to`, with about `count` ticks at the round numbers in between.
    pub fn within(from: f64, to: f64, count: usize, name: &str) -> Self {
        let step = round_step(from, to, count);
        Axis { from, to, ticks: ticks(step, (from / step).ceil(), (to / step).floor()), name: name.to_owned() }
    }

    /// Creates an axis with ticks only at the numbers `at`, which are used as labels unchanged.
    pub fn at<const N: usize>(from: f64, to: f64, at: [usize; N], name: &str) -> Self {
        Axis { from, to, ticks: at.map(|v| (v as f64, v.to_string())).to_vec(), name: name.to_owned() }
    }

    /// Creates a logarithmic axis. `from` and `to` are log2 of the values at its ends; the ticks are at the powers of
    /// ten between these values.
    pub fn decades(from: f64, to: f64, name: &str) -> Self {
        let word = |d: i64| match d {
            -3..=5 => format!("{}", libm::exp10(d as f64)),
            _ => format!("1e{d}"),
        };
        let powers = (from / LOG2_10).ceil() as i64..=(to / LOG2_10).floor() as i64;
        Axis { from, to, ticks: powers.map(|d| (d as f64 * LOG2_10, word(d))).collect(), name: name.to_owned() }
    }

    /// Returns the position of a value: 0 at the lower end of the axis, 1 at the upper end.
    fn share(&self, v: f64) -> f64 {
        (v - self.from) / (self.to - self.from).max(1e-9)
    }
}

/// Returns the smallest round step that divides the range `from..to` into at most `count` parts.
fn round_step(from: f64, to: f64, count: usize) -> f64 {
    let rough = (to - from).max(1e-9) / count.max(1) as f64;
    let power = libm::exp10(libm::floor(libm::log10(rough)));
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= rough).unwrap_or(rough)
}

/// Returns the multiples of `step` from `first * step` to `last * step`. Their labels have as many decimals as the step
/// needs, and minus signs instead of hyphens.
fn ticks(step: f64, first: f64, last: f64) -> Vec<(f64, String)> {
    let is_whole = |v: f64| (v - v.round()).abs() < 1e-6;
    let decimals = (0..6u8).find(|d| is_whole(step * libm::exp10(f64::from(*d)))).unwrap_or(6).into();
    let word = |v: f64| format!("{:.*}", decimals, v + 0.0).replace('-', "\u{2212}");
    (first as i64..=last as i64).map(|i| i as f64 * step).map(|v| (v, word(v))).collect()
}

/// A plot: two axes and an area of a page.
#[derive(Debug, Clone, PartialEq)]
pub struct Plot {
    /// The area inside the axes, in pixels.
    pub area: Area,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
}

impl Plot {
    /// Returns the distance of the value `v` from the left of the page; outside of the area if `v` is not on the axis.
    pub fn x(&self, v: f64) -> f64 {
        self.area.x + self.x.share(v) * self.area.width
    }

    /// Returns the distance of the value `v` from the top of the page.
    pub fn y(&self, v: f64) -> f64 {
        self.bottom() - self.y.share(v) * self.area.height
    }

    /// Returns the distance of the lower edge of the area from the top of the page.
    pub fn bottom(&self) -> f64 {
        self.area.y + self.area.height
    }

    /// Draws both axes: lines and labels at the ticks, the frame, and the names below and on the left.
    pub fn draw_axes(&self, page: &mut Drawing) {
        let (Area { x: left, y: top, width, height }, bottom) = (self.area, self.bottom());
        let mut grid = Path::default();
        for (v, words) in &self.x.ticks {
            grid.line((self.x(*v), top), (self.x(*v), bottom));
            page.text((self.x(*v), bottom + 20.0), TICK, Anchor::Middle, Colour::INK, words);
        }
        for (v, words) in &self.y.ticks {
            grid.line((left, self.y(*v)), (left + width, self.y(*v)));
            page.text((left - 8.0, self.y(*v) + 5.0), TICK, Anchor::End, Colour::INK, words);
        }
        page.stroke(&grid, Pen { colour: Colour::GRID, width: 1.0, opacity: 1.0 });
        page.outline(self.area, Pen { colour: Colour::FAINT, width: 1.0, opacity: 1.0 });
        page.text((left + width / 2.0, bottom + 46.0), NAME, Anchor::Middle, Colour::INK, &self.x.name);
        page.text_upwards((left - 54.0, top + height / 2.0), NAME, Colour::INK, &self.y.name);
    }

    /// Returns the curve through `points`.
    pub fn curve(&self, points: impl Iterator<Item = (f64, f64)>) -> Path {
        let mut path = Path::default();
        path.points(&points.map(|(x, y)| (self.x(x), self.y(y))).collect::<Vec<_>>());
        path
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(axis: &Axis) -> Vec<&str> {
        axis.ticks.iter().map(|t| t.1.as_str()).collect()
    }

    #[test]
    fn round_axis_encloses_its_range_and_ticks_are_round() {
        let axis = Axis::round(-3.1, 4.2, 4, "x, stops");
        assert_eq!((axis.from, axis.to), (-4.0, 6.0));
        assert_eq!(words(&axis), ["\u{2212}4", "\u{2212}2", "0", "2", "4", "6"]);
        assert_eq!(words(&Axis::round(0.0, 23.0, 6, "x")), ["0", "5", "10", "15", "20", "25"]);
        let fine = Axis::round(0.0, 0.35, 6, "x");
        assert_eq!(words(&fine)[..3], ["0.0", "0.1", "0.2"]);
        assert!(fine.to >= 0.35);
        let inner = Axis::within(-3.1, 4.2, 4, "x");
        assert_eq!((inner.from, inner.ticks.len(), inner.ticks[0].0), (-3.1, 4, -2.0));
    }

    #[test]
    fn logarithmic_axis_has_ticks_at_powers_of_ten() {
        let axis = Axis::decades(-4.0, 24.0, "x");
        assert_eq!(words(&axis), ["0.1", "1", "10", "100", "1000", "10000", "100000", "1e6", "1e7"]);
        assert!((axis.ticks[2].0 - libm::log2(10.0)).abs() < 1e-12);
    }

    #[test]
    fn values_are_between_the_axes() {
        let area = Area { x: 50.0, y: 10.0, width: 200.0, height: 100.0 };
        let plot = Plot { area, x: Axis::round(-4.0, 6.0, 5, "x"), y: Axis::round(0.0, 0.5, 5, "y") };
        assert_eq!([plot.x(-4.0), plot.x(1.0), plot.x(6.0), plot.x(8.0)], [50.0, 150.0, 250.0, 290.0]);
        assert_eq!((plot.y(0.0), plot.y(0.5)), (110.0, 10.0));
        let mut page = Drawing::new(300, 200, "t");
        plot.draw_axes(&mut page);
        let svg = page.to_svg();
        assert!(svg.contains(">\u{2212}4<") && svg.contains(">0.5<") && svg.contains(">y<"), "{svg}");
    }
}
