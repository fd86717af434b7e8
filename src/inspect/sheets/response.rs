//! The response as a plot: stops of exposure over code values.
//!
//! In: a [`ResponseCurve`] and the samples from which it was recovered. Out: a drawing, and its bytes as SVG or PNG, by
//! the extension of a file. Cost: some thousand dots; 0.1 s as PNG. Source: figure 7 of Debevec & Malik 1997, with
//! exchanged axes.

use super::layout::{Entry, Mark, Page};
use crate::draw::plot::{Axis, Plot};
use crate::draw::svg::{Area, Colour, Drawing, Path, Pen};
use crate::error::{Error, Result};
use crate::response::fit::at;
use crate::response::samples::{Drawn, Sample};
use crate::response::{CODES, MID, ResponseCurve, hat};
use std::f64::consts::LN_2;
use std::io;
use std::path::Path as FilePath;

/// Colours that can be distinguished with red-green colour blindness: Okabe & Ito's vermilion, green and blue.
const CHANNELS: [(Colour, &str); 3] =
    [(Colour(213, 94, 0), "red"), (Colour(0, 158, 115), "green"), (Colour(0, 114, 178), "blue")];
const SRGB: Colour = Colour(70, 70, 70);

/// Width of the plot inside its axes, in pixels.
const WIDTH: f64 = 860.0;
/// Height of the plot inside its axes, in pixels.
const HEIGHT: f64 = 560.0;
/// Space to the left of the plot for the vertical axis, in pixels.
const LEFT: f64 = 70.0;
/// Space below the plot for the horizontal axis, in pixels.
const BELOW: f64 = 60.0;
/// Space above the plot, in pixels.
const ABOVE: f64 = 10.0;
/// Largest number of samples (places of the scene) that are drawn per channel.
const DOTS: usize = 600;
/// Lowest exposure that is drawn, in stops below the exposure of code value 128; that of code value 0 is not known.
const DEEPEST: f64 = 14.0;

/// Draws `curve` with the `samples` from which it was recovered, if any; `title` names the camera.
pub fn draw(title: &str, curve: &ResponseCurve, samples: &Drawn, notes: &str) -> Drawing {
    let mut legend: Vec<Entry> =
        CHANNELS.iter().map(|&(colour, name)| Entry { mark: Mark::Patch, colour, words: name.into() }).collect();
    legend.push(Entry { mark: Mark::Patch, colour: SRGB, words: "sRGB (dashed), for comparison".into() });
    let mut page = Page::new(title, &legend, (LEFT + WIDTH, ABOVE + HEIGHT + BELOW), notes);
    let area = Area { x: page.corner.0 + LEFT, y: page.corner.1 + ABOVE, width: WIDTH, height: HEIGHT };

    let stops = |ln: f64| ln / LN_2;
    let srgb = ResponseCurve::srgb();
    let lines = (0..3).map(|c| curve.ln_exposure(c)).chain([srgb.ln_exposure(1)]);
    // The vertical axis starts at the exposure of code value 1, but not below DEEPEST.
    let (low, high) = lines.fold((f64::MAX, f64::MIN), |(low, high), g| (low.min(g[1]), high.max(g[CODES - 1])));
    let up = Axis::round(stops(low).max(-DEEPEST), stops(high), 10, "exposure in stops; 0 gives code value 128");
    let x = Axis::at(0.0, 255.0, [0, 32, 64, 96, MID, 160, 192, 224, 255], "code value");
    let plot = Plot { area, x, y: up };
    plot.draw_axes(&mut page.drawing);

    let curve_path = |g: &[f64; CODES]| plot.curve((0..CODES).map(|z| (z as f64, stops(g[z]))));
    page.drawing.clipped(area, |inside| {
        for (c, (colour, _)) in CHANNELS.iter().enumerate() {
            let mut dots = Path::default();
            let every = samples.channels[c].len().div_ceil(DOTS).max(1);
            for sample in samples.channels[c].iter().step_by(every) {
                for (code, ln_exposure) in placed(sample, curve.ln_exposure(c)) {
                    dots.circle((plot.x(code), plot.y(stops(ln_exposure))), 1.6);
                }
            }
            inside.fill(&dots, *colour, 0.3);
        }
        inside.stroke_dashed(&curve_path(srgb.ln_exposure(1)), Pen { colour: SRGB, width: 1.6, opacity: 1.0 });
        for (c, (colour, _)) in CHANNELS.iter().enumerate() {
            inside.stroke(&curve_path(curve.ln_exposure(c)), Pen { colour: *colour, width: 2.0, opacity: 0.9 });
        }
    });
    page.drawing
}

/// Returns a pair for each frame that shows the place `sample`: the frame's code value there, and ln(E dt). E is the
/// radiance of the place that fits the response `g` best, and dt is the exposure time of the frame.
fn placed<'a>(sample: &'a Sample, g: &'a [f64; CODES]) -> impl Iterator<Item = (f64, f64)> + 'a {
    let weights = sample.views.iter().map(|v| (hat(v.code) + 1e-6, at(g, v.code) - v.ln_time));
    let (weight, sum) = weights.fold((0.0, 0.0), |(a, b), (w, ln_e)| (a + w, b + w * ln_e));
    sample.views.iter().map(move |v| (v.code, sum / weight + v.ln_time))
}

/// A function that encodes a drawing as the content of a file, or returns the reason why this is not possible.
pub type Encode = fn(&Drawing) -> std::result::Result<Vec<u8>, String>;

/// Returns the encoder for the file `path`, by its extension in upper or lower case.
///
/// # Errors
/// [`Error::UnknownExtension`].
pub fn format(path: &FilePath) -> Result<Encode> {
    match path.extension().unwrap_or_default().to_string_lossy().to_lowercase().as_str() {
        "svg" => Ok(|drawing| Ok(drawing.to_svg().into_bytes())),
        "png" => Ok(Drawing::to_png),
        _ => Err(Error::UnknownExtension { path: path.to_owned(), known: ".svg, .png" }),
    }
}

/// Encodes `drawing` as the content of the file `path`.
///
/// # Errors
/// [`Error::UnknownExtension`]; [`Error::Write`] if it cannot be drawn.
pub fn encode(drawing: &Drawing, path: &FilePath) -> Result<Vec<u8>> {
    let failed = |reason: String| Error::Write { path: path.to_owned(), source: io::Error::other(reason) };
    format(path)?(drawing).map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::response::samples::View;

    #[test]
    fn axes_are_named_and_the_curve_is_where_its_samples_are() {
        let curve = ResponseCurve::srgb();
        let view = |code: usize| View { code: code as f64, ln_time: curve.ln_exposure(0)[code] };
        let sample = Sample { views: vec![view(60), view(200)] };
        for (code, ln_exposure) in placed(&sample, curve.ln_exposure(0)) {
            assert!((ln_exposure - curve.ln_exposure(0)[code as usize]).abs() < 1e-12);
        }
        let drawn = Drawn { channels: [vec![sample], Vec::new(), Vec::new()], black: [0.0; 3] };
        let drawing = draw("Acme <One>", &curve, &drawn, "a note");
        let svg = drawing.to_svg();
        for words in ["Acme &lt;One&gt;", "code value", "exposure in stops; 0 gives code value 128", "sRGB", "a note"] {
            assert!(svg.contains(words), "{words}");
        }
        let png = encode(&drawing, FilePath::new("a.PNG")).unwrap();
        let picture = image::load_from_memory(&png).unwrap().to_rgb8();
        assert_eq!((picture.width() as usize, picture.height() as usize), (drawing.width(), drawing.height()));
        // The curves of the three channels coincide; blue is drawn last, over the others.
        assert!(picture.pixels().filter(|p| p.0[2] > 130 && p.0[0] < 90).count() > 500);
        assert!(encode(&drawing, FilePath::new("a.pdf")).is_err());
    }
}
