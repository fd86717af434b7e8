//! hdralign's own operator: exposure fusion of exposures computed from the radiance.
//!
//! In: a scene. Out: its tones. Cost: for ten exposures, about 2 us per cell of a grid of at most [`CELLS`] cells;
//! three interpolations per pixel. Source: [exposure fusion](super::fusion) (Mertens et al. 2007) applied to computed
//! exposures. The number of computed exposures follows from the scene's highlights and the bracket's longest and
//! shortest exposures. Neighbouring exposures are at most two stops apart (for ranges up to 30 stops), and all of them
//! show the same scene, without moving objects. For radiance maps from other programs, the longest exposure follows from
//! the scene's shadows instead, and a typical camera and brightness are assumed.
//!
//! 1. Exposures of the scene are computed on a grid. The shortest one shows the highlights; the longest one equals the
//!    longest exposure of the bracket. The photographer chose this exposure, so it shows how bright the scene was, and
//!    night scenes stay dark.
//! 2. The exposures are fused; black and white are set near the darkest and brightest values of the fused picture.
//! 3. A contrast curve is applied. A power function darkens the picture if the longest exposure is dark. If the
//!    photographs are not known, this function also aims at the brightness of a typical photograph.
//! 4. Linear functions carry luminance from the grid to the pixels (`guide`). A photograph shows the same place in
//!    different colours, depending on the exposure. For each cell of the grid, an exposure is chosen: the one in which
//!    the cell would be as bright as it is in the tone-mapped picture. The pixels of the cell get about the colours
//!    that they would have in this exposure. If the photographs are not known, the hue is nearly that of the scene, and
//!    chroma is not increased (unless the setting `saturation` is above 1).
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
    /// Target for the mean code value of the picture, 0 to 1. It is not always reached. `None`: the mean code value of
    /// the fused photographs, or 0.48 if the photographs are not known. Every target, also a given one, has a limit:
    /// `OF_LONGEST` times the mean code value of the longest exposure. A target above the limit is reduced to the limit.
    pub brightness: Option<f64>,
    /// Strength of the contrast curve: 0 adds no contrast, 1 raises the contrast of the middle tones by half.
    pub contrast: f64,
    /// Factor on fine contrast: 1 keeps the contrast of the scene.
    pub detail: f64,
    /// Factor on the chroma of the photographs: 1 is as colourful as the photographs, 0 is grey.
    pub saturation: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { brightness: None, contrast: 0.2, detail: 1.0, saturation: 1.0 }
    }
}

impl Options {
    /// Returns the settings, each with its name, range and description.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::estimated(
                "brightness",
                (0.1, 0.9),
                &mut self.brightness,
                "target for the mean pixel value, from 0 (black) to 1 (white); not always reached",
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

/// Code value (0 to 1) of the highlights in the shortest exposure, and the share of the pixels that are darker than the
/// highlights.
const LIGHTS: (f64, f64) = (0.9, 0.999);
/// Two values that are assumed if nothing is known about the photographs, as with files of other programs: the code
/// value (0 to 1) that shadows have in the longest exposure, and the share of the pixels that are darker than these
/// shadows.
const SHADOWS: (f64, f64) = (0.4, 0.01);
/// Two values that are assumed if nothing is known about the photographs: the contrast, and the stops from the middle
/// code value to white. Both are typical of cameras.
const CAMERA: (f64, f64) = (1.4, 2.6);
/// Largest distance between neighbouring exposures, in stops.
const STEP: f64 = 2.0;
/// Largest number of exposures.
const MOST_EXPOSURES: usize = 16;

/// These define the dark and the bright end of the fused picture: the fraction of cells that are darker than its dark
/// end, and the fraction of cells that are brighter than its bright end.
const ENDS: (f64, f64) = (0.005, 0.003);
/// Let d be the code value (0 to 1) of the dark end of the fused picture, limited to at most the second number. The
/// code value d times the first number is scaled to 0.
const BLACK: (f32, f32) = (0.5, 0.15);
/// Smallest code value (0 to 1) of the fused picture that can be scaled to 1, before [`KNEE`] compresses it.
const WHITE: f32 = 0.8;
/// Code value (0 to 1) above which values are compressed softly. Fused values can exceed white, and darkening the whole
/// picture instead would reduce contrast.
const KNEE: f32 = 0.8;

/// The target for the mean code value of the picture is at most this share of the mean code value of the longest
/// exposure.
const OF_LONGEST: f64 = 0.8;
/// Mean code value (0 to 1) if the photographs are not known. It is near the median of sixteen fused brackets, 0.46.
const BRIGHTNESS: f64 = 0.48;
/// Smallest and largest exponent used to reach the brightness.
const POWERS: (f64, f64) = (0.6, 1.4);

/// Luminance (relative to display white) that is added before the logarithm. It corresponds to code value 6.6 of 255.
/// Darker values have little effect on the fit of the guide, and their colour cannot be distinguished from noise.
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
        // If photographs are known and no brightness is given, the fused picture already has their brightness. The
        // exponent must not brighten it then, so it is at least 1.
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
/// The resulting colour is the one that a photograph shows at that luminance: lamp light, for example, is golden and
/// not pink. If the tone curve of the photographs is not known, chroma is never increased, and the hue rotates little
/// and only for colours whose chroma decreases.
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

/// Largest rotation of hue, in radians: 9 degrees if the photographs are not known, 25 degrees if they are.
const MOST_TURN: (f32, f32) = (0.157, 0.436);

/// Chroma at or below which a colour counts as grey.
const GREY: f32 = 1e-3;

/// Returns the exposures to compute, in ascending order. Each is the log2 of a factor. A luminance that is 1 after it
/// is multiplied by this factor gets the middle code value.
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
    /// Sets the levels so that the mean code value of the luminance of `fused` is `brightness`, or as near to it as
    /// exponents from `low` to `high` allow.
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
        // The contrast curve mixes the code value with its smooth step function, whose slope is 1.5 in the middle.
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
