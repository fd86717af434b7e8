//! DNG files: TIFF files with the samples of a sensor.
//!
//! In: the bytes of a file. Out: a [`Sensor`]. Cost: decompression, strip by strip or tile by tile, in parallel; one
//! copy of the samples. Source: DNG, chapters 2 and 4.

use super::chunks::{self, Encoding};
use super::colour::CameraColour;
use super::levels::Levels;
use super::tags::{self, Tags, tag};
use super::{Area, Pattern, Reason, Sensor, opcodes};
use crate::limits::Limits;
use std::io::{Cursor, Read, Seek};

/// Memory of a sample: as stored (integer or float) and linear.
const SAMPLE_BYTES: u64 = 8;
/// Memory of a pixel: three encoded colours.
const PIXEL_BYTES: u64 = 6;

/// Reads the file `bytes`. Also returns the memory in bytes needed to develop it, including the bytes of the file.
///
/// # Errors
/// The reason, if the file is damaged or of a kind that is not supported, or larger than `limits` allow.
pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<(Sensor, u64), Reason> {
    let mut tags = Tags::of(Cursor::new(bytes)).ok_or_else(tags::damaged)?;
    let (width, height) = tags.size()?;
    limits.check_size(width, height)?;
    let samples = tags.number_or(tag::SAMPLES_PER_PIXEL, 1)?;
    let pixels = width as u64 * height as u64;
    let needed = bytes.len() as u64 + pixels * (SAMPLE_BYTES * samples + PIXEL_BYTES);
    limits.check_memory((width, height), needed)?;
    let pattern = pattern(&mut tags)?;
    let active = active(&mut tags, (width, height))?;
    let crop = crop(&mut tags, active)?;
    let levels = Levels::read(&mut tags, samples as usize)?;
    let colour = CameraColour::read(&mut tags)?;
    let gains = opcodes::read(&mut tags)?;
    let values = chunks::read(bytes, &mut tags)?;
    Ok((Sensor { values, pattern, active, crop, levels, gains, colour }, needed))
}

/// The width and height of the picture that developers show, and why [`read`] would reject this kind of file.
///
/// # Errors
/// The reason, if the tags of the file are damaged.
pub(in crate::bracket) fn head(reader: impl Read + Seek) -> Result<((usize, usize), Option<Reason>), Reason> {
    let mut tags = Tags::of(reader).ok_or_else(tags::damaged)?;
    let size = tags.size()?;
    let active = active(&mut tags, size)?;
    let Area { width, height, .. } = crop(&mut tags, active)?;
    let refused = pattern(&mut tags).err().or_else(|| Encoding::read(&mut tags).err());
    let refused = refused.or_else(|| CameraColour::read(&mut tags).err());
    Ok(((width, height), refused))
}

/// The colour filters; none if there are three samples for each pixel.
fn pattern<R: Read + Seek>(tags: &mut Tags<R>) -> Result<Option<Pattern>, Reason> {
    let samples = tags.number_or(tag::SAMPLES_PER_PIXEL, 1)?;
    match (tags.number(tag::PHOTOMETRIC)?, samples) {
        (tags::MOSAIC, 1) => {
            let dimensions = tags.numbers(tag::PATTERN_SIZE).unwrap_or_else(|| vec![2, 2]);
            let colours = tags.numbers(tag::PATTERN).ok_or_else(tags::damaged)?;
            let [rows, columns] = dimensions[..] else { return Err(tags::damaged()) };
            Ok(Some(Pattern::new((columns as usize, rows as usize), &colours)?))
        }
        (tags::LINEAR, 3) => Ok(None),
        (tags::MOSAIC | tags::LINEAR, _) => Err(format!(
            "its raw data has {samples} samples per pixel, which is not supported; develop it to 16-bit TIFF first"
        )),
        _ => Err("it is a DNG without raw data; save its picture as 16-bit TIFF".into()),
    }
}

/// The active area; the whole picture where the file has none.
fn active<R: Read + Seek>(tags: &mut Tags<R>, (width, height): (usize, usize)) -> Result<Area, Reason> {
    let Some(area) = tags.numbers(tag::ACTIVE_AREA) else { return Ok(Area { left: 0, top: 0, width, height }) };
    let [top, left, bottom, right] = area[..] else { return Err(tags::damaged()) };
    let is_valid = top < bottom && left < right && bottom <= height as u64 && right <= width as u64;
    let [top, left, bottom, right] = [top, left, bottom, right].map(|v| v as usize);
    is_valid.then(|| Area { left, top, width: right - left, height: bottom - top }).ok_or_else(tags::damaged)
}

/// The part of the active area that developers show. Fractions are rounded inwards.
fn crop<R: Read + Seek>(tags: &mut Tags<R>, active: Area) -> Result<Area, Reason> {
    let whole = Area { left: 0, top: 0, ..active };
    let (Some(origin), Some(size)) = (tags.reals(tag::CROP_ORIGIN), tags.reals(tag::CROP_SIZE)) else {
        return Ok(whole);
    };
    let ([x, y], [width, height]) = (&origin[..], &size[..]) else { return Err(tags::damaged()) };
    let range = |at: f64, length: f64, most: usize| {
        let (first, end) = (at.ceil(), (at + length).floor());
        let is_valid = first >= 0.0 && first < end && end <= most as f64;
        is_valid.then_some((first as usize, (end - first) as usize))
    };
    let across = range(*x, *width, active.width).ok_or_else(tags::damaged)?;
    let down = range(*y, *height, active.height).ok_or_else(tags::damaged)?;
    Ok(Area { left: across.0, top: down.0, width: across.1, height: down.1 })
}
