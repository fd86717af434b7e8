//! hdralign's own operator: exposure fusion of exposures computed from the radiance.
//!
//! In: a scene. Out: its tones. Cost: about 2 us a cell, of which there are at most [`CELLS`], for ten exposures; three
//! interpolations a pixel. Source: [exposure fusion](super::fusion) (Mertens et al. 2007) applied to computed
//! exposures. Their number follows from the scene's highlights and the bracket's longest exposure; they are at most two
//! stops apart (for up to 30 stops) and free of moving objects. Radiance maps from other programs are handled the same
//! way.
//!
//! 1. The scene, on a grid, is exposed: from the exposure that shows its highlights to the longest of the bracket. The
//!    longest exposure that the photographer chose shows how bright the place is, so that night scenes stay dark.
//! 2. The exposures are fused; black and white are set near the darkest and brightest values of the fused picture.
//! 3. A contrast curve is applied. A power function darkens the picture where the longest exposure is dark, and brings
//!    radiance without photographs to the brightness of a photograph.
//! 4. Linear functions carry luminance from the grid to the pixels (`guide`). Colours are those of a photograph that
//!    shows the place at that luminance. When nothing is known of the photographs, the hue is that of the scene and
//!    chroma is never increased.
//!
//! The constants below were chosen by eye and in blind comparisons on sixteen photographed brackets.

pub(crate) mod photograph;

use super::display::luminance;
use super::fusion::{self, Channels};
use super::guide::Guide;
use super::overview::{Scene, quantile};
use super::settings::Setting;
use super::tones::{Curve, Tones};
use crate::bracket::colour::{linear_to_srgb, srgb_to_linear};
use crate::plane::Plane;
use crate::simd::log2;
use crate::tonemap::display::oklab;
use photograph::Photograph;

/// Settings of the operator.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Options {
    /// Mean code value of the picture, 0 to 1; the result is darker when the photographs were. `None`: that of the
    /// fused photographs, or 0.48 for radiance without known photographs.
    pub brightness: Option<f64>,
    /// Strength of the contrast curve: 0 is none, 1 raises contrast by half in the middle tones.
    pub contrast: f64,
    /// Factor on fine contrast: 1 is that of the scene.
    pub detail: f64,
    /// Factor on the chroma of photographs: 1 is as colourful as they are, 0 is grey.
    pub saturation: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { brightness: None, contrast: 0.2, detail: 1.0, saturation: 1.0 }
    }
}

impl Options {
    /// The settings by name.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::estimated(
                "brightness",
                (0.1, 0.9),
                &mut self.brightness,
                "mean pixel value of the picture, 0 to 1",
            ),
            Setting::number(
                "contrast",
                (0.0, 1.0),
                &mut self.contrast,
                "contrast added in the middle tones; 0 adds none",
            ),
            Setting::number("detail", (0.5, 3.0), &mut self.detail, "factor on the fine contrast of the scene"),
            Setting::saturation(&mut self.saturation),
        ]
    }
}

/// Largest number of cells of the grid.
pub const CELLS: usize = 1 << 17;

/// Code value (0 to 1) of the highlights in the shortest exposure, and the share of pixels below the highlights.
const LIGHTS: (f64, f64) = (0.9, 0.999);
/// Code value (0 to 1) of the shadows in the longest exposure when no photographs are known, and the share of pixels
/// below the shadows.
const SHADOWS: (f64, f64) = (0.4, 0.01);
/// Contrast and stops to white that are assumed when no photographs are known: typical of cameras.
const CAMERA: (f64, f64) = (1.4, 2.6);
/// Largest distance of two exposures, in stops.
const STEP: f64 = 2.0;
/// Largest number of exposures.
const MOST_EXPOSURES: usize = 16;

/// Shares of the cells of the fused picture that become black, and white.
const ENDS: (f64, f64) = (0.005, 0.003);
/// Code value of black as a share of that of the dark end of the fused picture, and the code value (0 to 1) to which
/// that of the dark end is limited.
const BLACK: (f32, f32) = (0.5, 0.15);
/// Smallest code value (0 to 1) of white.
const WHITE: f32 = 0.8;
/// Code value (0 to 1) above which the brightest values are compressed softly; fusion can exceed white, and darkening
/// everything would cost contrast.
const KNEE: f32 = 0.8;

/// Largest mean code value of the picture, as a share of that of the longest exposure.
const OF_LONGEST: f64 = 0.8;
/// Mean code value (0 to 1) when no photographs are known; the median of sixteen fused brackets is 0.46.
const BRIGHTNESS: f64 = 0.48;
/// Smallest and largest exponent used to reach the brightness.
const POWERS: (f64, f64) = (0.6, 1.4);

/// Added to luminances (relative to display white) before the logarithm: code value 6. Darker values get little weight
/// in the fit, and their colour cannot be distinguished from noise.
const DARKEST: f32 = 0.002;

/// Returns the tones of `scene`.
pub fn natural(scene: &Scene, options: &Options) -> Tones {
    let grid = scene.coarser(CELLS);
    let (contrast, white_stops) = scene.photographed.map_or(CAMERA, |p| (p.contrast, p.white_stops));
    let photograph = Photograph::new(contrast, white_stops);
    let exposures = exposures(scene, &photograph);
    let fused = fused(&grid, &exposures, &photograph);
    let longest = OF_LONGEST * mean_code(&grid, &photograph, exposures[exposures.len() - 1]);
    let (brightness, powers) = match (options.brightness, scene.photographed) {
        // Fused photographs already have the brightness of photographs.
        (None, Some(_)) => (longest, (1.0, POWERS.1)),
        (asked, _) => (longest.min(asked.unwrap_or(BRIGHTNESS)), POWERS),
    };
    let levels = Levels::new(&fused, brightness, powers, options.contrast);

    let (width, height) = (grid.logs.width(), grid.logs.height());
    let (saturation, is_known) = (options.saturation as f32, scene.photographed.is_some());
    let cells = Plane::from_rows(width, height, |y, row: &mut [[f32; 3]]| {
        for (x, cell) in row.iter_mut().enumerate() {
            let display = levels.display([0, 1, 2].map(|c| fused[c].at(x, y)));
            let [share, turn] =
                as_photographed(&photograph, is_known, colour(grid.colours.at(x, y)), display.max(DARKEST));
            let visible = display * display / (display * display + DARKEST * DARKEST);
            *cell = [log2(display + DARKEST), saturation * share * visible, turn];
        }
    });
    let (tones, chroma) = cells.into_vec().into_iter().map(|[tone, share, turn]| (tone, [share, turn])).unzip();
    let (tones, chroma) = (Plane::from_vec(width, height, tones), Plane::from_vec(width, height, chroma));
    let guide = Guide::fitted(&grid.logs, &tones, grid.side, options.detail as f32);
    let curve = Curve::new(|tone| libm::exp2(tone) - f64::from(DARKEST), |_| 1.0, 1.0);
    Tones::new(scene.to_srgb, guide, curve, scene.size.0).with_chroma(chroma)
}

/// Returns R/Y, G/Y and B/Y, where Y is luminance, from R/Y and B/Y.
fn colour([red, blue]: [f32; 2]) -> [f32; 3] {
    let [r, g, b] = super::display::LUMINANCE;
    [red, ((1.0 - r * red - b * blue) / g).max(0.0), blue]
}

fn scaled(colour: [f32; 3], by: f32) -> [f32; 3] {
    colour.map(|c| c * by)
}

/// Returns the factor on the chroma of `colour` (of luminance 1) and the rotation of its hue in radians, when shown at
/// the luminance `display`.
///
/// Both are those of a photograph that shows the colour at that luminance, in which lamp light is golden, not pink.
/// When the curve of the photographs is not known, the hue rotates little and only where nearly white colours get
/// paler, and chroma is never increased.
fn as_photographed(photograph: &Photograph, is_known: bool, colour: [f32; 3], display: f32) -> [f32; 2] {
    let lab = |rgb| {
        let [_, a, b] = oklab::from_linear(rgb);
        (a, b, (a * a + b * b).sqrt())
    };
    let (a, b, of_scene) = lab(scaled(colour, display));
    if of_scene <= GREY {
        return [1.0, 0.0];
    }
    let (to_a, to_b, of_photograph) = lab(photograph.showing(colour, display));
    let share = of_photograph / of_scene;
    let turn = libm::atan2f(a * to_b - b * to_a, a * to_a + b * to_b);
    if is_known {
        return [share, turn.clamp(-MOST_TURN.1, MOST_TURN.1)];
    }
    let paler = (2.0 - 2.0 * share).clamp(0.0, 1.0);
    [share.min(1.0), turn.clamp(-MOST_TURN.0, MOST_TURN.0) * paler]
}

/// Largest rotation of hue in radians: 9 degrees, or 25 when the photographs are known.
const MOST_TURN: (f32, f32) = (0.157, 0.436);

/// Chroma at or below which a colour counts as grey.
const GREY: f32 = 1e-3;

/// Returns the exposures to compute, rising: each is log2 of a factor on luminance. A luminance that becomes 1 by this
/// factor has the middle code value.
fn exposures(scene: &Scene, photograph: &Photograph) -> Vec<f64> {
    let shows = |(code, part): (f64, f64)| photograph.stop(code) - scene.percentile(part);
    let (lights, shadows) = (shows(LIGHTS), shows(SHADOWS));
    let (shortest, longest) = match &scene.photographed {
        Some(p) => (-libm::log2(p.shortest), -libm::log2(p.longest)),
        None => (f64::NEG_INFINITY, shadows),
    };
    let shortest = lights.min(longest).max(shortest);
    let range = (longest - shortest).max(0.0);
    let count = ((range / STEP).ceil() as usize).clamp(1, MOST_EXPOSURES - 1);
    (0..=count).map(|i| shortest + range * i as f64 / count as f64).collect()
}

/// Returns the mean code value of `grid` in the exposure `stop`.
fn mean_code(grid: &Scene, photograph: &Photograph, stop: f64) -> f64 {
    let logs = grid.logs.as_slice();
    let step = (logs.len() / 4096).max(1);
    let codes = logs.iter().step_by(step).map(|l| f64::from(photograph.code(l + stop as f32)));
    let count = codes.len();
    codes.sum::<f64>() / count as f64
}

/// Returns the fused exposures of `grid`: code values, some of which are outside of 0..=1.
fn fused(grid: &Scene, exposures: &[f64], photograph: &Photograph) -> Channels {
    let (width, height) = (grid.logs.width(), grid.logs.height());
    let stops: Channels = std::array::from_fn(|c| {
        Plane::from_rows(width, height, |y, row| {
            for ((v, l), ratios) in row.iter_mut().zip(grid.logs.row(y)).zip(grid.colours.row(y)) {
                *v = l + log2(colour(*ratios)[c].max(f32::MIN_POSITIVE));
            }
        })
    });
    let exposed = |i: usize| {
        let stop = exposures[i] as f32;
        Ok(stops.each_ref().map(|plane| {
            Plane::from_rows(width, height, |y, row| {
                row.iter_mut().zip(plane.row(y)).for_each(|(code, l)| *code = photograph.code(l + stop));
            })
        }))
    };
    // Computing exposures cannot fail.
    fusion::fuse(exposures.len(), exposed, &fusion::Options::default())
        .unwrap_or_else(|_| std::array::from_fn(|_| Plane::filled(width, height, 0.0)))
}

/// Maps fused code values to the display: black, white, brightness and contrast.
struct Levels {
    black: f32,
    white: f32,
    power: f64,
    contrast: f64,
}

impl Levels {
    /// Sets the levels such that the mean code value of the luminance of `fused` is `brightness`, or as near as
    /// `powers` allow.
    fn new(fused: &Channels, brightness: f64, (mut low, mut high): (f64, f64), contrast: f64) -> Self {
        let [r, g, b] = fused.each_ref().map(|plane| plane.as_slice());
        let mut greys: Vec<f32> = r.iter().zip(g).zip(b).map(|((r, g), b)| (r + g + b) / 3.0).collect();
        greys.sort_unstable_by(f32::total_cmp);
        let black = BLACK.0 * quantile(&greys, ENDS.0).clamp(0.0, BLACK.1);
        let white = quantile(&greys, 1.0 - ENDS.1).clamp(WHITE, 1.0);
        let mut levels = Levels { black, white, power: 1.0, contrast };
        let step = (r.len() / 4096).max(1);
        let linear: Vec<f64> =
            (0..r.len()).step_by(step).map(|i| luminance(levels.levelled([r[i], g[i], b[i]])).into()).collect();
        for _ in 0..20 {
            levels.power = 0.5 * (low + high);
            let mean = linear.iter().map(|l| levels.code(*l)).sum::<f64>() / linear.len() as f64;
            if mean > brightness {
                low = levels.power;
            } else {
                high = levels.power;
            }
        }
        levels
    }

    /// Returns the linear light of fused code values, scaled from black to white.
    fn levelled(&self, codes: [f32; 3]) -> [f32; 3] {
        codes.map(|code| {
            let code = ((code - self.black) / (self.white - self.black)).max(0.0);
            let over = code - KNEE;
            let held = if over > 0.0 { KNEE + (1.0 - KNEE) * (1.0 - libm::expf(-over / (1.0 - KNEE))) } else { code };
            srgb_to_linear(held.into()) as f32
        })
    }

    /// Returns the code value of a luminance of the levelled picture, after power and contrast curve.
    fn code(&self, linear: f64) -> f64 {
        let code = libm::pow(linear_to_srgb(linear), self.power);
        // Interpolates towards the smooth step, whose slope is 1.5 in the middle.
        code + self.contrast * (code * code * (3.0 - 2.0 * code) - code)
    }

    /// Returns the luminance of fused code values, relative to display white.
    fn display(&self, codes: [f32; 3]) -> f32 {
        let light = luminance(self.levelled(codes)).max(DARKEST);
        srgb_to_linear(self.code(light.into())) as f32
    }
}

#[cfg(test)]
mod tests;
