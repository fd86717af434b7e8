//! The JPEG writer: the picture in strips, its gain map, and the file with both.
//!
//! In: radiance and the picture, by rows. Out: a `.jpg` file. Cost and source: see [`super`].

use super::Options;
use super::gain_map::{Gains, Rendition, STRIP_ROWS};
use super::strips::{self, APP1, APP2, MOST_SIDE, Strip, Strips, put_segment};
use super::ultra_hdr::{ISO, MPF, MPF_BYTES, MPF_HEADER, VERSION, index, iso_numbers, map_xmp, primary_xmp, put_xmp};
use crate::bracket::colour::Profile;
use crate::error::{Error, Result};
use crate::tonemap::display::codes::Colours;
use crate::write::exif;
use crate::write::metadata::{Metadata, one_line};
use crate::write::staging::{Pending, Written};
use rayon::prelude::*;
use std::io;
use std::path::Path;

/// The `.jpg` writer.
pub struct Writer {
    file: Pending,
    size: (usize, usize),
    quality: u8,
    segments: Vec<u8>,
    base: Strips,
    map: Option<Map>,
    done: usize,
    radiance: Vec<[f32; 3]>,
    shown: Vec<[u8; 3]>,
}

/// The part of the gain map that has been encoded so far, and how to encode the rest.
struct Map {
    gains: Gains,
    rendition: Rendition,
    step: usize,
    strips: Strips,
    software: String,
}

impl Writer {
    /// Starts a file of `size` pixels with `colours`, described by the [`profile`](Metadata::profile); without a
    /// profile the picture is sRGB and marked as such.
    ///
    /// # Errors
    /// [`Error::Write`] if a side is longer than 65500 px.
    pub fn new(
        file: Pending,
        size: (usize, usize),
        metadata: &Metadata,
        (options, colours): (&Options, Colours),
        rendition: &Rendition,
    ) -> Result<Self> {
        options.validate()?;
        check_size(file.target(), size)?;
        let segments = segments(size, metadata).map_err(|e| file.error(e))?;
        let map = options.gain_map.step().map(|step| {
            let map_size = (size.0.div_ceil(step), size.1.div_ceil(step));
            Map {
                gains: Gains::new(rendition, &metadata.primaries, colours),
                rendition: *rendition,
                step,
                strips: Strips::new(map_size, STRIP_ROWS / step),
                software: one_line(&metadata.software),
            }
        });
        Ok(Writer {
            file,
            size,
            quality: options.quality,
            segments,
            base: Strips::new(size, STRIP_ROWS),
            map,
            done: 0,
            radiance: Vec::new(),
            shown: Vec::new(),
        })
    }

    /// Adds the next complete rows of radiance, of the picture, or of both, in order.
    ///
    /// # Errors
    /// [`Error::Write`].
    ///
    /// # Panics
    /// If a row is incomplete, or there are more rows than the picture has.
    pub fn push(&mut self, radiance: &[[f32; 3]], shown: &[[u8; 3]]) -> Result<()> {
        let (width, height) = self.size;
        let missing = (height - self.done) * width;
        let come = (self.radiance.len() + radiance.len(), self.shown.len() + shown.len());
        assert!(
            radiance.len().is_multiple_of(width) && shown.len().is_multiple_of(width) && come.0.max(come.1) <= missing,
            "only complete rows can be written, and only as many as the picture has"
        );
        let both = come.0.min(come.1);
        let ready = if both == missing { both } else { both / (STRIP_ROWS * width) * (STRIP_ROWS * width) };
        if self.radiance.is_empty() && self.shown.is_empty() {
            self.encode(&radiance[..ready], &shown[..ready])?;
            self.radiance.extend_from_slice(&radiance[ready..]);
            self.shown.extend_from_slice(&shown[ready..]);
        } else {
            self.radiance.extend_from_slice(radiance);
            self.shown.extend_from_slice(shown);
            if ready > 0 {
                let (mut radiance, mut shown) = (std::mem::take(&mut self.radiance), std::mem::take(&mut self.shown));
                self.encode(&radiance[..ready], &shown[..ready])?;
                radiance.drain(..ready);
                shown.drain(..ready);
                (self.radiance, self.shown) = (radiance, shown);
            }
        }
        Ok(())
    }

    /// Encodes complete strips in parallel.
    fn encode(&mut self, radiance: &[[f32; 3]], shown: &[[u8; 3]]) -> Result<()> {
        let (width, quality, map) = (self.size.0, self.quality, self.map.as_ref());
        let strip = STRIP_ROWS * width;
        let encoded: Vec<io::Result<(Strip, Option<Strip>)>> = radiance
            .par_chunks(strip)
            .zip(shown.par_chunks(strip))
            .map(|(radiance, shown)| {
                let base = Strip::encode(shown, width, quality)?;
                let Some(map) = map else { return Ok((base, None)) };
                let decoded = base.decoded()?;
                let (decoded, _) = decoded.as_chunks::<3>();
                let codes = map.gains.codes(radiance, decoded, width, map.step);
                Ok((base, Some(Strip::encode(&codes, width.div_ceil(map.step), map.rendition.map_quality())?)))
            })
            .collect();
        for strips in encoded {
            let (base, gains) = strips.map_err(|e| self.file.error(e))?;
            self.base.push(&base);
            if let (Some(map), Some(gains)) = (&mut self.map, &gains) {
                map.strips.push(gains);
            }
        }
        self.done += radiance.len() / width;
        Ok(())
    }

    /// Writes the file after the last row.
    ///
    /// # Errors
    /// [`Error::Write`] if writing fails or rows are missing.
    pub fn finish(self) -> Result<Written> {
        let Writer { mut file, size, segments, base, map, done, radiance, .. } = self;
        if done < size.1 {
            let given = done + radiance.len() / size.0.max(1);
            let missing = io::Error::other(format!("only {given} of the {} rows of pixels were written", size.1));
            return Err(file.error(missing));
        }
        let parts = put_together(base, map, segments).map_err(|e| file.error(e))?;
        for part in parts {
            file.put(&part)?;
        }
        Written::ended(file, Vec::new())
    }
}

/// Checks that JPEG supports a picture of this size.
fn check_size(path: &Path, (width, height): (usize, usize)) -> Result<()> {
    if width.max(height) <= MOST_SIDE {
        return Ok(());
    }
    let reason = format!(
        "a side of a JPEG has at most {MOST_SIDE} pixels, and this picture has {width} x {height}; write a .png instead"
    );
    Err(Error::Write { path: path.to_owned(), source: io::Error::new(io::ErrorKind::InvalidInput, reason) })
}

/// Returns the first segments of a file, with or without a gain map: JFIF, EXIF, the profile.
fn segments(size: (usize, usize), metadata: &Metadata) -> io::Result<Vec<u8>> {
    let mut out = Vec::new();
    strips::put_jfif(&mut out)?;
    if let Some(exif) = exif::block(size, metadata) {
        put_segment(APP1, &[b"Exif\0\0", &exif], &mut out)?;
    }
    let profile = metadata.profile.clone().or_else(Profile::srgb);
    if let Some(profile) = &profile {
        strips::put_profile(profile, &mut out)?;
    }
    Ok(out)
}

/// Returns the file, in parts.
fn put_together(base: Strips, map: Option<Map>, mut segments: Vec<u8>) -> io::Result<Vec<Vec<u8>>> {
    let Some(map) = map else { return Ok(base.end(&segments)?.into()) };
    let mut map_segments = Vec::new();
    put_xmp(&map_xmp(&map.rendition, &map.software), &mut map_segments)?;
    put_segment(APP2, &[ISO, &VERSION, &iso_numbers(&map.rendition)], &mut map_segments)?;
    let second = map.strips.end(&map_segments)?;
    let second_size = second[0].len() + second[1].len();
    put_xmp(&primary_xmp(second_size, &map.software), &mut segments)?;
    put_segment(APP2, &[ISO, &VERSION], &mut segments)?;
    // The index is the last segment: the offset of the second image is relative to the header of the index.
    let index_at = 2 + segments.len() + MPF_HEADER;
    let first_size = base.bytes_without_segments() + segments.len() + 4 + MPF.len() + MPF_BYTES;
    let offset = first_size - index_at;
    put_segment(APP2, &[MPF, &index(first_size, second_size, offset)?], &mut segments)?;
    let mut parts = Vec::from(base.end(&segments)?);
    debug_assert_eq!(
        parts[0].len() + parts[1].len(),
        first_size,
        "the first image has another length in bytes than its entry in the MPF index"
    );
    parts.extend(second);
    Ok(parts)
}
