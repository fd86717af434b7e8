//! Opcodes: corrections of brightness that the file asks for.
//!
//! In: the tags of a file, and linear values. Out: brighter values where the lens darkens them. Cost: about twenty
//! operations for each sample of a file with opcodes. Source: DNG, chapter 7, "Opcode List Processing"; the places of
//! the points of a map are those of the DNG SDK.
//!
//! Telephones write them: without its maps of gains, their picture is two stops too dark at the corners, and greenish
//! or reddish. Opcodes that move pixels (WarpRectilinear) are not applied; alignment measures the distortion where it
//! matters.

use super::Reason;
use super::tags::{Tags, tag};
use crate::plane::Plane;
use rayon::prelude::*;
use std::io::{Read, Seek};

/// Numbers of opcodes.
const VIGNETTE: u32 = 3;
const GAIN_MAP: u32 = 9;
/// A list with more opcodes is damaged.
const MOST: u32 = 1000;

/// A factor for each sample.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Gain {
    /// A grid of factors.
    Map(Map),
    /// 1 + k0 r^2 + k1 r^4 + .. at the distance r from the centre, where the farthest corner is at 1.
    Radial {
        /// k0 to k4.
        k: [f64; 5],
        /// The centre as a share of width and height.
        centre: [f64; 2],
    },
}

/// Factors on a grid, for some of the samples.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Map {
    /// First and last row and column (exclusive), and the step from one to the next.
    top: usize,
    left: usize,
    bottom: usize,
    right: usize,
    row_step: usize,
    column_step: usize,
    /// The first sample of a pixel and the number of samples that are multiplied.
    plane: usize,
    planes: usize,
    /// Rows, columns and planes of the grid.
    size: [usize; 3],
    /// Distance of the points, and the first point, as a share of height and width.
    spacing: [f64; 2],
    origin: [f64; 2],
    factors: Vec<f32>,
}

/// Reads big-endian numbers.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn long(&mut self) -> Option<u32> {
        self.take(4)?.try_into().ok().map(u32::from_be_bytes)
    }

    fn index(&mut self) -> Option<usize> {
        self.long().map(|v| v as usize)
    }

    fn double(&mut self) -> Option<f64> {
        self.take(8)?.try_into().ok().map(f64::from_be_bytes).filter(|v| v.is_finite())
    }
}

/// Reads the gains of the lists 2 and 3.
///
/// # Errors
/// The reason, if a list is damaged.
pub(super) fn read<R: Read + Seek>(tags: &mut Tags<R>) -> Result<Vec<Gain>, Reason> {
    let mut gains = Vec::new();
    for tag in tag::OPCODES {
        if let Some(bytes) = tags.bytes(tag) {
            gains.extend(list(&bytes).ok_or("its list of corrections is damaged; copy the file again")?);
        }
    }
    Ok(gains)
}

/// The gains of a list.
fn list(bytes: &[u8]) -> Option<Vec<Gain>> {
    let mut bytes = Bytes(bytes);
    let count = bytes.long().filter(|&count| count <= MOST)?;
    let mut gains = Vec::new();
    for _ in 0..count {
        let (number, _version, _flags) = (bytes.long()?, bytes.long()?, bytes.long()?);
        let length = bytes.index()?;
        let mut data = Bytes(bytes.take(length)?);
        match number {
            GAIN_MAP => gains.push(Gain::Map(Map::read(&mut data)?)),
            VIGNETTE => {
                let mut numbers = [0.0; 7];
                for number in &mut numbers {
                    *number = data.double()?;
                }
                let [k0, k1, k2, k3, k4, x, y] = numbers;
                gains.push(Gain::Radial { k: [k0, k1, k2, k3, k4], centre: [x, y] });
            }
            _ => {}
        }
    }
    Some(gains)
}

impl Map {
    fn read(data: &mut Bytes) -> Option<Self> {
        let (top, left, bottom, right) = (data.index()?, data.index()?, data.index()?, data.index()?);
        let (plane, planes, row_step, column_step) = (data.index()?, data.index()?, data.index()?, data.index()?);
        let (rows, columns) = (data.index()?, data.index()?);
        let spacing = [data.double()?, data.double()?];
        let origin = [data.double()?, data.double()?];
        let size = [rows, columns, data.index()?];
        let count = rows.checked_mul(columns)?.checked_mul(size[2])?;
        let factors = data.take(count.checked_mul(4)?)?.as_chunks::<4>().0;
        let factors: Vec<f32> = factors.iter().map(|bytes| f32::from_be_bytes(*bytes)).collect();
        let is_sound = count > 0
            && row_step > 0
            && column_step > 0
            && (rows == 1 || spacing[0] > 0.0)
            && (columns == 1 || spacing[1] > 0.0)
            && factors.iter().all(|v| v.is_finite() && *v >= 0.0);
        let map =
            Map { top, left, bottom, right, row_step, column_step, plane, planes, size, spacing, origin, factors };
        is_sound.then_some(map)
    }

    /// The points of the grid before and after place `i` of `length` along `axis`, and the share of the second.
    fn between(&self, axis: usize, i: usize, length: usize) -> (usize, usize, f32) {
        let last = self.size[axis] - 1;
        let place = (i as f64 + 0.5) / length as f64;
        let at = if last == 0 { 0.0 } else { (place - self.origin[axis]) / self.spacing[axis] };
        let at = at.clamp(0.0, last as f64);
        let before = at as usize;
        (before, (before + 1).min(last), (at - before as f64) as f32)
    }
}

/// Multiplies `linear`, whose pixels have so many `samples`, by all `gains`.
pub(super) fn apply(gains: &[Gain], linear: &mut Plane<f32>, samples: usize) {
    for gain in gains {
        match gain {
            Gain::Map(map) => apply_map(map, linear, samples),
            Gain::Radial { k, centre } => apply_radial(*k, *centre, linear, samples),
        }
    }
}

fn apply_map(map: &Map, linear: &mut Plane<f32>, samples: usize) {
    let (width, height) = (linear.width() / samples, linear.height());
    let columns: Vec<(usize, (usize, usize, f32))> =
        (map.left..map.right.min(width)).step_by(map.column_step).map(|x| (x, map.between(1, x, width))).collect();
    let planes = map.plane..map.plane.saturating_add(map.planes).min(samples);
    let [_, grid_columns, grid_planes] = map.size;
    let rows = linear.as_mut_slice().par_chunks_mut(width * samples).enumerate();
    rows.filter(|(y, _)| (map.top..map.bottom).contains(y) && (y - map.top).is_multiple_of(map.row_step)).for_each(
        |(y, row)| {
            let (above, below, down) = map.between(0, y, height);
            for &(x, (left, right, across)) in &columns {
                for (i, c) in planes.clone().enumerate() {
                    let plane = i.min(grid_planes - 1);
                    let at = |y: usize, x: usize| map.factors[(y * grid_columns + x) * grid_planes + plane];
                    let upper = at(above, left) + across * (at(above, right) - at(above, left));
                    let lower = at(below, left) + across * (at(below, right) - at(below, left));
                    row[x * samples + c] *= upper + down * (lower - upper);
                }
            }
        },
    );
}

fn apply_radial(k: [f64; 5], [centre_x, centre_y]: [f64; 2], linear: &mut Plane<f32>, samples: usize) {
    let (width, height) = (linear.width() / samples, linear.height());
    let (x0, y0) = (centre_x * width as f64, centre_y * height as f64);
    let far = |at: f64, length: usize| at.abs().max((length as f64 - at).abs());
    let (far_x, far_y) = (far(x0, width), far(y0, height));
    let unit = 1.0 / (far_x * far_x + far_y * far_y);
    linear.as_mut_slice().par_chunks_mut(width * samples).enumerate().for_each(|(y, row)| {
        let dy = y as f64 + 0.5 - y0;
        for (x, pixel) in row.chunks_exact_mut(samples).enumerate() {
            let dx = x as f64 + 0.5 - x0;
            let r = (dx * dx + dy * dy) * unit;
            let gain = 1.0 + r * (k[0] + r * (k[1] + r * (k[2] + r * (k[3] + r * k[4]))));
            pixel.iter_mut().for_each(|v| *v *= gain as f32);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A list with one opcode.
    fn one(number: u32, data: &[u8]) -> Vec<u8> {
        let head = [1, number, 0x0103_0000, 0, data.len() as u32].map(u32::to_be_bytes).concat();
        [head, data.to_vec()].concat()
    }

    /// A map of 2 x 3 points for rows 1, 3, .. and columns 0, 2, ..
    fn map() -> Vec<u8> {
        let area = [1u32, 0, 99, 99, 0, 1, 2, 2, 2, 3].map(u32::to_be_bytes).concat();
        let places = [1.0f64, 0.5, 0.0, 0.0].map(f64::to_be_bytes).concat();
        let factors = [1.0f32, 2.0, 3.0, 3.0, 4.0, 5.0].map(f32::to_be_bytes).concat();
        [area, places, 1u32.to_be_bytes().to_vec(), factors].concat()
    }

    #[test]
    fn map_is_interpolated_where_it_applies() {
        let gains = list(&one(GAIN_MAP, &map())).unwrap();
        let mut linear = Plane::filled(8, 4, 1.0f32);
        apply(&gains, &mut linear, 1);
        for (x, y) in (0..4).flat_map(|y| (0..8).map(move |x| (x, y))) {
            // From left to right the factors rise by 1 for each half of the width, from top to bottom by 2 for the
            // height.
            let gain = 1.0 + 2.0 * (x as f32 + 0.5) / 8.0 + 2.0 * (y as f32 + 0.5) / 4.0;
            let expected = if y % 2 == 1 && x % 2 == 0 { gain } else { 1.0 };
            assert!((linear.at(x, y) - expected).abs() < 1e-5, "({x}, {y}): {} instead of {expected}", linear.at(x, y));
        }
    }

    #[test]
    fn vignette_is_brightened_towards_the_corners() {
        let data = [0.5f64, 0.25, 0.0, 0.0, 0.0, 0.5, 0.5].map(f64::to_be_bytes).concat();
        let gains = list(&one(VIGNETTE, &data)).unwrap();
        let mut linear = Plane::filled(3 * 101, 51, 1.0f32);
        apply(&gains, &mut linear, 3);
        assert_eq!([linear.at(150, 25), linear.at(152, 25)], [1.0; 2]);
        // Half a pixel from the corner.
        let r = (50.0 * 50.0 + 25.0 * 25.0) / (50.5 * 50.5 + 25.5 * 25.5);
        assert!((f64::from(linear.at(0, 0)) - (1.0 + 0.5 * r + 0.25 * r * r)).abs() < 1e-6);
    }

    #[test]
    fn other_opcodes_are_skipped_and_damaged_lists_are_errors() {
        assert_eq!(list(&one(1, &[0; 20])), Some(Vec::new()));
        let whole = one(GAIN_MAP, &map());
        assert!((0..whole.len()).all(|length| list(&whole[..length]).is_none()));
        let mut endless = whole.clone();
        endless[16 + 4 + 32..][..4].copy_from_slice(&u32::MAX.to_be_bytes());
        assert_eq!(list(&endless), None, "more points than bytes");
    }
}
