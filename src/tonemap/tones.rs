//! Tones: the result of an operator, which maps rows of radiance to code values.
//!
//! In: a `Guide` from luminance l (log2) to tone v, and a [`Curve`] from tone to the luminance of the display. Out:
//! rows of code values. Colour is handled the same way for all operators but `natural`: hue is kept in linear light,
//! saturation is corrected for the loss of contrast, and colours outside the gamut are desaturated. Cost: 8 ns of core
//! time per pixel. Source: Mantiuk, Tomaszewska, Heidrich, "Color Correction for Tone Mapping" (2009), equations 3 and
//! 5.

use super::display::{ToSrgb, into_gamut, luminance};
use super::guide::{Columns, Guide, interpolated};
use super::overview::Scene;
use crate::bracket::colour::srgb_to_linear;
use crate::plane::Plane;
use crate::pyramid::cells::Mix;
use crate::simd::{Loops, at_least, at_most, floor32, integer32, log2, vectorised};
use crate::tonemap::display::codes::{Code, Encoder};
use crate::tonemap::display::oklab;

/// Number of entries of the curve per octave. The curve is interpolated linearly between entries.
const PER_OCTAVE: usize = 64;
/// Number of octaves that the curve covers.
const OCTAVES: usize = 48;
/// Tone (log2) of the first entry of the curve.
const FIRST: f32 = -24.0;

/// Maps the tone v (log2) to the luminance on the display and a factor on saturation.
#[derive(Debug, Clone, PartialEq)]
pub struct Curve {
    /// For every entry the luminance relative to display white, and the factor on saturation.
    entries: Vec<[f32; 2]>,
}

impl Curve {
    /// Tabulates a curve. `display` gives the luminance of a tone, 0..=1 and never decreasing. `contrast` gives, for a
    /// tone, the slope of log display luminance as a function of log scene luminance. The correction of saturation
    /// (Mantiuk's equation 5) is computed from this slope. `saturation` is a factor on the corrected saturation.
    pub fn new(display: impl Fn(f64) -> f64, contrast: impl Fn(f64) -> f64, saturation: f64) -> Self {
        let entry = |i| {
            let v = f64::from(FIRST) + i as f64 / PER_OCTAVE as f64;
            [display(v).clamp(0.0, 1.0) as f32, (saturation * corrected(contrast(v))) as f32]
        };
        Curve { entries: (0..=PER_OCTAVE * OCTAVES).map(entry).collect() }
    }

    /// Returns the luminance that a display shows for the tone `v`, relative to its white.
    pub fn display(&self, v: f32) -> f32 {
        let (entry, part) = place(v);
        let (p, q) = (self.entries[entry as usize][0], self.entries[entry as usize + 1][0]);
        p + part * (q - p)
    }
}

/// Returns the index of the entry before the tone `v`, and the fraction of the way to the next entry.
#[inline(always)]
fn place(v: f32) -> (u32, f32) {
    let most = (PER_OCTAVE * OCTAVES) as f32 - 0.01;
    // The comparison sends NaN to the first entry, and it keeps the loop vectorised.
    let scaled = (v - FIRST) * PER_OCTAVE as f32;
    let scaled = at_most(if scaled > 0.0 { scaled } else { 0.0 }, most);
    let whole = floor32(scaled);
    (integer32(whole), scaled - whole)
}

/// Returns Mantiuk's equation 5 with the constants of the linear correction: s = (1 + k1) c^k2 / (1 + k1 c^k2), where c
/// is the remaining contrast.
fn corrected(contrast: f64) -> f64 {
    const K1: f64 = 2.3892;
    const K2: f64 = 0.8552;
    let power = libm::pow(contrast.clamp(0.0, 1.0), K2);
    (1.0 + K1) * power / (1.0 + K1 * power)
}

/// Maps rows of radiance to code values.
#[derive(Debug, Clone)]
pub struct Tones {
    to_srgb: ToSrgb,
    guide: Guide,
    curve: Curve,
    /// For the cells of the guide: factor on the chroma of the scene, and rotation of its hue in radians. If `None`,
    /// the curve sets the saturation.
    chroma: Option<Plane<[f32; 2]>>,
    /// Position of the picture's columns in the rows of the guide.
    columns: Columns,
}

impl Tones {
    /// Creates the tones of a picture that is `width` pixels wide.
    pub fn new(to_srgb: ToSrgb, guide: Guide, curve: Curve, width: usize) -> Self {
        let columns = guide.columns(width);
        Tones { to_srgb, guide, curve, chroma: None, columns }
    }

    /// Sets the factor on chroma and the rotation of hue for the cells of the guide. Colours are then computed in
    /// OkLab, and those outside the gamut are desaturated there.
    pub fn with_chroma(self, chroma: Plane<[f32; 2]>) -> Self {
        Tones { chroma: Some(chroma), ..self }
    }

    /// Returns tones that map everything to black, for a picture without light.
    pub fn black(width: usize) -> Self {
        let none = Curve::new(|_| 0.0, |_| 0.0, 0.0);
        Tones::new(ToSrgb::from(&crate::bracket::colour::Primaries::SRGB), Guide::shifted(0.0), none, width)
    }

    /// Returns tones that map radiance 1 to the middle code value, 128, as in the reference frame of the merge.
    pub fn as_photographed(to_srgb: ToSrgb, width: usize) -> Self {
        let middle = srgb_to_linear(128.0 / 255.0);
        let curve = Curve::new(|v| middle * libm::exp2(v), |_| 1.0, 1.0);
        Tones::new(to_srgb, Guide::shifted(0.0), curve, width)
    }

    /// Maps whole rows of radiance to code values of `encoder`. The first of these rows is row `first` of the picture.
    pub fn map<C: Code>(&self, encoder: &Encoder, first: usize, rows: &[[f32; 3]], codes: &mut [[C; 3]]) {
        let width = self.columns.0.len().max(1);
        let mut lines = Vec::new();
        let mut chroma = Vec::new();
        for ((y, row), codes) in (first..).zip(rows.chunks(width)).zip(codes.chunks_mut(width)) {
            self.guide.row(y, &mut lines);
            if let Some(plane) = &self.chroma {
                self.guide.row_of(plane, y, &mut chroma);
            }
            vectorised(Mapped { tones: self, lines: &lines, chroma: &chroma, encoder, row, codes });
        }
    }

    /// Returns the display luminances, 0..=1, of the cells of `grid`.
    pub fn displayed(&self, grid: &Scene) -> Plane<f32> {
        let (width, height) = (self.columns.0.len(), grid.size.1);
        let centre = |cell: usize, end: usize| (cell * grid.side + grid.side / 2).min(end.max(1) - 1);
        Plane::from_rows(grid.logs.width(), grid.logs.height(), |y, row| {
            let mut lines = Vec::new();
            self.guide.row(centre(y, height), &mut lines);
            for (x, (v, l)) in row.iter_mut().zip(grid.logs.row(y)).enumerate() {
                let at = centre(x, width);
                let (cell, part) = (self.columns.0[at] as usize, self.columns.1[at]);
                let [a, b] = lines[cell].towards(lines[cell + 1], part);
                *v = self.curve.display(a * l + b);
            }
        })
    }

    /// Returns the sRGB picture of `radiance`.
    pub fn picture(&self, radiance: &Plane<[f32; 3]>) -> Plane<[u8; 3]> {
        let encoder = Encoder::default();
        Plane::from_rows(radiance.width(), radiance.height(), |y, row| self.map(&encoder, y, radiance.row(y), row))
    }

    /// Maps a block of radiance, in place, to light of the encoder's primaries relative to display white. `x` is the
    /// column of the first pixel; `lines` (slopes and offsets) and `chroma` are the values of the guide for this row of
    /// the picture.
    #[inline(always)]
    fn pixels(
        &self,
        encoder: &Encoder,
        x: usize,
        lines: &[[f32; 2]],
        chroma: &[[f32; 2]],
        rgb: &mut [[f32; BLOCK]; 3],
    ) {
        let [red, green, blue] = rgb;
        let (mut light, mut tone) = ([0.0f32; BLOCK], [0.0f32; BLOCK]);
        let (mut display, mut share) = ([0.0f32; BLOCK], [0.0f32; BLOCK]);
        for i in 0..BLOCK {
            // Channels are clamped, so that everything computed from them is finite.
            let [r, g, b] = self.to_srgb.apply([red[i], green[i], blue[i]]).map(|c| at_most(c, 1e37));
            (red[i], green[i], blue[i]) = (r, g, b);
            light[i] = luminance([r, g, b]);
        }
        for i in 0..BLOCK {
            tone[i] = log2(at_least(light[i], f32::MIN_POSITIVE));
        }
        if lines.len() == 2 {
            let [a, b] = lines[0];
            for v in &mut tone {
                *v = a * *v + b;
            }
        } else {
            for (v, [a, b]) in tone.iter_mut().zip(interpolated(&self.columns, x, lines)) {
                *v = a * *v + b;
            }
        }
        let mut entry = [0u32; BLOCK];
        for i in 0..BLOCK {
            (entry[i], tone[i]) = place(tone[i]);
        }
        for i in 0..BLOCK {
            let at = entry[i] as usize;
            let (p, q) = (self.curve.entries[at], self.curve.entries[at + 1]);
            display[i] = p[0] + tone[i] * (q[0] - p[0]);
            share[i] = p[1] + tone[i] * (q[1] - p[1]);
        }
        if chroma.is_empty() {
            for i in 0..BLOCK {
                let ratio = display[i] / light[i];
                // Mantiuk's equation 3: ((C / L - 1) s + 1) L_d.
                let grey = display[i] * (1.0 - share[i]);
                let toned = [red[i], green[i], blue[i]].map(|c| (c * ratio) * share[i] + grey);
                [red[i], green[i], blue[i]] = into_gamut(encoder.from_srgb(toned), display[i]);
            }
        } else {
            let mut turn = [0.0f32; BLOCK];
            for ((share, turn), [factor, angle]) in
                share.iter_mut().zip(&mut turn).zip(interpolated(&self.columns, x, chroma))
            {
                *share *= factor;
                *turn = angle;
            }
            let mut lit = light;
            lit.iter_mut().for_each(|light| *light = at_least(*light, f32::MIN_POSITIVE));
            let shown = oklab::Shown { light: lit, display, share, turn };
            let mut colours = [*red, *green, *blue];
            shown.colours(&mut colours, |rgb| encoder.from_srgb(rgb));
            [*red, *green, *blue] = colours;
        }
        for channel in [red, green, blue] {
            for (c, light) in channel.iter_mut().zip(&light) {
                // A pixel without light, or with NaN, is black.
                *c = if *light >= f32::MIN_POSITIVE { *c } else { 0.0 };
            }
        }
    }
}

/// Number of pixels that are computed together.
const BLOCK: usize = 64;

/// A row to map to code values.
struct Mapped<'a, C> {
    tones: &'a Tones,
    lines: &'a [[f32; 2]],
    chroma: &'a [[f32; 2]],
    encoder: &'a Encoder,
    row: &'a [[f32; 3]],
    codes: &'a mut [[C; 3]],
}

impl<C: Code> Loops for Mapped<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let mut rgb = [[0.0f32; BLOCK]; 3];
        let mut x = 0;
        for (pixels, codes) in self.row.chunks(BLOCK).zip(self.codes.chunks_mut(BLOCK)) {
            let [red, green, blue] = &mut rgb;
            for (((r, g), b), p) in red.iter_mut().zip(green).zip(blue).zip(pixels) {
                (*r, *g, *b) = (p[0], p[1], p[2]);
            }
            self.tones.pixels(self.encoder, x, self.lines, self.chroma, &mut rgb);
            let encoded = rgb.each_ref().map(|channel| C::of_light(self.encoder, channel));
            for (i, out) in codes.iter_mut().enumerate() {
                *out = [encoded[0][i], encoded[1][i], encoded[2][i]];
            }
            x += pixels.len();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Primaries;

    /// Returns a tinted ramp that rises by ten stops from left to right.
    fn ramp() -> Plane<[f32; 3]> {
        Plane::from_rows(500, 70, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let l = libm::exp2f(x as f32 / 50.0) * (1.0 + y as f32 / 1000.0);
                *p = [l, 0.8 * l, 0.6 * l];
            }
        })
    }

    fn tones(guide: Guide) -> Tones {
        let curve = Curve::new(|v| libm::exp2(v) / (1.0 + libm::exp2(v)), |v| 1.0 / (1.0 + libm::exp2(v)), 1.0);
        Tones::new(ToSrgb::from(&Primaries::SRGB), guide, curve, 500)
    }

    /// The expected values are computed by the equations of the papers in `f64`. The tolerance is half a code value,
    /// which is at most 0.0045 of linear light. Other errors are far smaller: interpolation of the curve over 1/64 stop
    /// has a relative error of (ln 2 / 64)^2 / 8 = 1.5e-5, and logarithms below 8 have errors of 2e-7.
    #[test]
    fn pixels_are_those_of_the_papers() {
        let map = ramp();
        let tones = tones(Guide::shifted(-5.0));
        let codes = tones.picture(&map);
        for (x, y) in (0..500).map(|x| (x, x % 70)) {
            let rgb = map.at(x, y).map(f64::from);
            let lw = 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2];
            let l = lw / 32.0;
            let (ld, s) = (l / (1.0 + l), corrected(1.0 / (1.0 + l)));
            let linear = rgb.map(|c| (((c / lw - 1.0) * s + 1.0) * ld) as f32);
            let expected = into_gamut(linear, ld as f32);
            let back = codes.at(x, y).map(|c| crate::bracket::colour::srgb_to_linear(f64::from(c) / 255.0));
            for c in 0..3 {
                assert!((back[c] - f64::from(expected[c])).abs() < 0.0046, "{x}: {back:?} {expected:?}");
            }
        }
    }

    #[test]
    fn a_guide_of_many_cells_is_that_of_one_where_all_are_alike() {
        let logs = Plane::from_rows(125, 18, |y, row| {
            row.iter_mut().enumerate().for_each(|(x, l)| *l = ((x * 3 + y) % 11) as f32)
        });
        let moved = Plane::from_vec(125, 18, logs.as_slice().iter().map(|l| l - 5.0).collect());
        let (one, many) = (tones(Guide::shifted(-5.0)), tones(Guide::fitted(&logs, &moved, 4, 1.0)));
        let map = ramp();
        let (one, many) = (one.picture(&map), many.picture(&map));
        for (p, q) in one.as_slice().iter().zip(many.as_slice()) {
            assert!((0..3).all(|c| p[c].abs_diff(q[c]) <= 1), "{p:?} {q:?}");
        }
    }

    #[test]
    fn zero_is_black_and_infinity_is_white() {
        let tones = tones(Guide::shifted(0.0));
        let mut codes = [[7u8; 3]; 6];
        let rows = [[0.0; 3], [f32::NAN; 3], [-1.0; 3], [f32::MAX; 3], [f32::INFINITY; 3], [1e-42; 3]];
        tones.map(&Encoder::default(), 0, &rows, &mut codes);
        assert_eq!(codes, [[0; 3], [0; 3], [0; 3], [255; 3], [255; 3], [0; 3]]);
        let mut codes = [[7u8; 3]; 2];
        Tones::black(2).map(&Encoder::default(), 0, &[[1.0; 3]; 2], &mut codes);
        assert_eq!(codes, [[0; 3]; 2]);
    }
}
