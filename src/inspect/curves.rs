//! Curves: the share of pixels that differ between two bitmaps against rotation and shift.
//!
//! In: [`XorCurves`]. Out: a drawing of three plots with one scale, the motion found marked in each. Cost: some hundred numbers. Source:
//! the thesis's plot of the XOR count against the angle, made a share of what can be compared.

use super::drawing::{Anchor, Area, Colour, Drawing, Path, Pen};
use super::page::{Entry, Mark, Page, TEXT};
use crate::align::diagnostics::{Curve, XorCurves};

const CURVE: Colour = Colour(0, 114, 178);
const FOUND: Colour = Colour(213, 94, 0);

/// A plot, and the room for its axes, in pixels.
const WIDTH: f64 = 400.0;
const HEIGHT: f64 = 330.0;
const LEFT: f64 = 76.0;
const BELOW: f64 = 62.0;
const ABOVE: f64 = 30.0;
const GAP: f64 = 26.0;
const SMALL: f64 = 15.0;

/// One plot.
struct Plot<'a> {
    curve: &'a Curve,
    /// What is along the axis, with its unit.
    axis: &'static str,
    /// What was found, a number with its unit.
    found: String,
    at: f64,
}

/// `curves`; `placed` says whether they are about the alignment's motion, or about the bitmaps' own.
pub(super) fn draw(title: &str, curves: &XorCurves, placed: bool) -> Drawing {
    let [dx, dy, angle] = curves.centre.map(|v| v + 0.0);
    let plots = [
        Plot { curve: &curves.by_angle, axis: "rotation, degrees", found: format!("{angle:.3}°"), at: angle },
        Plot { curve: &curves.by_dx, axis: "shift to the right, px", found: format!("{dx:.2} px"), at: dx },
        Plot { curve: &curves.by_dy, axis: "shift down, px", found: format!("{dy:.2} px"), at: dy },
    ];
    let found = if placed { "the alignment" } else { "the bitmaps' own best; the frame was left out" };
    let legend = [
        Entry { mark: Mark::Patch, colour: CURVE, words: "differing pixels".into() },
        Entry { mark: Mark::Patch, colour: FOUND, words: found.into() },
    ];
    let notes = format!(
        "Unmoved {:.2} % of the pixels that count in both bitmaps differ, under the motion {:.2} %. Each curve varies one number and keeps \
         the two others. To the nearest pixel of the level.",
        100.0 * curves.before,
        100.0 * curves.after
    );
    let size = (3.0 * (LEFT + WIDTH) + 2.0 * GAP, ABOVE + HEIGHT + BELOW);
    let mut page = Page::new(title, &legend, size, &notes);
    let shares = plots.iter().flat_map(|p| &p.curve.share).copied().chain([curves.before]);
    let ticks = ticks(0.0, 100.0 * shares.fold(0.005, f64::max), 6);
    for (i, plot) in plots.iter().enumerate() {
        let x = page.corner.0 + i as f64 * (LEFT + WIDTH + GAP) + LEFT;
        let area = Area { x, y: page.corner.1 + ABOVE, width: WIDTH, height: HEIGHT };
        draw_plot(&mut page.drawing, area, plot, &ticks);
    }
    page.drawing
}

fn draw_plot(page: &mut Drawing, area: Area, plot: &Plot, ticks_up: &[f64]) {
    let (Some(first), Some(last)) = (plot.curve.at.first(), plot.curve.at.last()) else { return };
    let top = ticks_up.last().copied().unwrap_or(1.0);
    let x = |v: f64| area.x + (v - first) / (last - first).max(1e-9) * area.width;
    let y = |percent: f64| area.y + area.height * (1.0 - percent / top);
    let (bottom, right) = (area.y + area.height, area.x + area.width);
    let along: Vec<f64> =
        ticks(*first, *last, 6).into_iter().filter(|t| *t >= first - 1e-9 && *t <= last + 1e-9).collect();
    let mut grid = Path::default();
    for &t in &along {
        grid.line((x(t), area.y), (x(t), bottom));
        page.text((x(t), bottom + 20.0), SMALL, Anchor::Middle, Colour::INK, &label(t, step(&along)));
    }
    for &t in ticks_up {
        grid.line((area.x, y(t)), (right, y(t)));
        page.text((area.x - 8.0, y(t) + 5.0), SMALL, Anchor::End, Colour::INK, &label(t, step(ticks_up)));
    }
    page.stroke(&grid, Pen { colour: Colour::GRID, width: 1.0, opacity: 1.0 });
    page.outline(area, Pen { colour: Colour::FAINT, width: 1.0, opacity: 1.0 });
    page.text((area.x + area.width / 2.0, bottom + 46.0), TEXT, Anchor::Middle, Colour::INK, plot.axis);
    page.text_upwards((area.x - 56.0, area.y + area.height / 2.0), TEXT, Colour::INK, "differing pixels, %");

    let mut found = Path::default();
    found.line((x(plot.at), area.y), (x(plot.at), bottom));
    page.stroke_dashed(&found, Pen { colour: FOUND, width: 1.8, opacity: 1.0 });
    page.text((x(plot.at), area.y - 9.0), TEXT, Anchor::Middle, FOUND, &plot.found);
    let points: Vec<(f64, f64)> =
        plot.curve.at.iter().zip(&plot.curve.share).map(|(&at, &share)| (x(at), y(100.0 * share))).collect();
    let mut curve = Path::default();
    curve.points(&points);
    page.clipped(area, |inside| inside.stroke(&curve, Pen { colour: CURVE, width: 2.0, opacity: 1.0 }));
}

/// Round numbers from `from` down to `to` up, about `count` of them.
pub(super) fn ticks(from: f64, to: f64, count: usize) -> Vec<f64> {
    let rough = (to - from).max(1e-9) / count as f64;
    let power = libm::exp10(libm::floor(libm::log10(rough)));
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().map(|m| m * power).find(|s| *s >= rough).unwrap_or(rough);
    let (first, last) = ((from / step).floor() as i64, (to / step).ceil() as i64);
    (first..=last).map(|i| i as f64 * step).collect()
}

/// How far it is from one tick to the next.
pub(super) fn step(ticks: &[f64]) -> f64 {
    if ticks.len() < 2 { 1.0 } else { ticks[1] - ticks[0] }
}

/// `tick` with as many decimals as its step needs.
pub(super) fn label(tick: f64, step: f64) -> String {
    let decimals = (0..6).find(|d| {
        let scaled = step * libm::exp10(f64::from(*d));
        (scaled - scaled.round()).abs() < 1e-6
    });
    format!("{:.*}", decimals.unwrap_or(6) as usize, tick + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_enclose() {
        assert_eq!(ticks(0.0, 23.0, 6), [0.0, 5.0, 10.0, 15.0, 20.0, 25.0]);
        assert_eq!(ticks(-5.0, 5.0, 6), [-6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0]);
        let fine = ticks(0.0, 0.5, 6);
        assert!((fine[1] - 0.1).abs() < 1e-12 && *fine.last().unwrap() >= 0.5);
        assert_eq!([label(0.30000000000000004, 0.1), label(20.0, 5.0), label(-0.0, 0.5)], ["0.3", "20", "0.0"]);
    }

    #[test]
    fn all_axes_have_units_and_the_found_motion_is_named() {
        let curve = |at: &[f64]| Curve { at: at.to_vec(), share: at.iter().map(|t| 0.01 + 0.02 * t.abs()).collect() };
        let curves = XorCurves {
            centre: [3.25, -1.5, 0.123],
            before: 0.2,
            after: 0.01,
            by_angle: curve(&[-5.0, -1.0, 0.0, 1.0, 5.0]),
            by_dx: curve(&[-7.0, 3.25, 13.0]),
            by_dy: curve(&[-11.0, -1.5, 8.0]),
        };
        let svg = draw("t", &curves, true).to_svg();
        for words in [
            "rotation, degrees",
            "px",
            "differing pixels, %",
            "0.123°",
            "3.25 px",
            "-1.50 px",
            "20.00 %",
            "the alignment",
        ] {
            assert!(svg.contains(words), "{words}");
        }
        assert!(draw("t", &curves, false).to_svg().contains("left out"));
    }
}
