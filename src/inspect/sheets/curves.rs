//! Curves: the fraction of pixels that differ between two bitmaps, plotted over rotation and shift.
//!
//! In: [`XorCurves`]. Out: a drawing of three plots with the same vertical scale; the motion is marked in each. Cost:
//! plotting some hundred numbers. Source: the thesis that hdralign is based on plots the XOR count over the angle. Here
//! the count is divided by the number of compared pixels.

use super::layout::{Entry, Mark, Page, TEXT};
use crate::align::diagnostics::{Curve, XorCurves};
use crate::draw::plot::{Axis, Plot};
use crate::draw::svg::{Anchor, Area, Colour, Drawing, Path, Pen};

const CURVE: Colour = Colour(0, 114, 178);
const FOUND: Colour = Colour(213, 94, 0);

/// Width of a plot inside its axes, in pixels.
const WIDTH: f64 = 400.0;
/// Height of a plot inside its axes, in pixels.
const HEIGHT: f64 = 330.0;
/// Space to the left of each plot for the vertical axis, in pixels.
const LEFT: f64 = 76.0;
/// Space below each plot for the horizontal axis, in pixels.
const BELOW: f64 = 62.0;
/// Space above each plot for the value of the marked motion, in pixels.
const ABOVE: f64 = 30.0;
/// Distance between plots, in pixels.
const GAP: f64 = 26.0;

/// Draws `curves`. `placed` is true if their centre is the motion of the alignment, and false if it is the motion for
/// which the bitmaps match best.
pub(in crate::inspect) fn draw(title: &str, curves: &XorCurves, placed: bool) -> Drawing {
    let [dx, dy, angle] = curves.centre.map(|v| v + 0.0);
    let plots = [
        (&curves.by_angle, "rotation, degrees", angle, format!("{angle:.3}°")),
        (&curves.by_dx, "shift to the right, px", dx, format!("{dx:.2} px")),
        (&curves.by_dy, "shift down, px", dy, format!("{dy:.2} px")),
    ];
    let found = if placed {
        "the alignment"
    } else {
        "the motion for which the bitmaps match best; it is not used, because the frame is rejected or excluded"
    };
    let legend = [
        Entry { mark: Mark::Patch, colour: CURVE, words: "differing pixels".into() },
        Entry { mark: Mark::Patch, colour: FOUND, words: found.into() },
    ];
    let notes = format!(
        "{:.2} % of the compared pixels differ if the frame is not moved, and {:.2} % if it is moved as marked. Each curve \
         varies one parameter and keeps the other two. Positions are rounded to whole pixels of the bitmaps.",
        100.0 * curves.before,
        100.0 * curves.after
    );
    let size = (3.0 * (LEFT + WIDTH) + 2.0 * GAP, ABOVE + HEIGHT + BELOW);
    let mut page = Page::new(title, &legend, size, &notes);
    let shares = plots.iter().flat_map(|(curve, ..)| &curve.share).copied().chain([curves.before]);
    let up = Axis::round(0.0, 100.0 * shares.fold(0.005, f64::max), 6, "differing pixels, %");
    for (i, (curve, name, at, found)) in plots.iter().enumerate() {
        let x = page.corner.0 + i as f64 * (LEFT + WIDTH + GAP) + LEFT;
        let area = Area { x, y: page.corner.1 + ABOVE, width: WIDTH, height: HEIGHT };
        draw_plot(&mut page.drawing, area, curve, (name, &up), (*at, found));
    }
    page.drawing
}

/// Plots `curve` over the quantity `name`. The value `at` of the motion is marked and has the label `found`.
fn draw_plot(page: &mut Drawing, area: Area, curve: &Curve, (name, up): (&str, &Axis), (at, found): (f64, &str)) {
    let (Some(first), Some(last)) = (curve.at.first(), curve.at.last()) else { return };
    let plot = Plot { area, x: Axis::within(*first, *last, 6, name), y: up.clone() };
    plot.draw_axes(page);
    let mut line = Path::default();
    line.line((plot.x(at), area.y), (plot.x(at), plot.bottom()));
    page.stroke_dashed(&line, Pen { colour: FOUND, width: 1.8, opacity: 1.0 });
    page.text((plot.x(at), area.y - 9.0), TEXT, Anchor::Middle, FOUND, found);
    let points = curve.at.iter().zip(&curve.share).map(|(&at, &share)| (at, 100.0 * share));
    let curve = plot.curve(points);
    page.clipped(area, |inside| inside.stroke(&curve, Pen { colour: CURVE, width: 2.0, opacity: 1.0 }));
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert!(draw("t", &curves, false).to_svg().contains("rejected"));
    }
}
