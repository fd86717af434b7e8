//! The operator of the house: exposures as the photographer might have made them, each where it shows best.
//!
//! In: a scene. Out: its tones. Cost: some 2 us a cell, of which there are at most [`CELLS`], for ten exposures; a pixel three interpolations.
//! Source: [exposure fusion](super::fusion) (Mertens et al. 2007) on exposures that are made of the radiance. There are as many as the scene's lights and the
//! bracket's longest exposure ask for, two stops apart; no mover is in any of them; and a radiance map from elsewhere has them too.
//!
//! 1. The scene, on a grid, is exposed: from the exposure that shows its lights to the bracket's longest, for how long a photographer exposed says how bright the
//!    place is: night stays night.
//! 2. The exposures are fused, and black and white are where the fused picture has its darkest and brightest.
//! 3. A curve of contrast is applied; a power makes it darker where the longest exposure is dark, and brings radiance without photographs to the brightness
//!    of one.
//! 4. Straight lines carry luminance from the grid to the pixels (`guide`). A colour is that of the photograph which shows a place so bright; where nothing is
//!    known of photographs, hue is the scene's, and no colour is stronger than there.
//!
//! The numbers below were chosen by eye, and by blind judgements, on sixteen photographed brackets.

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

/// What may be set; the rest the picture decides.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Options {
    /// The mean of the picture's code values, 0 to 1, where the photographs were not darker. `None`: as the fused photographs have it; 0.48 for radiance
    /// of which no photographs are known.
    pub brightness: Option<f64>,
    /// The strength of the curve of contrast: 0 is none, 1 raises contrast by half in the middle tones.
    pub contrast: f64,
    /// Fine contrast: 1 as in the scene, above it raised.
    pub detail: f64,
    /// Times the chroma that photographs have: 1 looks as colourful as they do, 0 is grey.
    pub saturation: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { brightness: None, contrast: 0.2, detail: 1.0, saturation: 1.0 }
    }
}

impl Options {
    /// What may be set, by name.
    pub fn settings(&mut self) -> Vec<Setting<'_>> {
        vec![
            Setting::estimated("brightness", (0.1, 0.9), &mut self.brightness, "the mean of the picture's codes, of 1"),
            Setting::number("contrast", (0.0, 1.0), &mut self.contrast, "of the middle tones; 0 adds none"),
            Setting::number("detail", (0.5, 3.0), &mut self.detail, "times the fine contrast of the scene"),
            Setting::saturation(&mut self.saturation),
        ]
    }
}

/// Cells that are exposed.
pub const CELLS: usize = 1 << 17;

/// The code, of 1, that the shortest exposure gives to the lights: what is brighter than all but so many pixels.
const LIGHTS: (f64, f64) = (0.9, 0.999);
/// The code, of 1, that the longest exposure of a bracket of which nothing is known gives to the shadows: what is darker than all but so many.
const SHADOWS: (f64, f64) = (0.4, 0.01);
/// Contrast and stops to white of photographs of which nothing is known: what cameras do.
const CAMERA: (f64, f64) = (1.4, 2.6);
/// Stops between exposures, at most.
const STEP: f64 = 2.0;
/// The most exposures that are made, whatever the range.
const MOST_EXPOSURES: usize = 16;

/// The parts of the fused picture's cells that may be black and white.
const ENDS: (f64, f64) = (0.005, 0.003);
/// How far the darkest is taken towards black, and the code that is not taken there at all.
const BLACK: (f32, f32) = (0.5, 0.15);
/// The code, of 1, that white is at least.
const WHITE: f32 = 0.8;
/// What fusion makes brighter than white is held back softly from this code on. To make all darker instead takes away contrast.
const KNEE: f32 = 0.8;

/// How much of the mean code of the longest exposure the picture may have.
const OF_LONGEST: f64 = 0.8;
/// The mean code, of 1, of a picture of radiance of which no photographs are known: the median of sixteen fused brackets is 0.46.
const BRIGHTNESS: f64 = 0.48;
/// How far the brightness may be brought to that asked for, as a power of luminance.
const POWERS: (f64, f64) = (0.6, 1.4);

/// What luminances, relative to display white, are raised by while they are logarithms: code 6. What is darker than that has little weight in the lines, and
/// its colour cannot be told from noise.
const DARKEST: f32 = 0.002;

/// The tones of `scene`.
pub fn natural(scene: &Scene, options: &Options) -> Tones {
    let grid = scene.coarser(CELLS);
    let (contrast, white_stops) = scene.photographed.map_or(CAMERA, |p| (p.contrast, p.white_stops));
    let photograph = Photograph::new(contrast, white_stops);
    let exposures = Exposures::of(scene, &photograph);
    let fused = fused(&grid, &exposures, &photograph);
    let longest = OF_LONGEST * exposures.longest_mean(&grid, &photograph);
    let (brightness, powers) = match (options.brightness, scene.photographed) {
        // What is fused of photographs is as bright as photographs are.
        (None, Some(_)) => (longest, (1.0, POWERS.1)),
        (asked, _) => (longest.min(asked.unwrap_or(BRIGHTNESS)), POWERS),
    };
    let levels = Levels::new(&fused, brightness, powers, options.contrast);
    let colours = Colours { photograph: &photograph, is_known: scene.photographed.is_some() };
    let (width, height) = (grid.logs.width(), grid.logs.height());
    let saturation = options.saturation as f32;
    let cells = Plane::from_rows(width, height, |y, row: &mut [[f32; 3]]| {
        for (x, cell) in row.iter_mut().enumerate() {
            let display = levels.display([0, 1, 2].map(|c| fused[c].at(x, y)));
            let [share, turn] = colours.shown(colour(grid.colours.at(x, y)), display.max(DARKEST));
            let visible = display * display / (display * display + DARKEST * DARKEST);
            *cell = [log2(display + DARKEST), saturation * share * visible, turn];
        }
    });
    let tones = Plane::from_rows(width, height, |y, row| {
        row.iter_mut().zip(cells.row(y)).for_each(|(tone, cell)| *tone = cell[0]);
    });
    let chroma = Plane::from_rows(width, height, |y, row| {
        row.iter_mut().zip(cells.row(y)).for_each(|(chroma, cell)| *chroma = [cell[1], cell[2]]);
    });
    let guide = Guide::fitted(&grid.logs, &tones, grid.side, options.detail as f32);
    Tones::new(
        scene.to_srgb,
        guide,
        Curve::new(|tone| libm::exp2(tone) - f64::from(DARKEST), |_| 1.0, 1.0),
        scene.size.0,
    )
    .with_chroma(chroma)
}

/// Red, green and blue over luminance, of a cell that has these ratios of red and blue.
fn colour([red, blue]: [f32; 2]) -> [f32; 3] {
    let [r, g, b] = super::display::LUMINANCE;
    [red, ((1.0 - r * red - b * blue) / g).max(0.0), blue]
}

fn scaled(colour: [f32; 3], by: f32) -> [f32; 3] {
    colour.map(|c| c * by)
}

/// How colours are shown: as photographs show them.
struct Colours<'a> {
    photograph: &'a Photograph,
    /// Whether the scene was photographed so. Of radiance that is all there is, its own colours are right.
    is_known: bool,
}

impl Colours<'_> {
    /// The share of the chroma of `colour` (of luminance 1) at the luminance `display` that is shown, and the turn of its hue in radians: those of the photograph
    /// that shows it so bright, where lamp light is golden, not pink.
    /// A scene that nobody photographed turns little, and only where what is nearly white gets pale, and no colour becomes stronger.
    fn shown(&self, colour: [f32; 3], display: f32) -> [f32; 2] {
        let lab = |rgb| {
            let [_, a, b] = oklab::from_linear(rgb);
            (a, b, (a * a + b * b).sqrt())
        };
        let (a, b, of_scene) = lab(scaled(colour, display));
        if of_scene <= GREY {
            return [1.0, 0.0];
        }
        let (to_a, to_b, of_photograph) = lab(self.photograph.showing(colour, display));
        let share = of_photograph / of_scene;
        let turn = libm::atan2f(a * to_b - b * to_a, a * to_a + b * to_b);
        match self.is_known {
            true => [share, turn.clamp(-MOST_TURN.1, MOST_TURN.1)],
            false => {
                let paler = (2.0 - 2.0 * share).clamp(0.0, 1.0);
                [share.min(1.0), turn.clamp(-MOST_TURN.0, MOST_TURN.0) * paler]
            }
        }
    }
}

/// The most that a hue turns, in radians: 9 degrees, and 25 where photographs show by how much.
const MOST_TURN: (f32, f32) = (0.157, 0.436);

/// The chroma that cannot be told from none.
const GREY: f32 = 1e-3;

/// The exposures that are made of a scene: log2 of what luminance is multiplied by to be 1 where the middle code is.
#[derive(Debug, Clone, PartialEq)]
struct Exposures {
    stops: Vec<f64>,
}

impl Exposures {
    fn of(scene: &Scene, photograph: &Photograph) -> Self {
        let shows = |(code, part): (f64, f64)| photograph.stop(code) - scene.percentile(part);
        let (lights, shadows) = (shows(LIGHTS), shows(SHADOWS));
        let (shortest, longest) = match &scene.photographed {
            Some(p) => (-libm::log2(p.shortest), -libm::log2(p.longest)),
            None => (f64::NEG_INFINITY, shadows),
        };
        let shortest = lights.min(longest).max(shortest);
        let range = (longest - shortest).max(0.0);
        let count = ((range / STEP).ceil() as usize).clamp(1, MOST_EXPOSURES - 1);
        Exposures { stops: (0..=count).map(|i| shortest + range * i as f64 / count as f64).collect() }
    }

    fn longest(&self) -> f64 {
        self.stops[self.stops.len() - 1]
    }

    /// The mean code of `grid` in the longest exposure.
    fn longest_mean(&self, grid: &Scene, photograph: &Photograph) -> f64 {
        let logs = grid.logs.as_slice();
        let code = |l: &f32| f64::from(photograph.code(l + self.longest() as f32));
        let step = (logs.len() / 4096).max(1);
        let codes: Vec<f64> = logs.iter().step_by(step).map(code).collect();
        codes.iter().sum::<f64>() / codes.len() as f64
    }
}

/// The fused exposures of `grid`: codes, of which some are beyond 0..=1.
fn fused(grid: &Scene, exposures: &Exposures, photograph: &Photograph) -> Channels {
    let (width, height) = (grid.logs.width(), grid.logs.height());
    let stops: Channels = std::array::from_fn(|c| {
        Plane::from_rows(width, height, |y, row| {
            for ((v, l), ratios) in row.iter_mut().zip(grid.logs.row(y)).zip(grid.colours.row(y)) {
                *v = l + log2(colour(*ratios)[c].max(f32::MIN_POSITIVE));
            }
        })
    });
    let exposed = |i: usize| {
        let stop = exposures.stops[i] as f32;
        Ok(stops.each_ref().map(|plane| {
            Plane::from_rows(width, height, |y, row| {
                row.iter_mut().zip(plane.row(y)).for_each(|(code, l)| *code = photograph.code(l + stop));
            })
        }))
    };
    // Making exposures cannot fail.
    fusion::fuse(exposures.stops.len(), exposed, &fusion::Options::default())
        .unwrap_or_else(|_| std::array::from_fn(|_| Plane::filled(width, height, 0.0)))
}

/// From fused codes to the display: black, white, brightness and contrast.
struct Levels {
    black: f32,
    white: f32,
    power: f64,
    contrast: f64,
}

impl Levels {
    /// So that the mean code of the luminance of `fused` is `brightness`, or as near as `powers` allow.
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

    /// Linear light of fused codes between black and white.
    fn levelled(&self, codes: [f32; 3]) -> [f32; 3] {
        codes.map(|code| {
            let code = ((code - self.black) / (self.white - self.black)).max(0.0);
            let over = code - KNEE;
            let held = if over > 0.0 { KNEE + (1.0 - KNEE) * (1.0 - libm::expf(-over / (1.0 - KNEE))) } else { code };
            srgb_to_linear(held.into()) as f32
        })
    }

    /// The code of the luminance that `linear` of the levelled picture has on the display.
    fn code(&self, linear: f64) -> f64 {
        let code = libm::pow(linear_to_srgb(linear), self.power);
        // Drawn towards the smooth step: by 1 it is one and a half times as steep in the middle.
        code + self.contrast * (code * code * (3.0 - 2.0 * code) - code)
    }

    /// The luminance, relative to display white, of fused codes.
    fn display(&self, codes: [f32; 3]) -> f32 {
        let light = luminance(self.levelled(codes)).max(DARKEST);
        srgb_to_linear(self.code(light.into())) as f32
    }
}

#[cfg(test)]
mod tests;
