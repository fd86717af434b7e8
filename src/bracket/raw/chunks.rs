//! The strips or tiles of a DNG file.
//!
//! In: the bytes of a file and its tags. Out: the sample values, as stored. Cost: decompression, in parallel. Source:
//! TIFF 6.0, sections 14 and 15; "TIFF Technical Note 3" (Adobe 2005), for the predictor of floats; DNG, chapters 2 and
//! 3, for lossless JPEG, floats of 24 bits and the predictors of wider strides.

use super::tags::{self, Tags, tag};
use crate::bracket::raw::{Reason, Values, lossless_jpeg};
use crate::limits;
use crate::plane::Plane;
use flate2::read::ZlibDecoder;
use rayon::prelude::*;
use std::io::{Read, Seek};
use std::ops::Range;

/// How the samples of a file are encoded.
#[derive(Debug, Clone, Copy)]
pub(super) struct Encoding {
    /// Samples of a pixel.
    samples: usize,
    /// Bits of a sample.
    bits: usize,
    are_floats: bool,
    packing: Packing,
    predictor: Predictor,
}

/// How the samples of a file are encoded, and where they are.
struct Layout {
    /// Size of the picture: samples of a row, and rows.
    size: (usize, usize),
    /// Size of a strip or tile: samples of a row, and rows. Those at the lower edge may have fewer rows in the file.
    chunk: (usize, usize),
    are_tiles: bool,
    encoding: Encoding,
    /// Where the bytes of each strip or tile are.
    places: Vec<Range<usize>>,
    is_little: bool,
}

/// Compression of the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Packing {
    None,
    LosslessJpeg,
    Deflate,
}

/// What is stored instead of the samples. Both kinds of differences are those to the sample so many samples before.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Predictor {
    None,
    Difference(usize),
    /// Differences of bytes, with the first bytes of all samples of a row before all second bytes, and so on.
    ByteDifference(usize),
}

/// Reads the samples of the raw data of the file `bytes`.
///
/// # Errors
/// The reason, if they are damaged, or stored in a way that is not supported.
pub(super) fn read<R: Read + Seek>(bytes: &[u8], tags: &mut Tags<R>) -> Result<Values, Reason> {
    let layout = Layout::read(bytes, tags)?;
    let (width, height) = layout.size;
    let count = width as u64 * height as u64;
    if layout.encoding.packing == Packing::None {
        limits::check_length(bytes.len(), count * layout.encoding.bits as u64 / 8, 1)?;
    }
    Ok(if layout.encoding.are_floats {
        Values::Floats(layout.assemble(bytes, |data, rows| layout.floats(data, rows))?)
    } else {
        Values::Integers(layout.assemble(bytes, |data, rows| layout.integers(data, rows))?)
    })
}

fn unsupported(what: &str) -> Reason {
    format!("its raw data has {what}, which is not supported; convert it to a DNG with lossless compression")
}

impl Encoding {
    /// Reads how samples are encoded.
    ///
    /// # Errors
    /// The reason, if this is not supported.
    pub(super) fn read<R: Read + Seek>(tags: &mut Tags<R>) -> Result<Self, Reason> {
        let samples = tags.number_or(tag::SAMPLES_PER_PIXEL, 1)? as usize;
        let all_bits = tags.numbers(tag::BITS).unwrap_or_default();
        let bits = all_bits.first().map_or(1, |&bits| bits as usize);
        let are_floats = tags.number_or(tag::SAMPLE_FORMAT, 1)? == 3;
        let are_known = if are_floats { matches!(bits, 16 | 24 | 32) } else { (8..=16).contains(&bits) };
        if !are_known || all_bits.iter().any(|&b| b as usize != bits) {
            return Err(unsupported(&format!("samples of {bits} bits")));
        }
        if samples > 1 && tags.number_or(tag::PLANAR, 1)? != 1 {
            return Err(unsupported("separate planes"));
        }
        let packing = match tags.number_or(tag::COMPRESSION, 1)? {
            1 => Packing::None,
            7 if !are_floats => Packing::LosslessJpeg,
            8 | 32946 => Packing::Deflate,
            34892 => return Err(unsupported("lossy compression")),
            52546 => return Err(unsupported("JPEG XL compression")),
            other => return Err(unsupported(&format!("compression {other}"))),
        };
        let predictor = match (tags.number_or(tag::PREDICTOR, 1)?, are_floats) {
            _ if packing != Packing::Deflate => Predictor::None,
            (1, _) => Predictor::None,
            (2, false) => Predictor::Difference(samples),
            (34892, false) => Predictor::Difference(2 * samples),
            (34893, false) => Predictor::Difference(4 * samples),
            (3, true) => Predictor::ByteDifference(samples),
            (34894, true) => Predictor::ByteDifference(2 * samples),
            (34895, true) => Predictor::ByteDifference(4 * samples),
            (other, _) => return Err(unsupported(&format!("predictor {other}"))),
        };
        if matches!(predictor, Predictor::Difference(_)) && !matches!(bits, 8 | 16) {
            return Err(unsupported(&format!("differences of {bits} bits")));
        }
        Ok(Encoding { samples, bits, are_floats, packing, predictor })
    }
}

impl Layout {
    fn read<R: Read + Seek>(bytes: &[u8], tags: &mut Tags<R>) -> Result<Self, Reason> {
        let encoding = Encoding::read(tags)?;
        let (width, height) = tags.size()?;
        let are_tiles = tags.numbers(tag::TILES).is_some();
        let ((chunk_width, chunk_height), places) = if are_tiles {
            let size = (tags.number(tag::TILE_WIDTH)? as usize, tags.number(tag::TILE_HEIGHT)? as usize);
            (size, [tag::TILES, tag::TILE_LENGTHS])
        } else {
            let rows = tags.number_or(tag::ROWS_PER_STRIP, height as u64)?.min(height as u64);
            ((width, rows as usize), [tag::STRIPS, tag::STRIP_LENGTHS])
        };
        // A tile is at most a little larger than the picture.
        let is_sensible = (1..=width + 4096).contains(&chunk_width) && (1..=height + 4096).contains(&chunk_height);
        let [offsets, lengths] = places.map(|tag| tags.numbers(tag).unwrap_or_default());
        let count = if is_sensible { width.div_ceil(chunk_width) * height.div_ceil(chunk_height) } else { 0 };
        if count == 0 || offsets.len() != count || lengths.len() != count {
            return Err(tags::damaged());
        }
        let place = |(&at, &length): (&u64, &u64)| {
            let range = usize::try_from(at).ok()?..usize::try_from(at.checked_add(length)?).ok()?;
            (range.end <= bytes.len()).then_some(range)
        };
        let places: Option<Vec<Range<usize>>> = offsets.iter().zip(&lengths).map(place).collect();
        let places = places.ok_or("the file is too short for its raw data (truncated); copy it again")?;
        Ok(Layout {
            size: (width * encoding.samples, height),
            chunk: (chunk_width * encoding.samples, chunk_height),
            are_tiles,
            encoding,
            places,
            is_little: tags.is_little(),
        })
    }

    /// Decodes all strips or tiles with `decode`, which gets their bytes and their number of rows.
    fn assemble<T: Copy + Default + Send + Sync>(
        &self,
        bytes: &[u8],
        decode: impl Fn(&[u8], usize) -> Result<Vec<T>, Reason> + Sync,
    ) -> Result<Plane<T>, Reason> {
        let ((width, height), (across, down)) = (self.size, self.chunk);
        let mut all: Vec<T> = limits::room(width * height)?;
        let in_row = width.div_ceil(across);
        all.par_chunks_mut(width * down).enumerate().try_for_each(|(row, rows)| {
            (0..in_row)
                .into_par_iter()
                .map(|column| {
                    let stored = if self.are_tiles { down } else { rows.len() / width };
                    decode(&bytes[self.places[row * in_row + column].clone()], stored)
                })
                .collect::<Result<Vec<_>, Reason>>()?
                .iter()
                .enumerate()
                .for_each(|(column, chunk)| {
                    let first = column * across;
                    let length = across.min(width - first);
                    for (row, part) in rows.chunks_exact_mut(width).zip(chunk.chunks_exact(across)) {
                        row[first..first + length].copy_from_slice(&part[..length]);
                    }
                });
            Ok::<(), Reason>(())
        })?;
        Ok(Plane::from_vec(width, height, all))
    }

    /// The bytes of a strip or tile with `rows` rows, decompressed.
    fn unpacked(&self, data: &[u8], rows: usize) -> Result<Vec<u8>, Reason> {
        let length = (self.chunk.0 * self.encoding.bits).div_ceil(8) * rows;
        let mut bytes = limits::room(length)?;
        let mut reader: Box<dyn Read + '_> =
            if self.encoding.packing == Packing::Deflate { Box::new(ZlibDecoder::new(data)) } else { Box::new(data) };
        reader.read_exact(&mut bytes).map_err(|_| "its raw data is damaged or truncated; copy the file again")?;
        Ok(bytes)
    }

    fn integers(&self, data: &[u8], rows: usize) -> Result<Vec<u16>, Reason> {
        let across = self.chunk.0;
        if self.encoding.packing == Packing::LosslessJpeg {
            return Ok(lossless_jpeg::decode(data, across * rows)?.values);
        }
        let bytes = self.unpacked(data, rows)?;
        let mut values: Vec<u16> = match self.encoding.bits {
            8 => bytes.iter().map(|&b| u16::from(b)).collect(),
            16 => {
                let word = |b: &[u8]| if self.is_little { [b[1], b[0]] } else { [b[0], b[1]] };
                bytes.chunks_exact(2).map(|b| u16::from_be_bytes(word(b))).collect()
            }
            bits => {
                let mut values = limits::reserved(across * rows)?;
                for row in bytes.chunks_exact((across * bits).div_ceil(8)) {
                    values.extend(bit_fields(row, bits).take(across));
                }
                values
            }
        };
        if let Predictor::Difference(stride) = self.encoding.predictor {
            for row in values.chunks_exact_mut(across) {
                for x in stride..across {
                    row[x] = row[x].wrapping_add(row[x - stride]);
                }
            }
            if self.encoding.bits == 8 {
                values.iter_mut().for_each(|v| *v &= 255);
            }
        }
        Ok(values)
    }

    fn floats(&self, data: &[u8], rows: usize) -> Result<Vec<f32>, Reason> {
        let (across, size) = (self.chunk.0, self.encoding.bits / 8);
        let mut bytes = self.unpacked(data, rows)?;
        let mut values = limits::reserved(across * rows)?;
        for row in bytes.chunks_exact_mut(across * size) {
            let Predictor::ByteDifference(stride) = self.encoding.predictor else {
                let order = |sample: &[u8]| {
                    let add = |sum: u32, b: &u8| sum << 8 | u32::from(*b);
                    if self.is_little { sample.iter().rev().fold(0, add) } else { sample.iter().fold(0, add) }
                };
                values.extend(row.chunks_exact(size).map(|sample| float(order(sample), size)));
                continue;
            };
            for i in stride..row.len() {
                row[i] = row[i].wrapping_add(row[i - stride]);
            }
            let bits = |x: usize| (0..size).fold(0, |sum, k| sum << 8 | u32::from(row[k * across + x]));
            values.extend((0..across).map(|x| float(bits(x), size)));
        }
        Ok(values)
    }
}

/// The fields of `bits` bits (at most 16) of a row, highest bit first.
fn bit_fields(row: &[u8], bits: usize) -> impl Iterator<Item = u16> {
    let (mut held, mut count) = (0u32, 0);
    row.iter().filter_map(move |&byte| {
        held = held << 8 | u32::from(byte);
        count += 8;
        (count >= bits).then(|| {
            count -= bits;
            (held >> count) as u16 & ((1u32 << bits) - 1) as u16
        })
    })
}

/// The float with these bits, of `size` bytes: 4 (IEEE 754), 3 (7 bits of exponent, 16 of mantissa) or 2 (5 and 10).
fn float(bits: u32, size: usize) -> f32 {
    let (exponents, mantissas) = match size {
        4 => return f32::from_bits(bits),
        3 => (7, 16),
        _ => (5, 10),
    };
    let is_negative = bits >> (exponents + mantissas) & 1 == 1;
    let (exponent, mantissa) = ((bits >> mantissas) & ((1 << exponents) - 1), bits & ((1 << mantissas) - 1));
    let bias = (1 << (exponents - 1)) - 1;
    let magnitude = if exponent == (1 << exponents) - 1 {
        if mantissa == 0 { f32::INFINITY } else { f32::NAN }
    } else {
        // Below the least exponent, the mantissa has no leading one.
        let (whole, exponent) = if exponent == 0 { (mantissa, 1) } else { (mantissa | 1 << mantissas, exponent) };
        whole as f32 * libm::exp2f(exponent as f32 - (bias + mantissas) as f32)
    };
    if is_negative { -magnitude } else { magnitude }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_those_of_the_bits() {
        let fields: Vec<u16> = bit_fields(&[0b1010_1100, 0b0111_0101, 0b1111_0000], 12).collect();
        assert_eq!(fields, [0b1010_1100_0111, 0b0101_1111_0000]);
        let fields: Vec<u16> = bit_fields(&[0xFF, 0x80, 0x01, 0x40, 0x20], 10).collect();
        assert_eq!(fields, [0b11_1111_1110, 0, 0b101_0000, 0b10_0000]);
    }

    #[test]
    fn short_floats_have_their_values() {
        for (bits, value) in [(0x3C00, 1.0), (0xC000, -2.0), (0x7BFF, 65504.0), (0x0001, 2f32.powi(-24)), (0, 0.0)] {
            assert_eq!(float(bits, 2), value, "{bits:x}");
        }
        assert!(float(0x7E00, 2).is_nan() && float(0xFC00, 2) == f32::NEG_INFINITY);
        for (bits, value) in [(0x3F_0000, 1.0), (0xC0_8000, -3.0), (0x00_0001, 2f32.powi(-78))] {
            assert_eq!(float(bits, 3), value, "{bits:x}");
        }
        assert_eq!(float(0x4049_0FDB, 4), std::f32::consts::PI);
    }
}
