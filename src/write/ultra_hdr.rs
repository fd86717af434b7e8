//! Ultra HDR: a JPEG that every program reads, and behind it a gain map that lights it up on an HDR display.
//!
//! In: radiance and the picture, by rows. Out: one file of two JPEGs: the picture with GContainer XMP, the ISO version block and the
//! multi-picture index, and the map with its numbers as XMP and as the ISO block. Cost: 35 ns a pixel and core. Memory: both encoded, about
//! two bytes a pixel, as the head of the file tells their sizes.
//! Source: Google, "Ultra HDR Image Format v1.1"; ISO 21496-1:2025, annex C; CIPA DC-007 (MPF), sections 5.2 and A.2; libultrahdr, the
//! layout described at `JpegR::appendGainMap`.
//!
//! Gains are of what the encoded picture decodes to, not of what it was encoded from: what the JPEG of the picture loses, the map
//! gives back.

use super::exif;
use super::gain_map::{Gains, OFFSET, Rendition, Resolution, STRIP_ROWS};
use super::jpeg::{self, APP1, APP2, MOST_SIDE, Strip, Strips, put_segment};
use super::metadata::{Metadata, one_line};
use super::staging::{Pending, Written};
use crate::bracket::colour::Profile;
use crate::error::{Error, Result};
use crate::tonemap::codes::Colours;
use rayon::prelude::*;
use std::io;
use std::path::Path;

/// How `.jpg` is encoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// The quality of the picture, 1 to 100, on the scale of libjpeg. Default: 93.
    pub quality: u8,
    /// How large the gain map is. Default: full.
    pub gain_map: Resolution,
}

impl Default for Options {
    fn default() -> Self {
        Options { quality: 93, gain_map: Resolution::Full }
    }
}

impl Options {
    /// Whether the quality is one.
    ///
    /// # Errors
    /// [`Error::Option`].
    pub fn validate(&self) -> Result<()> {
        if (1..=100).contains(&self.quality) {
            return Ok(());
        }
        let reason = format!("{} is no quality; give 1 to 100", self.quality);
        Err(Error::Option { option: "--jpeg-quality", reason })
    }
}

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

/// The map as far as it is.
struct Map {
    gains: Gains,
    rendition: Rendition,
    step: usize,
    strips: Strips,
    software: String,
}

impl Writer {
    /// Begins a file of `size` pixels, a picture of `colours`, of which the [`profile`](Metadata::profile) is; without one it is sRGB and says so.
    ///
    /// # Errors
    /// [`Error::Write`]: JPEG holds no side longer than 65500.
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

    /// Takes the next rows of either or both, whole and without gaps.
    ///
    /// # Errors
    /// [`Error::Write`].
    ///
    /// # Panics
    /// When a row is not whole or there are more than the picture has.
    pub fn push(&mut self, radiance: &[[f32; 3]], shown: &[[u8; 3]]) -> Result<()> {
        let (width, height) = self.size;
        let missing = (height - self.done) * width;
        let come = (self.radiance.len() + radiance.len(), self.shown.len() + shown.len());
        assert!(
            radiance.len().is_multiple_of(width) && shown.len().is_multiple_of(width) && come.0.max(come.1) <= missing,
            "rows come whole, and not more than there are"
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

    /// Encodes whole strips, side by side.
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

    /// Puts the file together after the last row.
    ///
    /// # Errors
    /// [`Error::Write`] when the disk fails or rows are missing.
    pub fn finish(self) -> Result<Written> {
        let Writer { mut file, size, segments, base, map, done, radiance, .. } = self;
        if done < size.1 {
            let given = done + radiance.len() / size.0.max(1);
            let missing = io::Error::other(format!("only {given} of {} rows were given", size.1));
            return Err(file.error(missing));
        }
        let parts = put_together(base, map, segments).map_err(|e| file.error(e))?;
        for part in parts {
            file.put(&part)?;
        }
        Written::ended(file, Vec::new())
    }
}

/// Whether JPEG holds a picture of this size.
fn check_size(path: &Path, (width, height): (usize, usize)) -> Result<()> {
    if width.max(height) <= MOST_SIDE {
        return Ok(());
    }
    let reason =
        format!("JPEG holds no side longer than {MOST_SIDE} pixels, and this has {width} x {height}; name a .png");
    Err(Error::Write { path: path.to_owned(), source: io::Error::new(io::ErrorKind::InvalidInput, reason) })
}

/// What both kinds of file begin with: JFIF, EXIF, the profile.
fn segments(size: (usize, usize), metadata: &Metadata) -> io::Result<Vec<u8>> {
    let mut out = Vec::new();
    jpeg::put_jfif(&mut out)?;
    if let Some(exif) = exif::block(size, metadata) {
        put_segment(APP1, &[b"Exif\0\0", &exif], &mut out)?;
    }
    let profile = metadata.profile.clone().or_else(Profile::srgb);
    if let Some(profile) = &profile {
        jpeg::put_profile(profile, &mut out)?;
    }
    Ok(out)
}

/// The file, in parts.
fn put_together(base: Strips, map: Option<Map>, mut segments: Vec<u8>) -> io::Result<Vec<Vec<u8>>> {
    let Some(map) = map else { return Ok(base.end(&segments)?.into()) };
    let mut map_segments = Vec::new();
    put_xmp(&map_xmp(&map.rendition, &map.software), &mut map_segments)?;
    put_segment(APP2, &[ISO, &VERSION, &iso_numbers(&map.rendition)], &mut map_segments)?;
    let second = map.strips.end(&map_segments)?;
    let second_size = second[0].len() + second[1].len();
    put_xmp(&primary_xmp(second_size, &map.software), &mut segments)?;
    put_segment(APP2, &[ISO, &VERSION], &mut segments)?;
    // The index comes last of the segments: from its header on the second image is counted.
    let index_at = 2 + segments.len() + MPF_HEADER;
    let first_size = base.bytes_without_segments() + segments.len() + 4 + MPF.len() + MPF_BYTES;
    let offset = first_size - index_at;
    put_segment(APP2, &[MPF, &index(first_size, second_size, offset)?], &mut segments)?;
    let mut parts = Vec::from(base.end(&segments)?);
    debug_assert_eq!(parts[0].len() + parts[1].len(), first_size, "the index tells the size of the first image");
    parts.extend(second);
    Ok(parts)
}

const ISO: &[u8] = b"urn:iso:std:iso:ts:21496:-1\0";
/// The least version that a reader must know, and the writer's.
const VERSION: [u8; 4] = [0; 4];
const MPF: &[u8] = b"MPF\0";
/// Bytes of the index from its header on: header, three tags, two entries.
const MPF_BYTES: usize = 8 + 2 + 3 * 12 + 4 + 2 * 16;
/// From the start of the index's segment to its header.
const MPF_HEADER: usize = 4 + MPF.len();

/// The multi-picture index (DC-007, 5.2): sizes of both images, and where the second begins, from the index's header on.
fn index(first: usize, second: usize, offset: usize) -> io::Result<Vec<u8>> {
    let four = |n: usize| {
        let number = u32::try_from(n).map_err(|_| io::Error::other("JPEG with a gain map holds no 4 GB; name a .png"));
        number.map(u32::to_be_bytes)
    };
    four(first.saturating_add(second))?;
    let mut out = b"MM\0*\0\0\0\x08\0\x03".to_vec();
    // Version 0100; two images; their entries.
    out.extend_from_slice(b"\xB0\0\0\x07\0\0\0\x040100");
    out.extend_from_slice(b"\xB0\x01\0\x04\0\0\0\x01\0\0\0\x02");
    out.extend_from_slice(b"\xB0\x02\0\x07\0\0\0\x20\0\0\0\x32");
    out.extend_from_slice(&[0; 4]);
    // The first is the representative one, a baseline primary image; of what kind the second is, the standard has no word for.
    for (kind, size, offset) in [([0, 3, 0, 0], first, 0), ([0; 4], second, offset)] {
        out.extend_from_slice(&kind);
        out.extend_from_slice(&four(size)?);
        out.extend_from_slice(&four(offset)?);
        out.extend_from_slice(&[0; 4]);
    }
    Ok(out)
}

/// The numbers of `rendition` as ISO 21496-1 has them, after the version: one channel's for all, in the picture's primaries.
fn iso_numbers(rendition: &Rendition) -> Vec<u8> {
    const IN_BASE_SPACE: u8 = 0x40;
    // The numbers are whole multiples of 1/1024 within +-16: the cast is exact.
    let fraction = |value: f64| [((value * 1024.0).round() as i32).to_be_bytes(), 1024i32.to_be_bytes()];
    let Rendition { least_stops, most_stops, headroom_stops, .. } = *rendition;
    let mut out = vec![IN_BASE_SPACE];
    for value in [0.0, headroom_stops, least_stops, most_stops, 1.0, OFFSET, OFFSET] {
        out.extend_from_slice(fraction(value).as_flattened());
    }
    out
}

fn put_xmp(packet: &str, out: &mut Vec<u8>) -> io::Result<()> {
    put_segment(APP1, &[b"http://ns.adobe.com/xap/1.0/\0", packet.as_bytes()], out)
}

/// An XMP packet of the attributes and content `description`. It ends with a line: ImageMagick overwrites the last byte before it reads.
fn packet(software: &str, description: &str) -> String {
    let software: String = software.chars().filter(|c| !matches!(c, '<' | '>' | '&' | '"')).collect();
    format!(
        r#"<x:xmpmeta xmlns:x="adobe:ns:meta/" x:xmptk="{software}"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" {description}</rdf:RDF></x:xmpmeta>
"#
    )
}

/// The XMP of the picture: that there is a gain map, and how long it is.
fn primary_xmp(map_size: usize, software: &str) -> String {
    let item = |semantic: &str, length: String| {
        format!(
            r#"<rdf:li rdf:parseType="Resource"><Container:Item Item:Semantic="{semantic}" Item:Mime="image/jpeg"{length}/></rdf:li>"#
        )
    };
    let items = item("Primary", String::new()) + &item("GainMap", format!(r#" Item:Length="{map_size}""#));
    let namespaces = r#"xmlns:Container="http://ns.google.com/photos/1.0/container/" xmlns:Item="http://ns.google.com/photos/1.0/container/item/" xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/""#;
    packet(
        software,
        &format!(
            r#"{namespaces} hdrgm:Version="1.0"><Container:Directory><rdf:Seq>{items}</rdf:Seq></Container:Directory></rdf:Description>"#
        ),
    )
}

/// The XMP of the map: its numbers, in stops.
fn map_xmp(rendition: &Rendition, software: &str) -> String {
    let Rendition { least_stops, most_stops, headroom_stops, .. } = rendition;
    packet(
        software,
        &format!(
            r#"xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/" hdrgm:Version="1.0" hdrgm:GainMapMin="{least_stops}" hdrgm:GainMapMax="{most_stops}" hdrgm:Gamma="1" hdrgm:OffsetSDR="{OFFSET}" hdrgm:OffsetHDR="{OFFSET}" hdrgm:HDRCapacityMin="0" hdrgm:HDRCapacityMax="{headroom_stops}" hdrgm:BaseRenditionIsHDR="False"/>"#
        ),
    )
}
