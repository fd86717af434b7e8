//! TIFF: grey, RGB and CMYK, at 8 or 16 bit, in strips, tiles or planes.
//!
//! In: the file. Out: RGB at the file's depth; grey of fewer than 8 bit becomes 8. Cost: that of the `tiff` crate.
//! Source: TIFF 6.0; TIFF/EP and DNG for the tags that tell a camera raw file.

use super::{Found, Reason, Stored, cmyk_to_rgb, to_rgb};
use crate::bracket::Samples;
use crate::limits::{self, Limits as Allowed};
use exif::experimental::Writer;
use exif::{Context, Field, In};
use std::io::{Cursor, Read, Seek};
use tiff::ColorType;
use tiff::decoder::ifd::Value;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::Tag;

const DNG_VERSION: Tag = Tag::Unknown(50706);
const ICC: Tag = Tag::Unknown(34675);

const FLOATING_POINT: &str = "it holds floating-point values, which no camera writes and which are linear already; \
                              give the camera's own 8- or 16-bit pictures";

/// Decodes the first picture of a TIFF file.
pub(super) fn decode(bytes: Vec<u8>, allowed: &Allowed) -> Result<Stored, Reason> {
    let damaged = |e: tiff::TiffError| format!("{e}; copy the file again, or save it as a plain 8- or 16-bit RGB TIFF");
    let mut decoder = Decoder::new(Cursor::new(&bytes)).map_err(damaged)?;
    refuse_raw(&mut decoder)?;
    let (width, height) = decoder.dimensions().map_err(damaged)?;
    let (width, height) = (width as usize, height as usize);
    allowed.check_size(width, height)?;
    let kind = decoder.colortype().map_err(damaged)?;
    let pixels = width as u64 * height as u64;
    let bits = u64::from(kind.bit_depth()) * u64::from(kind.num_samples());
    let compression = decoder.find_tag_unsigned::<u32>(Tag::Compression).ok().flatten().unwrap_or(1);
    limits::check_length(bytes.len(), pixels * bits / 8, limits::tiff_packing(compression))?;
    // As stored, and as RGB.
    let needed = pixels * (bits.div_ceil(8) + 3 * u64::from(kind.bit_depth()).div_ceil(8)) + bytes.len() as u64;
    allowed.check_memory((width, height), needed)?;
    // The size is checked; what it needs may be had: at most five channels of 16 bit.
    let mut limits = Limits::default();
    limits.decoding_buffer_size = limits.decoding_buffer_size.max(10 * width * height);
    limits.intermediate_buffer_size = limits.intermediate_buffer_size.max(10 * width * height);
    limits.ifd_value_size = limits.ifd_value_size.max(64 << 20);
    let mut decoder = decoder.with_limits(limits);
    let icc = decoder.find_tag(ICC).ok().flatten().and_then(|v| v.into_u8_vec().ok());

    let mut buffer = DecodingResult::U8(Vec::new());
    let layout = decoder.read_image_to_buffer(&mut buffer).map_err(damaged)?;
    let samples = match buffer {
        DecodingResult::U8(v) if kind.bit_depth() < 8 => {
            Samples::Eight(rgb(unpack(&v, width, kind.bit_depth()), kind, layout.planes)?)
        }
        DecodingResult::U8(v) => Samples::Eight(rgb(v, kind, layout.planes)?),
        DecodingResult::U16(v) if kind.bit_depth() == 16 => Samples::Sixteen(rgb(v, kind, layout.planes)?),
        DecodingResult::F16(_) | DecodingResult::F32(_) | DecodingResult::F64(_) => {
            return Err(FLOATING_POINT.into());
        }
        _ => {
            return Err(format!(
                "its samples are of {} bit, which is not supported; save it with 8 or 16 bit",
                kind.bit_depth()
            ));
        }
    };
    if samples.len() != 3 * width * height {
        return Err("its picture data is not of its size; copy the file again".into());
    }
    Ok(Stored {
        width,
        height,
        samples,
        decoding: needed,
        // kamadak-exif reads no BigTIFF.
        exif: Some(bytes).filter(|b| !b[2..4].contains(&43)),
        icc,
        has_alpha: matches!(kind, ColorType::GrayA(_) | ColorType::RGBA(_) | ColorType::CMYKA(_)),
        notes: Vec::new(),
    })
}

/// Camera raws are TIFF files whose first picture is a thumbnail or a sensor's mosaic: they must not pass for photographs.
fn refuse_raw<R: std::io::Read + std::io::Seek>(decoder: &mut Decoder<R>) -> Result<(), Reason> {
    let mut number = |tag| decoder.find_tag_unsigned::<u32>(tag).ok().flatten();
    let thumbnail = number(Tag::NewSubfileType).is_some_and(|kind| kind & 1 != 0);
    let mosaic = number(Tag::PhotometricInterpretation).is_some_and(|p| p == 32803 || p == 34892);
    if thumbnail || mosaic || decoder.find_tag(DNG_VERSION).ok().flatten().is_some() {
        return Err("it looks like a camera raw file (DNG, NEF, ARW, ...); develop it first, all frames alike".into());
    }
    Ok(())
}

/// Samples of fewer than 8 bit, rows filled up to whole bytes, as bytes of the full range.
fn unpack(packed: &[u8], width: usize, depth: u8) -> Vec<u8> {
    let depth = usize::from(depth.max(1));
    let max = (1u16 << depth) - 1;
    let row = (width * depth).div_ceil(8).max(1);
    packed
        .chunks_exact(row)
        .flat_map(|bytes| {
            (0..width).map(move |x| {
                let bit = x * depth;
                // Two bytes hold every sample, also one that straddles a boundary.
                let next = bytes.get(bit / 8 + 1).copied().unwrap_or(0);
                let word = u16::from_be_bytes([bytes[bit / 8], next]);
                let value = (word >> (16 - depth - bit % 8)) & max;
                (value * 255 / max) as u8
            })
        })
        .collect()
}

/// Interleaved RGB of a TIFF's samples, in one plane or one for each channel.
fn rgb<T: Copy + Into<u32> + TryFrom<u32> + Bounded>(
    values: Vec<T>,
    kind: ColorType,
    planes: usize,
) -> Result<Vec<T>, Reason> {
    let values = if planes > 1 { interleave(&values, planes) } else { values };
    Ok(match kind {
        ColorType::Gray(_) => to_rgb(values, 1),
        ColorType::GrayA(8 | 16) => to_rgb(values, 2),
        ColorType::RGB(8 | 16) => to_rgb(values, 3),
        ColorType::RGBA(8 | 16) => to_rgb(values, 4),
        ColorType::CMYK(8 | 16) => cmyk_to_rgb(&values, 4, T::MAX),
        ColorType::CMYKA(8 | 16) => cmyk_to_rgb(&values, 5, T::MAX),
        other => {
            return Err(format!("its samples are of a kind that is not supported ({other:?}); save it as RGB"));
        }
    })
}

fn interleave<T: Copy>(values: &[T], planes: usize) -> Vec<T> {
    let size = values.len() / planes;
    (0..size).flat_map(|i| (0..planes).map(move |p| values[p * size + i])).collect()
}

/// The largest code value of a sample type.
trait Bounded {
    const MAX: u32;
}

impl Bounded for u8 {
    const MAX: u32 = 255;
}

impl Bounded for u16 {
    const MAX: u32 = 65535;
}

/// The size and the EXIF of the first picture, by seeking to its directories. What `decode` refuses for its kind is told beside them.
pub(super) fn head<R: Read + Seek>(reader: R, wanted: &[exif::Tag]) -> Result<Found, Reason> {
    let damaged = |e: tiff::TiffError| format!("{e}; copy the file again, or save it as a plain 8- or 16-bit RGB TIFF");
    let mut decoder = Decoder::new(reader).map_err(damaged)?;
    let mut refused = refuse_raw(&mut decoder).err();
    let (width, height) = decoder.dimensions().map_err(damaged)?;
    let depths = decoder.find_tag_unsigned_vec::<u16>(Tag::BitsPerSample).ok().flatten().unwrap_or_default();
    let kinds = decoder.find_tag_unsigned_vec::<u16>(Tag::SampleFormat).ok().flatten().unwrap_or_default();
    // 3 is "floating point" (TIFF 6.0, section 19).
    if kinds.first() == Some(&3) {
        refused.get_or_insert_with(|| FLOATING_POINT.into());
    }
    let depth = depths.first().map_or(8, |&bits| bits.clamp(8, 64) as u8);
    // Of a BigTIFF as well, which has no EXIF here.
    let software = decoder.get_tag_ascii_string(Tag::Software).ok();
    let exif = if is_big(&mut decoder) { None } else { fields(&mut decoder, wanted) };
    Ok(Found { width: width as usize, height: height as usize, depth, exif, software, refused })
}

/// Whether it is a BigTIFF, of which kamadak-exif, and so `decode`, reads no EXIF.
fn is_big<R: Read + Seek>(decoder: &mut Decoder<R>) -> bool {
    let mut head = [0; 4];
    let reader = decoder.inner();
    reader.rewind().and_then(|()| reader.read_exact(&mut head)).is_ok() && head[2..].contains(&43)
}

/// The `wanted` fields of the picture and of its EXIF directory, as a TIFF block of their own.
fn fields<R: Read + Seek>(decoder: &mut Decoder<R>, wanted: &[exif::Tag]) -> Option<Vec<u8>> {
    let pointer = decoder.find_tag(Tag::ExifDirectory).ok().flatten().and_then(|v| v.into_ifd_pointer().ok());
    let directory = pointer.and_then(|at| decoder.read_directory(at).ok());
    let mut fields = Vec::new();
    for &tag in wanted {
        let number = Tag::from_u16_exhaustive(tag.number());
        let value = match (tag.context(), &directory) {
            (Context::Tiff, _) => decoder.find_tag(number),
            (_, Some(directory)) => decoder.read_directory_tags(directory).find_tag(number),
            _ => continue,
        };
        if let Some(value) = value.ok().flatten().and_then(exif_value) {
            fields.push(Field { tag, ifd_num: In::PRIMARY, value });
        }
    }
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut block = Cursor::new(Vec::new());
    writer.write(&mut block, false).ok()?;
    Some(block.into_inner())
}

/// The first value of a tag in the words of the other crate; none of a kind that no wanted tag has.
fn exif_value(value: Value) -> Option<exif::Value> {
    Some(match value {
        Value::List(values) => exif_value(values.into_iter().next()?)?,
        Value::Ascii(text) => exif::Value::Ascii(vec![text.trim_end_matches('\0').as_bytes().to_vec()]),
        Value::Byte(v) => exif::Value::Byte(vec![v]),
        Value::Short(v) => exif::Value::Short(vec![v]),
        Value::SignedShort(v) => exif::Value::SShort(vec![v]),
        Value::Unsigned(v) => exif::Value::Long(vec![v]),
        Value::Signed(v) => exif::Value::SLong(vec![v]),
        Value::Float(v) => exif::Value::Float(vec![v]),
        Value::Double(v) => exif::Value::Double(vec![v]),
        Value::Rational(num, denom) => exif::Value::Rational(vec![exif::Rational { num, denom }]),
        Value::SRational(num, denom) => exif::Value::SRational(vec![exif::SRational { num, denom }]),
        _ => return None,
    })
}
