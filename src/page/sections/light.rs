//! Light: what codes mean, what the scene holds and which frame covers what of it, and which frame the result is made of.
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

/// Codes between which a frame tells light well: below is noise, above is clipping.
const TELLING: (usize, usize) = (8, 248);
/// Stops below code 128 that are drawn at the most: code 0 is anybody's guess.
const DEEPEST: f64 = 12.0;
/// Pixels of the histogram's drawing for the range of each frame, and at the most for all.
const RANGE: f64 = 20.0;
/// Tails of the histogram with less than this share of the pixels are cut off.
const TAIL: f64 = 2e-5;

/// The histogram and the response; none where frames were only aligned.
pub(in crate::page) fn scene(page: &Page, report: &Report) -> Option<String> {
    let curve = page.curve.as_ref()?;
    let histogram = histogram(page, report, curve).unwrap_or_default();
    Some(format!("{histogram}{}", response(report, curve)))
}

/// Pixels against luminance in stops, and the range that each frame covers.
fn histogram(page: &Page, report: &Report, curve: &ResponseCurve) -> Option<String> {
    let (first, counts) = page.luminance.as_ref()?;
    let all: u64 = counts.iter().sum();
    let is_some = |n: &u64| *n as f64 > TAIL * all as f64;
    let (from, to) = (counts.iter().position(is_some)?, counts.iter().rposition(is_some)?);
    let per_stop = Page::PER_STOP as f64;
    let step = |i: usize| (*first + i as i64) as f64 / per_stop;
    // Radiance as it was before it was given its unit.
    let normalised = report.radiance.as_ref().and_then(|r| Some(r.unit_exposure_s? / r.reference_exposure));
    let unit = report.calibration.as_ref().map(|c| c.cd_m2_per_unit).or(normalised).map_or(0.0, libm::log2);
    let middle = match normalised {
        Some(factor) if factor != 1.0 => "luminance, stops over what gives the middle code at the exposure of the unit",
        _ => "luminance, stops over what gave the reference its middle code",
    };
    let stops = stops_over_reference(report);
    let tells = |code: usize, ev: f64| libm::log2(f64::from(curve.exposures(1)[code])) - ev + unit;
    let placed: Vec<usize> =
        (0..stops.len()).filter(|&i| report.frames[i].alignment.status.rejected_by().is_none()).collect();
    let ranges: Vec<(usize, f64, f64)> =
        placed.iter().map(|&i| (i, tells(TELLING.0, stops[i]), tells(TELLING.1, stops[i]))).collect();
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
            " {} of the pixels are clipped even in the shortest frame, {} black even in the longest: there the radiance is but a bound.",
            percent(m.all_clipped as f64 / pixels),
            percent(m.all_black as f64 / pixels)
        )
    });
    Some(format!(
        "<figure class=\"plots wide\">\n{}<figcaption><b>What the scene holds, and which frame covers it.</b> Above, \
         how many pixels have which luminance, in quarters of a stop. Below, for each frame (EV over the reference) \
         from where to where its codes {} to {} tell light. Every column should have a bar under it; one without is \
         noise or a guess. Between the bars there should be no gap.{bounds}</figcaption>\n</figure>\n",
        plot.finish("big", &words),
        TELLING.0,
        TELLING.1
    ))
}

/// What codes mean.
fn response(report: &Report, curve: &ResponseCurve) -> String {
    let srgb = ResponseCurve::srgb();
    let stops = |ln: f64| ln / LN_2;
    let all = || (0..3).map(|c| curve.ln_exposure(c)).chain([srgb.ln_exposure(1)]);
    let low = all().map(|g| stops(g[1])).fold(f64::MAX, f64::min).max(-DEEPEST);
    let high = all().map(|g| stops(g[CODES - 1])).fold(f64::MIN, f64::max);
    let x = Axis::at(0.0, 255.0, [0, 64, 128, 192, 255], "code value");
    let mut plot =
        Figure::new((520.0, 340.0), 0.0, x, Axis::round(low, high, 8, "exposure, stops over that of code 128"));
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
    let fallback =
        fallback.map_or_else(String::new, |why| format!(" The curve asked for was not used: {}.", escape(why)));
    let svg = plot.finish(
        "",
        "The camera's response: exposure in stops against code, for red, green and blue, with the sRGB curve.",
    );
    format!(
        "<figure class=\"plots beside\">\n{svg}<figcaption><b>What a code means</b> to this camera, by \
         <code>{}</code>: <span class=\"key red\"></span> red <span class=\"key green\"></span> green <span \
         class=\"key bluechannel\"></span> blue; dashed the sRGB curve, for comparison. The three should rise \
         smoothly and lie near each other; steps or crossings in the middle are the mark of a scene that does not \
         tell, and of exposures that are not what the files say.{fallback}</figcaption>\n</figure>\n",
        escape(model)
    )
}

/// Which frame gives what; none where frames were only aligned.
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
        let caption = format!("<b>{name}</b> gives {}", percent(*share));
        each += &figure(picture, &format!("Where {} contributes.", frame.path), &caption);
    }
    let caption = "<b>Weights.</b> Each place in the colour of the frame that it is made of, mixed where it is made \
                   of several. Bright places should be of short exposures, dark ones of long ones. Sharp borders \
                   across a smooth surface mean exposures or a response that do not fit.";
    Some(format!(
        "<div class=\"shares\">\n{}<ul class=\"legend\">\n{legend}</ul>\n</div>\n\
         <details class=\"frame\">\n<summary><b>Frame by frame</b></summary>\n\
         <p class=\"intro\">White where the result is of this frame alone, black where it gives nothing.</p>\n\
         <div class=\"grid\">\n{each}</div>\n</details>\n",
        figure(map, "Which frame the result is made of, place by place.", caption)
    ))
}
