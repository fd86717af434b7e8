//! The picture: computes its rows with all requested adjustments.
//!
//! In: radiance, or the fused frames. Out: code values of rows. Cost: one pass over the input; if the white balance is
//! estimated, another pass over a part of it; the operator; and the adjustments.

use crate::bracket::colour::{Primaries, srgb_to_linear};
use crate::error::{Result, Warning};
use crate::merge::{Photographed, RadianceMap};
use crate::plane::{BAND_ROWS, Plane};
use crate::tonemap::Operator;
use crate::tonemap::adjust::neutral::{self, BLACK_RADIANCE, Spot};
use crate::tonemap::adjust::{Adjusted, CELLS, Light, WhiteBalance};
use crate::tonemap::display::codes::{Code, Encoder};
use crate::tonemap::fusion::Channels;
use crate::tonemap::overview::{Overview, Scene};
use crate::tonemap::tones::Tones;
use crate::write::picture::Options;
use rayon::prelude::*;

/// Function that passes all of the radiance to a callback, part by part, with the index of the part's first row; it may
/// be called repeatedly.
pub(crate) type Each<'a> = &'a dyn Fn(&mut dyn FnMut(usize, &RadianceMap) -> Result<()>) -> Result<()>;

/// A picture whose rows can be computed.
pub(crate) struct Picture {
    source: Source,
    /// The light that is shown as white; `None` if the white of the photographs is kept.
    pub light: Option<Light>,
    adjusted: Option<Adjusted>,
}

/// The source of the rows.
enum Source {
    /// Computed from radiance.
    Toned(Tones),
    /// Fused frames, as code values from 0 to 1.
    Fused(Channels),
}

/// Number of rows that a thread tone-maps at once.
const SHOWN_ROWS: usize = 16;

impl Picture {
    /// Creates the picture that `operator` makes of the radiance. `each` passes the radiance, which has this size and
    /// these primaries.
    ///
    /// # Errors
    /// Those of `each`; an error if the spot that the user chose as grey is not grey.
    pub fn toned(
        each: Each,
        (size, primaries): ((usize, usize), Primaries),
        photographed: Option<Photographed>,
        operator: &Operator,
        options: &Options,
    ) -> Result<Picture> {
        let overview = |light: Option<Light>| -> Result<Overview> {
            let mut overview = Overview::new(size, &primaries).photographed(photographed);
            if let Some(light) = light {
                overview = overview.balanced(&primaries, light.xy());
            }
            each(&mut |first, map| {
                overview.see(first, &map.pixels);
                Ok(())
            })?;
            Ok(overview)
        };
        let spot = |mut spot: Spot| {
            each(&mut |first, map| {
                spot.see(first, &map.pixels);
                Ok(())
            })?;
            spot.light(&primaries, (BLACK_RADIANCE, f32::INFINITY))
        };
        let afar = || {
            let step = ((size.0 * size.1) / ENOUGH_PIXELS).clamp(1, MOST_STEP);
            let mut overview = Overview::new((size.0, size.1.div_ceil(step)), &primaries);
            each(&mut |first, map| {
                let skipped = first.next_multiple_of(step) - first;
                let rows = (skipped..map.pixels.height()).step_by(step).flat_map(|y| map.pixels.row(y)).copied();
                let rows: Vec<[f32; 3]> = rows.collect();
                overview.see(first.div_ceil(step), &Plane::from_vec(size.0, rows.len() / size.0.max(1), rows));
                Ok(())
            })?;
            Ok(overview.scene())
        };
        let light = white(options, size, afar, spot)?;
        let mut cells = None;
        let tones = overview(light)?.scene().map_or_else(
            || Tones::black(size.0),
            |scene| {
                let tones = operator.tones(&scene);
                cells = options.adjust.needs_surroundings().then(|| {
                    let grid = scene.coarser(CELLS);
                    (tones.displayed(&grid), grid.side)
                });
                tones
            },
        );
        let adjusted = Adjusted::new(&options.adjust, options.colours, None, cells, size.0);
        Ok(Picture { source: Source::Toned(tones), light, adjusted })
    }

    /// Creates the picture of fused frames, in codes of the picture's colour space.
    ///
    /// # Errors
    /// If the spot that the user chose as grey is not grey.
    pub fn fused(channels: Channels, options: &Options) -> Result<Picture> {
        let (width, height) = (channels[0].width(), channels[0].height());
        let (primaries, encoder) = (options.colours.primaries(), Encoder::of(options.colours));
        let source = Source::Fused(channels);
        let each = |see: &mut dyn FnMut(usize, &Plane<[f32; 3]>)| {
            for first in (0..height).step_by(BAND_ROWS) {
                let rows = BAND_ROWS.min(height - first);
                let light = Plane::from_rows(width, rows, |y, row| source.row(&encoder, first + y, &[], row));
                see(first, &light);
            }
        };
        let scene = || {
            let mut overview = Overview::new((width, height), &primaries);
            each(&mut |first, light| overview.see(first, light));
            overview.scene()
        };
        let spot = |mut spot: Spot| {
            each(&mut |first, light| spot.see(first, light));
            spot.light(&primaries, CODE_ENDS.map(|code| srgb_to_linear(code / 255.0) as f32).into())
        };
        let light = white(options, (width, height), || Ok(scene()), spot)?;
        let cells = options.adjust.needs_surroundings().then(scene).flatten().map(|scene| {
            let grid = scene.coarser(CELLS);
            let display = grid.logs.as_slice().iter().map(|&l| libm::exp2f(l)).collect();
            (Plane::from_vec(grid.logs.width(), grid.logs.height(), display), grid.side)
        });
        let adjusted = Adjusted::new(&options.adjust, options.colours, light, cells, width);
        Ok(Picture { source, light, adjusted })
    }

    /// Returns a warning about the picture, if there is one for `options`.
    pub fn warning(&self, options: &Options) -> Option<Warning> {
        let is_recovered = options.adjust.white_balance == WhiteBalance::Auto;
        (is_recovered && self.light.is_none()).then_some(Warning::NoWhite)
    }

    /// Computes the codes of complete rows of radiance, each `width` pixels long, from row `first` on.
    pub fn map<C: Code>(&self, encoder: &Encoder, width: usize, first: usize, rows: &[[f32; 3]], codes: &mut [[C; 3]]) {
        let rows = (first..).zip(rows.chunks(width)).zip(codes.chunks_mut(width));
        match &self.adjusted {
            None => rows.for_each(|((y, row), codes)| self.source.row(encoder, y, row, codes)),
            Some(adjusted) => {
                let mut light = vec![[0.0f32; 3]; width];
                for ((y, row), codes) in rows {
                    self.source.row(encoder, y, row, &mut light);
                    adjusted.row(encoder, y, &light, codes);
                }
            }
        }
    }

    /// Computes the codes of many rows in parallel, like [`map`](Self::map).
    pub fn show<C: Code>(
        &self,
        encoder: &Encoder,
        width: usize,
        first: usize,
        rows: &[[f32; 3]],
        codes: &mut Vec<[C; 3]>,
    ) {
        codes.resize(rows.len(), [C::default(); 3]);
        let bands = codes.par_chunks_mut(SHOWN_ROWS * width).zip(rows.par_chunks(SHOWN_ROWS * width));
        bands.enumerate().for_each(|(j, (codes, rows))| self.map(encoder, width, first + j * SHOWN_ROWS, rows, codes));
    }
}

/// Number of pixels that are enough to estimate the mean colour of a picture.
const ENOUGH_PIXELS: usize = 1 << 18;
/// Largest step, in rows, between the rows from which the mean colour is estimated.
const MOST_STEP: usize = 8;

/// Returns the light to be shown as white in a picture of `size` pixels; `None` if the white of the photographs is
/// kept. `scene` returns the reduced picture, and `spot` measures the light around a pixel.
fn white(
    options: &Options,
    size: (usize, usize),
    scene: impl FnOnce() -> Result<Option<Scene>>,
    spot: impl FnOnce(Spot) -> Result<Light>,
) -> Result<Option<Light>> {
    match options.adjust.white_balance {
        WhiteBalance::AsShot => Ok(None),
        WhiteBalance::Light(light) => Ok((!light.is_white()).then_some(light)),
        WhiteBalance::Auto => Ok(scene()?.as_ref().and_then(neutral::auto)),
        WhiteBalance::Spot(x, y) => spot(Spot::new((x, y), size)?).map(Some),
    }
}

/// Fused frames are black at or below the first of these codes, and white at or above the second.
const CODE_ENDS: [f64; 2] = [3.0, 253.5];

impl Source {
    /// Computes the codes of row `y` with the radiance `row`.
    fn row<C: Code>(&self, encoder: &Encoder, y: usize, row: &[[f32; 3]], codes: &mut [[C; 3]]) {
        match self {
            Source::Toned(tones) => tones.map(encoder, y, row, codes),
            Source::Fused(channels) => {
                let rows = channels.each_ref().map(|channel| channel.row(y));
                for (x, code) in codes.iter_mut().enumerate() {
                    *code = [0, 1, 2].map(|c| C::of_encoded(encoder, rows[c][x]));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tonemap::adjust;
    use crate::tonemap::adjust::white::Light;
    use crate::tonemap::display::luminance;
    use strum::IntoEnumIterator;

    const SIZE: (usize, usize) = (240, 160);
    const CARD: (usize, usize) = (40, 40);
    /// The light of a warm lamp in linear sRGB: about 3400 K.
    const WARM: [f32; 3] = [1.55, 0.9, 0.37];

    /// Returns a scene of surfaces with several colours in warm light, over twelve stops, with a grey card.
    fn scene() -> RadianceMap {
        let pixels = Plane::from_rows(SIZE.0, SIZE.1, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let light = libm::exp2f(x as f32 / 20.0 - 6.0 + y as f32 / 160.0);
                let colour = [[1.0, 1.0, 1.0], [1.0, 0.7, 0.5], [0.6, 0.8, 0.9]][(x / 24 + y / 16) % 3];
                *p = std::array::from_fn(|c| light * colour[c] * WARM[c]);
                if x.abs_diff(CARD.0) < 8 && y.abs_diff(CARD.1) < 8 {
                    *p = WARM.map(|c| 0.18 * c);
                }
            }
        });
        RadianceMap { pixels, primaries: Primaries::SRGB }
    }

    /// Returns the scene as channels of fused frames: with the curve of a camera.
    fn channels() -> Channels {
        let map = scene();
        std::array::from_fn(|c| {
            let code = |p: &[f32; 3]| crate::bracket::colour::linear_to_srgb(f64::from(p[c] / (1.0 + p[c]))) as f32;
            Plane::from_vec(SIZE.0, SIZE.1, map.pixels.as_slice().iter().map(code).collect())
        })
    }

    /// Returns the pictures of all operators and, last, of fusion, with the adjustments `adjust`.
    fn every(adjust: adjust::Options) -> Vec<Vec<[f32; 3]>> {
        let (map, options) = (scene(), Options { adjust, ..Options::default() });
        let each: Each = &|see| see(0, &map);
        let toned = |operator: Operator| Picture::toned(each, (SIZE, Primaries::SRGB), None, &operator, &options);
        let fused = Picture::fused(channels(), &options);
        let pictures = Operator::iter().map(toned).chain([fused]);
        let light = |picture: Result<Picture>| {
            let mut light = vec![[0.0f32; 3]; SIZE.0 * SIZE.1];
            picture.unwrap().map(&Encoder::default(), SIZE.0, 0, map.pixels.as_slice(), &mut light);
            light
        };
        pictures.map(light).collect()
    }

    fn odds(rgb: [f32; 3]) -> f32 {
        let y = luminance(rgb);
        libm::log2f(y / (1.0 - y))
    }

    #[test]
    fn a_stop_of_brightness_is_a_stop_of_log_odds_for_every_operator() {
        let plain = every(adjust::Options::default());
        for brightness in [-1.0, 1.0] {
            let brighter = every(adjust::Options { brightness, ..Default::default() });
            for (k, (plain, brighter)) in plain.iter().zip(&brighter).enumerate() {
                let moved: Vec<f32> = plain
                    .iter()
                    .zip(brighter)
                    // The luminance is exact only for colours inside the gamut of the display.
                    .filter(|(a, b)| a.iter().chain(*b).all(|c| (0.002..0.97).contains(c)))
                    .map(|(a, b)| odds(*b) - odds(*a))
                    .collect();
                assert!(moved.len() > 2000, "{k}: {}", moved.len());
                assert!(moved.iter().all(|by| (by - brightness as f32).abs() < 0.01), "{k} {brightness}");
            }
        }
    }

    /// If the colour of the light or a grey spot is given, the grey card is grey with every operator; if the light is
    /// estimated, the card is less coloured than without white balance.
    #[test]
    fn card_is_grey_in_its_light_for_every_operator() {
        let card = |pictures: &[Vec<[f32; 3]>]| -> Vec<f32> {
            let at = CARD.1 * SIZE.0 + CARD.0;
            pictures.iter().map(|light| (light[at][0] - light[at][2]) / luminance(light[at])).collect()
        };
        let with = |white_balance| card(&every(adjust::Options { white_balance, ..Default::default() }));
        let plain = with(WhiteBalance::AsShot);
        let spot = Picture::toned(
            &|see| see(0, &scene()),
            (SIZE, Primaries::SRGB),
            None,
            &Operator::default(),
            &Options {
                adjust: adjust::Options { white_balance: WhiteBalance::Spot(CARD.0, CARD.1), ..Default::default() },
                ..Options::default()
            },
        );
        let light: Light = spot.unwrap().light.unwrap();
        assert!((3000.0..3800.0).contains(&light.kelvin), "{light}");
        let (by_spot, by_light) = (with(WhiteBalance::Spot(CARD.0, CARD.1)), with(WhiteBalance::Light(light)));
        let by_itself = with(WhiteBalance::Auto);
        for k in 0..plain.len() {
            assert!(plain[k] > 0.3, "{k}: {}", plain[k]);
            assert!(by_spot[k].abs() < 0.02, "{k}: {}", by_spot[k]);
            // The last picture, of the fused frames, is not tested with `by_light`. Their codes went through a curve,
            // so the light measured in radiance is not the light in their codes.
            assert!(k == plain.len() - 1 || by_light[k].abs() < 0.02, "{k}: {}", by_light[k]);
            assert!(by_itself[k].abs() < 0.85 * plain[k], "{k}: {} of {}", by_itself[k], plain[k]);
        }
    }

    #[test]
    fn bands_and_rows_do_not_show() {
        let adjust = adjust::Options { shadows: 70.0, highlights: -70.0, saturation: 20.0, ..Default::default() };
        let (map, options) = (scene(), Options { adjust, ..Options::default() });
        let each: Each = &|see| see(0, &map);
        let encoder = Encoder::default();
        let toned = Picture::toned(each, (SIZE, Primaries::SRGB), None, &Operator::default(), &options);
        for picture in [toned, Picture::fused(channels(), &options)].map(Result::unwrap) {
            let mut whole = vec![[0u8; 3]; SIZE.0 * SIZE.1];
            picture.map(&encoder, SIZE.0, 0, map.pixels.as_slice(), &mut whole);
            let mut shown = Vec::new();
            for (y, row) in map.pixels.as_slice().chunks(SIZE.0 * 37).enumerate() {
                picture.show::<u8>(&encoder, SIZE.0, 37 * y, row, &mut shown);
                assert!(shown == whole[37 * y * SIZE.0..][..row.len()], "{y}");
            }
        }
    }
}
