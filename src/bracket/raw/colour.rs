//! The colours of a camera: its white, and what its red, green and blue are.
//!
//! In: the tags of a file. Out: [`CameraColour`]. Cost: negligible. Source: DNG, chapter 6, "Mapping Camera Color Space
//! to CIE XYZ Space"; McCamy, "Correlated color temperature as an explicit function of chromaticity coordinates", Color
//! Research & Application 17, 1992; the temperatures of EXIF's light sources are those of the DNG SDK.
//!
//! A matrix of the file maps XYZ to the camera's RGB under one illuminant. Between two illuminants, the matrices are
//! interpolated by the inverse temperature of the white of the photograph, which depends on the matrix itself, so both
//! are computed alternately.

use super::Reason;
use super::stretch::Scale;
use super::tags::{Tags, tag};
use crate::bracket::colour::Primaries;
use crate::simd::at_most;
use nalgebra::{Matrix3, Vector3};
use std::io::{Read, Seek};

/// The white of a file that does not name one: D55.
const DAYLIGHT: [f64; 2] = [0.3324, 0.3474];
/// Number of rounds in which white and matrix are computed alternately.
const ROUNDS: usize = 30;

/// The white of a photograph, and the colours of its camera.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CameraColour {
    /// RGB of white; the largest is 1.
    pub(super) neutral: [f32; 3],
    /// The primaries and the white of RGB that is divided by [`neutral`](Self::neutral).
    pub(super) primaries: Primaries,
}

impl CameraColour {
    /// Reads the colours.
    ///
    /// # Errors
    /// The reason, if the file has no usable matrix.
    pub(super) fn read<R: Read + Seek>(tags: &mut Tags<R>) -> Result<Self, Reason> {
        let unusable = || {
            "its colours cannot be computed, because its colour matrices are missing or damaged; convert it again"
                .to_owned()
        };
        let matrices = Matrices::read(tags).ok_or_else(unusable)?;
        let given = |values: Vec<f64>| <[f64; 3]>::try_from(values).ok().filter(|v| v.iter().all(|&v| v > 0.0));
        let (white, neutral) = match tags.reals(tag::NEUTRAL).and_then(given) {
            Some(neutral) => (matrices.white(neutral.into()).ok_or_else(unusable)?, Vector3::from(neutral)),
            None => {
                let white = match tags.reals(tag::WHITE_XY).as_deref() {
                    Some(&[x, y]) if x > 0.0 && y > 0.0 => [x, y],
                    _ => DAYLIGHT,
                };
                (white, matrices.at(white) * xyz(white))
            }
        };
        let most = neutral.max();
        if !(neutral.min() > 0.0 && most.is_finite()) {
            return Err(unusable());
        }
        let neutral = neutral / most;
        let to_xyz = matrices.at(white).try_inverse().ok_or_else(unusable)? * Matrix3::from_diagonal(&neutral);
        let [red, green, blue] = [0, 1, 2].map(|c| xy(to_xyz.column(c).into()));
        let primaries = Primaries { red, green, blue, white };
        primaries.to_xyz().ok_or_else(unusable)?;
        Ok(CameraColour { neutral: [0, 1, 2].map(|c| neutral[c] as f32), primaries })
    }
}

/// The matrices from XYZ to the camera's RGB, each with the inverse of the temperature of its illuminant, in 1 / K.
struct Matrices(Vec<(Matrix3<f64>, f64)>);

impl Matrices {
    fn read<R: Read + Seek>(tags: &mut Tags<R>) -> Option<Self> {
        let nine = |values: Vec<f64>| (values.len() == 9).then(|| Matrix3::from_row_slice(&values));
        let balance = tags.reals(tag::ANALOG_BALANCE).filter(|v| v.len() == 3).unwrap_or_else(|| vec![1.0; 3]);
        let balance = Matrix3::from_diagonal(&Vector3::from_column_slice(&balance));
        let mut all = Vec::new();
        for i in 0..2 {
            let Some(matrix) = tags.reals(tag::MATRICES[i]).and_then(nine) else { continue };
            let calibration = tags.reals(tag::CALIBRATIONS[i]).and_then(nine).unwrap_or_else(Matrix3::identity);
            let illuminant = tags.reals(tag::ILLUMINANTS[i]).and_then(|v| v.first().copied()).unwrap_or(0.0);
            all.push((balance * calibration * matrix, 1.0 / temperature(illuminant as u32)));
        }
        (!all.is_empty()).then_some(Matrices(all))
    }

    /// The matrix for a white with these chromaticities.
    fn at(&self, white: [f64; 2]) -> Matrix3<f64> {
        let [(first, from), (second, to)] = self.0[..] else { return self.0[0].0 };
        if from == to {
            return first;
        }
        let share = ((inverse_temperature(white) - from) / (to - from)).clamp(0.0, 1.0);
        first * (1.0 - share) + second * share
    }

    /// The white that the camera sees as `neutral`; none if there is none.
    fn white(&self, neutral: Vector3<f64>) -> Option<[f64; 2]> {
        let mut white = DAYLIGHT;
        for _ in 0..ROUNDS {
            white = xy(self.at(white).try_inverse()? * neutral);
        }
        (white.iter().all(|v| v.is_finite() && *v > 0.0)).then_some(white)
    }
}

fn xyz([x, y]: [f64; 2]) -> Vector3<f64> {
    Vector3::new(x / y, 1.0, (1.0 - x - y) / y)
}

fn xy(xyz: Vector3<f64>) -> [f64; 2] {
    [xyz.x / xyz.sum(), xyz.y / xyz.sum()]
}

/// The inverse of the correlated colour temperature, in 1 / K (McCamy).
fn inverse_temperature([x, y]: [f64; 2]) -> f64 {
    let n = (x - 0.3320) / (y - 0.1858);
    1.0 / (((-449.0 * n + 3525.0) * n - 6823.3) * n + 5520.33).max(1000.0)
}

/// The temperature of a light source of EXIF, in K.
fn temperature(illuminant: u32) -> f64 {
    match illuminant {
        3 | 17 => 2850.0,
        24 => 3200.0,
        15 => 3525.0,
        2 | 14 => 4150.0,
        23 => 5000.0,
        13 => 5050.0,
        10 | 12 | 19 | 21 => 6500.0,
        11 | 22 => 7500.0,
        _ => 5500.0,
    }
}

/// White balance: divides colours by those of white, and cuts them where the first colour clips.
#[derive(Debug, Clone, Copy)]
pub(super) struct Balance {
    /// 1 / the colours of white.
    factors: [f32; 3],
    /// The balanced value from which a colour may be clipped.
    top: f32,
    scale: Scale,
}

impl Balance {
    /// The balance for a white that the camera sees as `neutral`, and colours that are clipped from `clip` on.
    pub(super) fn new(neutral: [f32; 3], clip: [f32; 3]) -> Self {
        let top = (0..3).map(|c| clip[c] / neutral[c]).fold(1.0, f32::min);
        Balance { factors: neutral.map(|n| 1.0 / n), top, scale: Scale::of_sensor() }
    }

    /// No balance, for values up to `white`.
    pub(super) fn balanced(white: f32, scale: Scale) -> Self {
        Balance { factors: [1.0 / white; 3], top: f32::INFINITY, scale }
    }

    /// The factor on values of colour `c`.
    pub(super) fn factor(&self, c: usize) -> f32 {
        self.factors[c]
    }

    /// The [stretched](super::stretch) value of a balanced one, at most 1; 1 if it may be clipped.
    #[inline(always)]
    pub(super) fn stretched(&self, balanced: f32) -> f32 {
        let stretched = at_most(self.scale.stretched(balanced), 1.0);
        if balanced >= self.top { 1.0 } else { stretched }
    }

    /// The [stretched](Self::stretched) values of a pixel with three samples.
    pub(super) fn pixel(&self, linear: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|c| self.stretched(linear[c] * self.factors[c]))
    }
}
