//! The samples of a picture, decoded by the `tiff` crate, strip by strip or tile by tile.
//!
//! In: a decoder. Out: samples, interleaved. Cost: the `tiff` crate, and one copy of the samples. Source: TIFF 6.0
//! (section 15).

use super::{Reason, refusal};
use crate::limits;
use std::io::{Read, Seek};
use tiff::decoder::{Decoder, DecodingResult};
use tiff::tags::Tag;

/// Returns the first `wanted` samples of each pixel of the decoder's current picture, pixel by pixel. The file may
/// have strips, tiles or separate planes. Samples of fewer than 8 bits are scaled to the range 0..=255. The
/// photometric interpretation must have been set to [grey](super::as_grey).
///
/// The `tiff` crate's function for a whole picture is not used: it panics if tiles of a separate plane extend beyond
/// the lower edge, and it reports LZW tiles that extend beyond an edge as damaged. The crate's function for a single
/// tile reads both correctly.
///
/// # Errors
/// The reason why the samples cannot be read.
pub(crate) fn samples<R: Read + Seek>(decoder: &mut Decoder<R>, wanted: usize) -> Result<DecodingResult, Reason> {
    let (width, height) = decoder.dimensions().map_err(refusal)?;
    let kind = decoder.colortype().map_err(refusal)?;
    let is_planar = decoder.find_tag_unsigned::<u16>(Tag::PlanarConfiguration).map_err(refusal)? == Some(2);
    let stored = usize::from(kind.num_samples());
    if stored < wanted {
        return Err(format!(
            "it has {stored} samples per pixel, but its colours need {wanted}; save it as grey or RGB"
        ));
    }
    let (planes, per_chunk) = if is_planar { (wanted, 1) } else { (1, stored) };
    let (chunk_width, chunk_height) = decoder.chunk_dimensions();
    let (across, down) = (width.div_ceil(chunk_width), height.div_ceil(chunk_height));
    let size = (width as usize, height as usize);
    let depth = kind.bit_depth();
    let bits = u64::from(chunk_width) * per_chunk as u64 * u64::from(depth);
    let row_bytes = usize::try_from(bits.div_ceil(8)).map_err(|_| "its tiles are too large for this machine")?;
    let in_row = chunk_width as usize * per_chunk;
    let mut all: Option<DecodingResult> = None;
    let mut chunk = DecodingResult::U8(Vec::new());
    for plane in 0..planes {
        for (row, column) in (0..down).flat_map(|row| (0..across).map(move |column| (row, column))) {
            let index = (plane as u32 * down + row) * across + column;
            decoder.read_chunk_to_buffer(&mut chunk, index, row_bytes).map_err(refusal)?;
            let chunk = match &chunk {
                DecodingResult::U8(packed) if depth < 8 => &DecodingResult::U8(unpacked(packed, in_row, depth)),
                chunk => chunk,
            };
            let place = Place {
                size,
                wanted,
                per_chunk,
                corner: ((column * chunk_width) as usize, (row * chunk_height) as usize),
                chunk_width: chunk_width as usize,
                plane: is_planar.then_some(plane),
            };
            use DecodingResult::{F16, F32, F64, U8, U16};
            match (chunk, &mut all) {
                (U8(chunk), None) => all = Some(U8(place.started(chunk)?)),
                (U16(chunk), None) => all = Some(U16(place.started(chunk)?)),
                (F16(chunk), None) => all = Some(F16(place.started(chunk)?)),
                (F32(chunk), None) => all = Some(F32(place.started(chunk)?)),
                (F64(chunk), None) => all = Some(F64(place.started(chunk)?)),
                (U8(chunk), Some(U8(all))) => place.put(chunk, all),
                (U16(chunk), Some(U16(all))) => place.put(chunk, all),
                (F16(chunk), Some(F16(all))) => place.put(chunk, all),
                (F32(chunk), Some(F32(all))) => place.put(chunk, all),
                (F64(chunk), Some(F64(all))) => place.put(chunk, all),
                _ => {
                    return Err(format!(
                        "its samples are signed or {depth}-bit integers, which are not supported; save it with unsigned 8-bit or 16-bit samples, or, for radiance, with floats"
                    ));
                }
            }
        }
    }
    all.ok_or_else(|| "it has no pixels".into())
}

/// The position of a chunk (strip or tile) and the layout of its samples.
struct Place {
    /// Size of the picture, in pixels.
    size: (usize, usize),
    /// Number of samples per pixel in the result.
    wanted: usize,
    /// Number of samples per pixel in the chunk: all that are stored, or 1 if the planes are separate.
    per_chunk: usize,
    /// Position of the chunk in the picture.
    corner: (usize, usize),
    /// Width of the chunk in pixels.
    chunk_width: usize,
    /// Index of the sample that the chunk contains, if the planes are separate.
    plane: Option<usize>,
}

impl Place {
    /// Returns a new picture that contains `chunk`; the other samples are 0.
    fn started<T: Copy + Default>(&self, chunk: &[T]) -> Result<Vec<T>, Reason> {
        let mut all = limits::room(self.size.0 * self.size.1 * self.wanted)?;
        self.put(chunk, &mut all);
        Ok(all)
    }

    /// Copies `chunk` into the picture `all`. Pixels beyond the right or the lower edge of the picture are dropped.
    fn put<T: Copy>(&self, chunk: &[T], all: &mut [T]) {
        let Place { size, wanted, per_chunk, corner, chunk_width, plane } = *self;
        let rows = all.chunks_exact_mut(size.0 * wanted).skip(corner.1);
        for (row, part) in rows.zip(chunk.chunks_exact(chunk_width * per_chunk)) {
            let row = &mut row[corner.0 * wanted..];
            if wanted == per_chunk {
                row.iter_mut().zip(part).for_each(|(all, &v)| *all = v);
                continue;
            }
            for (pixel, part) in row.chunks_exact_mut(wanted).zip(part.chunks_exact(per_chunk)) {
                match plane {
                    None => pixel.copy_from_slice(&part[..wanted]),
                    Some(plane) => pixel[plane] = part[0],
                }
            }
        }
    }
}

/// Converts samples of `depth` bits (fewer than 8) to bytes in the range 0..=255. Each row has `count` samples and is
/// padded to whole bytes.
fn unpacked(packed: &[u8], count: usize, depth: u8) -> Vec<u8> {
    let depth = usize::from(depth.max(1));
    let max = (1u16 << depth) - 1;
    let row = (count * depth).div_ceil(8).max(1);
    packed
        .chunks_exact(row)
        .flat_map(|bytes| {
            (0..count).map(move |x| {
                let bit = x * depth;
                // Two consecutive bytes are read, because a sample may cross a byte boundary.
                let next = bytes.get(bit / 8 + 1).copied().unwrap_or(0);
                let word = u16::from_be_bytes([bytes[bit / 8], next]);
                let value = (word >> (16 - depth - bit % 8)) & max;
                (value * 255 / max) as u8
            })
        })
        .collect()
}
