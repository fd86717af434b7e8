//! Histogram of the scene, camera response, and the contribution of each frame.
//!
//! In: a [`Page`] and its [`Report`]. Out: HTML. Cost: none.

use super::photographs::stops_over_reference;
use crate::draw::plot::Axis;
use crate::page::markup::{escape, figure, file_name, percent, signed};
use crate::page::plot::Figure;
use crate::page::{Page, frame_css};
use crate::report::Report;
use crate::response::{CODES, ResponseCurve};
use std::f64::consts::LN_2;
use std::fmt::Write;

/// Range of code values that a frame measures well: there is noise below it, and clipping above it.
const MEASURED: (usize, usize) = (8, 248);
/// Lowest exposure that is drawn, in stops below the exposure of code value 128. The exposure of code value 0 is not
/// known.
const DEEPEST: f64 = 12.0;
/// Height of the row that shows the range of one frame, in px of the drawing.
const RANGE: f64 = 20.0;
/// Steps at the ends of the histogram are not drawn if they contain at most this fraction of the pixels.
const TAIL: f64 = 2e-5;

/// Returns the histogram and the response, or `None` if the frames were only aligned.
pub(in crate::page) fn scene(page: &Page, report: &Report) -> Option<String> {
    let curve = page.curve.as_ref()?;
    let histogram = histogram(page, report, curve).unwrap_or_default();
    Some(format!("{histogram}{}", response(report, curve)))
}

/// Returns the histogram of the luminance in stops, with the range that each frame covers.
fn histogram(page: &Page, report: &Report, curve: &ResponseCurve) -> Option<String> {
    let (first, counts) = page.luminance.as_ref()?;
    let all: u64 = counts.iter().sum();
    let is_some = |n: &u64| *n as f64 > TAIL * all as f64;
    let (from, to) = (counts.iter().position(is_some)?, counts.iter().rposition(is_some)?);
    let per_stop = Page::PER_STOP as f64;
    let step = |i: usize| (*first + i as i64) as f64 / per_stop;
    // Exposure that defines the unit of radiance, divided by the exposure of the reference.
    let normalised = report.radiance.as_ref().and_then(|r| Some(r.unit_exposure_s? / r.reference_exposure));
    let unit = report.calibration.as_ref().map(|c| c.cd_m2_per_unit).or(normalised).map_or(0.0, libm::log2);
    let middle = match normalised {
        Some(factor) if factor != 1.0 => {
            "luminance, stops relative to 1.0 (pixel value 128 at the exposure of --normalize)"
        }
        _ => "luminance, stops relative to 1.0 (pixel value 128 in the reference frame)",
    };
    let stops = stops_over_reference(report);
    let measured = |code: usize, ev: f64| libm::log2(f64::from(curve.exposures(1)[code])) - ev + unit;
    let placed: Vec<usize> =
        (0..stops.len()).filter(|&i| report.frames[i].alignment.status.rejected_by().is_none()).collect();
    let ranges: Vec<(usize, f64, f64)> =
        placed.iter().map(|&i| (i, measured(MEASURED.0, stops[i]), measured(MEASURED.1, stops[i]))).collect();
    let (low, high) = (step(from) - 0.5, step(to + 1) + 0.5);
    let x = match report.calibration {
        Some(_) => Axis::decades(low, high, "luminance, cd/m²"),
        None => Axis::within(low, high, 9, middle),
    };
    let most = counts.iter().max().copied().unwrap_or(1) as f64 / all as f64 * 100.0;
    let more = RANGE * ranges.len() as f64 + 12.0;
    let mut plot = Figure::new((760.0, 260.0 + more), more, x, Axis::round(0.0, most, 4, "pixels, %"));
    for (i, n) in counts.iter().enumerate().take(to + 1).skip(from) {
        plot.bar("column", (step(i), 1.0 / per_stop), *n as f64 / all as f64 * 100.0);
    }
    let bottom = plot.bottom();
    let mut bars = String::new();
    for (row, (i, dark, bright)) in ranges.iter().enumerate() {
        let (left, right) = (plot.x(*dark), plot.x(*bright));
        let y = bottom + 10.0 + RANGE * row as f64;
        let name = escape(&report.frames[*i].path);
        let _ = write!(
            bars,
            "<rect class=\"range\" x=\"{left:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\" rx=\"3\" \
             fill=\"{}\"><title>{name}</title></rect>",
            (right - left).max(1.0),
            RANGE - 6.0,
            frame_css(*i, stops.len())
        );
        let _ = writeln!(bars, "<text x=\"40\" y=\"{:.1}\" class=\"end\">{}</text>", y + 11.0, signed(stops[*i], 1));
    }
    plot.put(&bars);
    let words = format!(
        "Histogram of the result's luminance over {:.0} stops, and below it the range that each of {} frames covers.",
        step(to + 1) - step(from),
        ranges.len()
    );
    let bounds = report.radiance.as_ref().map_or_else(String::new, |m| {
        let pixels = (report.crop.width_px * report.crop.height_px).max(1) as f64;
        format!(
            " {} of the pixels are clipped even in the frame with the shortest exposure, and {} are black even in the one with the longest. There the radiance is only known to be above or below a limit.",
            percent(m.all_clipped as f64 / pixels),
            percent(m.all_black as f64 / pixels)
        )
    });
    Some(format!(
        "<figure class=\"plots wide\">\n{}<figcaption><b>Brightness range of the scene, and the frames that cover it.</b> \
         Above: the luminance of the pixels, in quarters of a stop. Below: the range that each frame (EV relative to the \
         reference) measures with pixel values {} to {}. Every column should have a bar below it; without one the \
         values are unreliable. There should be no gap between the bars.{bounds}</figcaption>\n</figure>\n",
        plot.finish("big", &words),
        MEASURED.0,
        MEASURED.1
    ))
}

/// Returns the plot of the camera response.
fn response(report: &Report, curve: &ResponseCurve) -> String {
    let srgb = ResponseCurve::srgb();
    let stops = |ln: f64| ln / LN_2;
    let all = || (0..3).map(|c| curve.ln_exposure(c)).chain([srgb.ln_exposure(1)]);
    let low = all().map(|g| stops(g[1])).fold(f64::MAX, f64::min).max(-DEEPEST);
    let high = all().map(|g| stops(g[CODES - 1])).fold(f64::MIN, f64::max);
    let x = Axis::at(0.0, 255.0, [0, 64, 128, 192, 255], "pixel value");
    let mut plot = Figure::new(
        (520.0, 340.0),
        0.0,
        x,
        Axis::round(low, high, 8, "exposure in stops; 0: mean of red, green and blue at pixel value 128"),
    );
    let points = |g: &[f64; CODES]| {
        let deep = |z: &usize| stops(g[*z]) >= -DEEPEST;
        (0..CODES).filter(deep).map(|z| (z as f64, stops(g[z]))).collect::<Vec<_>>()
    };
    plot.curve("srgb", points(srgb.ln_exposure(1)).into_iter());
    for (c, class) in ["red", "green", "blue"].iter().enumerate() {
        plot.curve(class, points(curve.ln_exposure(c)).into_iter());
    }
    let model = report.response.as_ref().map_or("", |r| r.model);
    let fallback = report.response.as_ref().and_then(|r| r.fallback.as_ref());
    let fallback = fallback
        .map_or_else(String::new, |why| format!(" The requested response model was not used: {}.", escape(why)));
    let svg = plot.finish(
        "",
        "The camera response: exposure in stops, plotted over the pixel value, for red, green and blue, with the sRGB curve.",
    );
    format!(
        "<figure class=\"plots beside\">\n{svg}<figcaption><b>Camera response</b>, model \
         <code>{}</code>: <span class=\"key red\"></span> red <span class=\"key green\"></span> green <span \
         class=\"key bluechannel\"></span> blue; dashed the sRGB curve, for comparison. The three curves should \
         rise smoothly and be close to each other. Steps or crossings in the middle mean that the scene has too few \
         tones, or that the exposures in the files are wrong.{fallback}</figcaption>\n</figure>\n",
        escape(model)
    )
}

/// Returns the contribution of each frame, or `None` if the frames were only aligned.
pub(in crate::page) fn shares(page: &Page, report: &Report) -> Option<String> {
    let map = page.shares.as_ref()?;
    let count = page.frames.len();
    let mut legend = String::new();
    let mut each = String::new();
    for (i, (frame, shown)) in report.frames.iter().zip(&page.frames).enumerate() {
        let Some((share, picture)) = &shown.share else { continue };
        let name = file_name(&frame.path);
        let colour = frame_css(i, count);
        let _ = writeln!(
            legend,
            "<li style=\"--own:{colour};--share:{:.1}%\"><span class=\"swatch\"></span><span>{name}</span> \
             <b class=\"n\">{}</b><i></i></li>",
            100.0 * share,
            percent(*share)
        );
        let caption = format!("<b>{name}</b> contributes {}", percent(*share));
        each += &figure(picture, &format!("Where {} contributes.", frame.path), &caption);
    }
    let caption = "<b>Contribution of each frame.</b> Each pixel has the colour of the frame it comes from, or a \
                   mixture. Bright areas should come from short exposures, dark areas from long ones. Sharp borders \
                   across a smooth surface mean that exposures or response are wrong.";
    Some(format!(
        "<div class=\"shares\">\n{}<ul class=\"legend\">\n{legend}</ul>\n</div>\n\
         <details class=\"frame\">\n<summary><b>Frame by frame</b></summary>\n\
         <p class=\"intro\">White: the result comes from this frame alone. Black: the frame does not contribute.</p>\n\
         <div class=\"grid\">\n{each}</div>\n</details>\n",
        figure(map, "Map of the frames that the result comes from.", caption)
    ))
}
