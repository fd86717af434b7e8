//! TIFF: grey, RGB and CMYK, at 8 or 16 bit, in strips, tiles or planes.
//!
//! In: the file. Out: RGB at the file's depth, of its first picture that is no thumbnail; grey of fewer than 8 bit becomes 8.
//! Cost: that of the `tiff` crate, and two copies. Source: TIFF 6.0.

use super::{Found, Reason, Stored, cmyk_to_rgb, to_rgb};
use crate::bracket::Samples;
use crate::limits::{self, Limits as Allowed};
use crate::tiff_file::{self, Picture};
use exif::experimental::Writer;
use exif::{Context, Field, In};
use std::io::{Cursor, Read, Seek};
use tiff::ColorType;
use tiff::Directory;
use tiff::decoder::ifd::Value;
use tiff::decoder::{Decoder, DecodingResult, Limits};
use tiff::tags::{IfdPointer, Tag};

/// Bytes up to the first directory's offset, and of it.
const HEADER: usize = 8;

const ICC: Tag = Tag::Unknown(34675);

const FLOATING_POINT: &str = "it holds floating-point values, which no camera writes and which are linear already; \
                              give the camera's own 8- or 16-bit pictures";

/// Decodes the first picture of a TIFF file that is no thumbnail.
pub(super) fn decode(mut bytes: Vec<u8>, allowed: &Allowed) -> Result<Stored, Reason> {
    let picture = tiff_file::picture(Cursor::new(&bytes))?;
    refuse_raw(picture)?;
    let header = bytes[..HEADER].to_vec();
    tiff_file::put_first(&mut bytes, picture);
    tiff_file::order_bits(&mut bytes);
    let mut decoder = Decoder::new(Cursor::new(&bytes)).map_err(damaged)?;
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

    let samples = match tiff_file::samples(&mut decoder, damaged)? {
        DecodingResult::U8(v) => Samples::Eight(rgb(v, kind)?),
        DecodingResult::U16(v) => Samples::Sixteen(rgb(v, kind)?),
        _ => return Err(FLOATING_POINT.into()),
    };
    if samples.len() != 3 * width * height {
        return Err("its picture data is not of its size; copy the file again".into());
    }
    bytes[..HEADER].copy_from_slice(&header);
    Ok(Stored {
        width,
        height,
        samples,
        decoding: needed,
        // kamadak-exif reads no BigTIFF.
        exif: Some(bytes).filter(|b| !b[2..4].contains(&43)),
        directory: picture.index as u16,
        icc,
        has_alpha: matches!(kind, ColorType::GrayA(_) | ColorType::RGBA(_) | ColorType::CMYKA(_)),
        notes: Vec::new(),
    })
}

fn damaged(e: tiff::TiffError) -> Reason {
    format!("{e}; copy the file again, or save it as a plain 8- or 16-bit RGB TIFF")
}

/// Camera raws are TIFF files that hold a thumbnail or a sensor's mosaic: they must not pass for photographs.
fn refuse_raw(picture: Picture) -> Result<(), Reason> {
    if picture.is_raw {
        return Err("it looks like a camera raw file (DNG, NEF, ARW, ...); develop it first, all frames alike".into());
    }
    Ok(())
}

/// Interleaved RGB of a TIFF's samples.
fn rgb<T: Copy + Into<u32> + TryFrom<u32> + Bounded>(values: Vec<T>, kind: ColorType) -> Result<Vec<T>, Reason> {
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

/// The size and the EXIF of the first picture that is no thumbnail, by seeking to its directories. What `decode` refuses for its kind is
/// told beside them.
pub(super) fn head<R: Read + Seek>(mut reader: R, wanted: &[exif::Tag]) -> Result<Found, Reason> {
    let picture = tiff_file::picture(&mut reader)?;
    let mut refused = refuse_raw(picture).err();
    reader.rewind().map_err(|e| e.to_string())?;
    let mut decoder = Decoder::new(reader).map_err(damaged)?;
    let first = decoder.ifd_pointer().filter(|_| picture.index > 0);
    decoder.seek_to_image(picture.index).map_err(damaged)?;
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
    let exif = if is_big(&mut decoder) { None } else { fields(&mut decoder, first, wanted) };
    Ok(Found { width: width as usize, height: height as usize, depth, exif, software, refused })
}

/// Whether it is a BigTIFF, of which kamadak-exif, and so `decode`, reads no EXIF.
fn is_big<R: Read + Seek>(decoder: &mut Decoder<R>) -> bool {
    let mut head = [0; 4];
    let reader = decoder.inner();
    reader.rewind().and_then(|()| reader.read_exact(&mut head)).is_ok() && head[2..].contains(&43)
}

/// The `wanted` fields of the picture, else of the `first` one: each of the directory where EXIF has it, else of the picture's own. As a TIFF
/// block of their own.
fn fields<R: Read + Seek>(
    decoder: &mut Decoder<R>,
    first: Option<IfdPointer>,
    wanted: &[exif::Tag],
) -> Option<Vec<u8>> {
    let mut sources: Vec<(Directory, Option<Directory>)> = Vec::new();
    for pointer in decoder.ifd_pointer().into_iter().chain(first) {
        let Ok(own) = decoder.read_directory(pointer) else { continue };
        let below = decoder.read_directory_tags(&own).find_tag(Tag::ExifDirectory).ok().flatten();
        let below = below.and_then(|value| value.into_ifd_pointer().ok());
        sources.push((own, below.and_then(|at| decoder.read_directory(at).ok())));
    }
    let mut fields = Vec::new();
    for &tag in wanted {
        let count = if tag == exif::Tag::Orientation { 1 } else { sources.len() };
        let places = sources.iter().take(count).flat_map(|(own, below)| {
            let below = below.as_ref().filter(|_| tag.context() == Context::Exif);
            below.into_iter().chain([own])
        });
        let number = Tag::from_u16_exhaustive(tag.number());
        let mut found = places.filter_map(|directory| {
            decoder.read_directory_tags(directory).find_tag(number).ok().flatten().and_then(exif_value)
        });
        if let Some(value) = found.next() {
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
