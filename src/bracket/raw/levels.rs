//! Levels: from sample values to linear values.
//!
//! In: a [`Sensor`]. Out: values of its active area: 0 is black, 1 the white that the file names; and the value from
//! which samples are clipped. Cost: some operations for each sample. Source: DNG, chapter 5, "Mapping Raw Values to
//! Linear Reference Values".

use super::tags::{Tags, damaged, tag};
use super::{Reason, Sensor, Values};
use crate::plane::Plane;
use rayon::prelude::*;
use std::io::{Read, Seek};

/// Share of white from which a sensor may clip: cameras clip below the white that they write.
const LOWEST_CLIP: f32 = 0.9;
/// and up to which: some write a white that is too low.
const HIGHEST_CLIP: f32 = 1.1;
/// Number of classes between these in which values are counted.
const CLASSES: usize = 400;
/// Values pile up in a class if it has this many times as many as the mean of the classes below it.
const PILE: f64 = 8.0;
/// and at least this share of all values.
const LEAST_PILE: f64 = 1e-5;

/// What the sample values of a file mean.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Levels {
    /// The value that each stored value stands for; empty if they are the values.
    linearisation: Vec<f32>,
    /// Black of the pixels of a part that repeats: its width and height, and the black of each sample, row by row.
    black_size: (usize, usize),
    black: Vec<f32>,
    /// What is added to black in each column and in each row of the active area; empty for nothing.
    black_of_columns: Vec<f32>,
    black_of_rows: Vec<f32>,
    /// White of each sample of a pixel.
    white: Vec<f32>,
    /// Samples of a pixel.
    samples: usize,
}

impl Levels {
    /// Reads the levels of a picture with so many samples for each pixel.
    ///
    /// # Errors
    /// The reason, if they are damaged.
    pub(super) fn read<R: Read + Seek>(tags: &mut Tags<R>, samples: usize) -> Result<Self, Reason> {
        let mut floats =
            |tag| -> Vec<f32> { tags.reals(tag).unwrap_or_default().into_iter().map(|v| v as f32).collect() };
        let size = floats(tag::BLACK_SIZE);
        let (rows, columns) = match size[..] {
            [] => (1, 1),
            [rows, columns] if (1.0..=64.0).contains(&rows) && (1.0..=64.0).contains(&columns) => {
                (rows as usize, columns as usize)
            }
            _ => return Err(damaged()),
        };
        let mut black = floats(tag::BLACK);
        if black.is_empty() {
            black = vec![0.0; rows * columns * samples];
        }
        let (black_of_columns, black_of_rows) = (floats(tag::BLACK_OF_COLUMNS), floats(tag::BLACK_OF_ROWS));
        let mut white = floats(tag::WHITE);
        if white.is_empty() {
            let is_float = tags.reals(tag::SAMPLE_FORMAT).is_some_and(|v| v == [3.0]);
            let bits = tags.reals(tag::BITS).and_then(|v| v.first().copied()).unwrap_or(16.0);
            white = vec![if is_float { 1.0 } else { (libm::exp2(bits) - 1.0) as f32 }];
        }
        white.resize(samples, white[0]);
        let linearisation = tags.reals(tag::LINEARISATION).unwrap_or_default().iter().map(|&v| v as f32).collect();
        let levels = Levels {
            linearisation,
            black_size: (columns, rows),
            black,
            black_of_columns,
            black_of_rows,
            white,
            samples,
        };
        let is_sound = levels.black.len() == rows * columns * samples && (0..samples).all(|c| levels.range(c) > 0.0);
        if is_sound { Ok(levels) } else { Err("its black and white levels are damaged; copy the file again".into()) }
    }

    /// Number of samples of a pixel.
    pub(super) fn samples(&self) -> usize {
        self.samples
    }

    /// Difference between white and the mean black of sample `c` of a pixel.
    fn range(&self, c: usize) -> f32 {
        let black: Vec<f32> = self.black.iter().copied().skip(c).step_by(self.samples).collect();
        self.white[c] - black.iter().sum::<f32>() / black.len() as f32
    }
}

/// The linear values of the active area. Values may be below 0, because of noise, and above 1.
///
/// # Errors
/// The reason, if the tags of black do not fit the picture.
pub(super) fn linear(sensor: &Sensor) -> Result<Plane<f32>, Reason> {
    let (levels, active) = (&sensor.levels, sensor.active);
    let fits = |deltas: &[f32], length: usize| deltas.is_empty() || deltas.len() == length;
    if !fits(&levels.black_of_columns, active.width) || !fits(&levels.black_of_rows, active.height) {
        return Err("its black levels do not fit its size; copy the file again".into());
    }
    let samples = levels.samples;
    let width = active.width * samples;
    let per: Vec<f32> = (0..samples).map(|c| 1.0 / levels.range(c)).collect();
    let per: Vec<f32> = per.into_iter().cycle().take(width).collect();
    let (columns, rows) = levels.black_size;
    // The rows of the pattern that repeats, with the black of the columns.
    let black_at = |row: usize, i: usize| {
        let of_column = levels.black_of_columns.get(i / samples).copied().unwrap_or(0.0);
        levels.black[(row * columns + (i / samples) % columns) * samples + i % samples] + of_column
    };
    let black: Vec<Vec<f32>> = (0..rows).map(|row| (0..width).map(|i| black_at(row, i)).collect()).collect();
    let columns = active.left * samples..active.left * samples + width;
    let mut values = vec![0.0f32; width * active.height];
    values.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        match &sensor.values {
            Values::Floats(plane) => row.copy_from_slice(&plane.row(active.top + y)[columns.clone()]),
            Values::Integers(plane) => {
                let stored = row.iter_mut().zip(&plane.row(active.top + y)[columns.clone()]);
                match levels.linearisation.last() {
                    None => stored.for_each(|(to, &v)| *to = f32::from(v)),
                    Some(last) => {
                        stored.for_each(|(to, &v)| *to = *levels.linearisation.get(usize::from(v)).unwrap_or(last))
                    }
                }
            }
        }
        let of_row = levels.black_of_rows.get(y).copied().unwrap_or(0.0);
        for ((value, black), per) in row.iter_mut().zip(&black[y % rows]).zip(&per) {
            let v = (*value - (black + of_row)) * per;
            *value = if v.is_finite() { v } else { 0.0 };
        }
    });
    Ok(Plane::from_vec(width, active.height, values))
}

/// The linear value from which each colour is clipped: where the values of the colour pile up near white, or else
/// white.
pub(super) fn clip(linear: &Plane<f32>, sensor: &Sensor) -> [f32; 3] {
    let colour = |i: usize, y: usize| match &sensor.pattern {
        Some(pattern) => pattern.at(i, y),
        None => i % 3,
    };
    let scale = CLASSES as f32 / (HIGHEST_CLIP - LOWEST_CLIP);
    let counts: Vec<[[u32; CLASSES]; 3]> = linear
        .as_slice()
        .par_chunks(64 * linear.width())
        .enumerate()
        .map(|(band, values)| {
            let mut counts = [[0u32; CLASSES]; 3];
            for (j, &v) in values.iter().enumerate().filter(|(_, v)| **v >= LOWEST_CLIP) {
                let class = (((v - LOWEST_CLIP) * scale) as usize).min(CLASSES - 1);
                counts[colour(j % linear.width(), 64 * band + j / linear.width())][class] += 1;
            }
            counts
        })
        .collect();
    let all = linear.as_slice().len() as f64 / 3.0;
    std::array::from_fn(|c| {
        let count = |class: usize| counts.iter().map(|counts| u64::from(counts[c][class])).sum::<u64>() as f64;
        let counts: Vec<f64> = (0..CLASSES).map(count).collect();
        let mut below = 0.0;
        for (class, &count) in counts.iter().enumerate() {
            if count >= LEAST_PILE * all && count > PILE * (below + 1.0) / (class + 1) as f64 {
                return (LOWEST_CLIP + class as f32 / scale).min(1.0);
            }
            below += count;
        }
        1.0
    })
}
