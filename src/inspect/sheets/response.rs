//! Draws the response as a plot: the exposure in stops (vertical) over the code value (horizontal).
//!
//! In: a [`ResponseCurve`], and the samples from which it was recovered. Out: a drawing, and its encoding as SVG or
//! PNG, which is chosen by the extension of the file. Cost: drawing some thousand dots, and 0.1 s for a PNG file.
//! Source: figure 7 of Debevec & Malik 1997, with the axes exchanged.

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

/// The colours of the channels. They can be distinguished with red-green colour blindness: vermilion, green and blue
/// of Okabe & Ito.
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
/// Largest number of samples (points of the scene) that are drawn for each channel.
const DOTS: usize = 600;
/// The plot shows exposures down to this many stops below code value 128. It needs a limit, because the exposure of
/// code value 0 is not known.
const DEEPEST: f64 = 14.0;

/// Draws `curve` and, if there are any, the `samples` from which it was recovered. `title` names the camera.
pub fn draw(title: &str, curve: &ResponseCurve, samples: &Drawn, notes: &str) -> Drawing {
    let mut legend: Vec<Entry> =
        CHANNELS.iter().map(|&(colour, name)| Entry { mark: Mark::Patch, colour, words: name.into() }).collect();
    legend.push(Entry { mark: Mark::Patch, colour: SRGB, words: "sRGB (dashed), for comparison".into() });
    let mut page = Page::new(title, &legend, (LEFT + WIDTH, ABOVE + HEIGHT + BELOW), notes);
    let area = Area { x: page.corner.0 + LEFT, y: page.corner.1 + ABOVE, width: WIDTH, height: HEIGHT };

    let stops = |ln: f64| ln / LN_2;
    let srgb = ResponseCurve::srgb();
    let lines = (0..3).map(|c| curve.ln_exposure(c)).chain([srgb.ln_exposure(1)]);
    // The vertical axis starts at the exposure of code value 1, but at most `DEEPEST` stops below code value 128.
    let (low, high) = lines.fold((f64::MAX, f64::MIN), |(low, high), g| (low.min(g[1]), high.max(g[CODES - 1])));
    let up = Axis::round(
        stops(low).max(-DEEPEST),
        stops(high),
        10,
        "exposure in stops; 0: mean of red, green and blue at code value 128",
    );
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

/// Returns the dots of `sample`, a point of the scene: one pair for each frame that shows it. The first number is the
/// frame's code value there. The second is ln(E t), where E is the radiance of the point that agrees best with the
/// response `g`, and t is the exposure time of the frame.
fn placed<'a>(sample: &'a Sample, g: &'a [f64; CODES]) -> impl Iterator<Item = (f64, f64)> + 'a {
    let weights = sample.views.iter().map(|v| (hat(v.code) + 1e-6, at(g, v.code) - v.ln_time));
    let (weight, sum) = weights.fold((0.0, 0.0), |(a, b), (w, ln_e)| (a + w, b + w * ln_e));
    sample.views.iter().map(move |v| (v.code, sum / weight + v.ln_time))
}

/// A function that encodes a drawing as the content of a file. If this is not possible, it returns the reason.
pub type Encode = fn(&Drawing) -> std::result::Result<Vec<u8>, String>;

/// Returns the encoder for the file `path`. It depends on the extension, in upper or lower case.
///
/// # Errors
/// [`Error::UnknownExtension`] if the extension is neither svg nor png.
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
/// [`Error::UnknownExtension`]; [`Error::Write`] if the drawing cannot be encoded.
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
        for words in [
            "Acme &lt;One&gt;",
            "code value",
            "exposure in stops; 0: mean of red, green and blue at code value 128",
            "sRGB",
            "a note",
        ] {
            assert!(svg.contains(words), "{words}");
        }
        let png = encode(&drawing, FilePath::new("a.PNG")).unwrap();
        let picture = image::load_from_memory(&png).unwrap().to_rgb8();
        assert_eq!((picture.width() as usize, picture.height() as usize), (drawing.width(), drawing.height()));
        // The curves of the three channels coincide. The blue curve is drawn last, so it covers the others.
        assert!(picture.pixels().filter(|p| p.0[2] > 130 && p.0[0] < 90).count() > 500);
        assert!(encode(&drawing, FilePath::new("a.pdf")).is_err());
    }
}
