//! The EXIF fields of a photograph that are valid for results too.
//!
//! In: EXIF. Out: a TIFF block of the fields that describe the photograph: camera, lens, exposure, times, author. Cost:
//! negligible. Source: EXIF 2.32, sections 4.6.4 to 4.6.6, and annex E, which lists the tags that an editor must update
//! or remove.
//!
//! The following are left out:
//! - the fields of the stored pixels (sizes, orientation, encoding, colour space), which the writer of the result sets;
//! - the unique image id and the thumbnail;
//! - the maker note, whose offsets become invalid;
//! - positions in the image, because the result is moved and cropped;
//! - the GPS position, unless it is requested.

use exif::experimental::Writer;
use exif::{Context, Exif, Field, In, Tag, Value};
use std::collections::BTreeMap;
use std::io::Cursor;

/// Fields of the first directory that describe the photograph.
pub(crate) const DESCRIPTIVE: [Tag; 9] = [
    Tag::ImageDescription,
    Tag::Make,
    Tag::Model,
    Tag::XResolution,
    Tag::YResolution,
    Tag::ResolutionUnit,
    Tag::DateTime,
    Tag::Artist,
    Tag::Copyright,
];

/// Fields of the EXIF directory that describe the stored file and are left out.
const OF_THE_FILE: [Tag; 12] = [
    Tag::MakerNote,
    Tag::PixelXDimension,
    Tag::PixelYDimension,
    Tag::ColorSpace,
    Tag::Gamma,
    Tag::ComponentsConfiguration,
    Tag::CompressedBitsPerPixel,
    Tag::SubjectArea,
    Tag::SubjectLocation,
    Tag::RelatedSoundFile,
    Tag::CustomRendered,
    Tag::ImageUniqueID,
];

/// Tags of the EXIF directory with this number or a greater number are padding or private to a program.
const PRIVATE: u16 = 0xC000;

/// Longest field that is copied, in bytes.
const LONGEST: usize = 4096;

/// Returns the TIFF block of the fields that are valid for results, including the GPS position if `keep_gps`; `None`
/// where there are no such fields.
pub(crate) fn carried(exif: &Exif, keep_gps: bool) -> Option<Vec<u8>> {
    let mut fields: BTreeMap<(u8, u16), &Field> = BTreeMap::new();
    for field in exif.fields().filter(|field| field.ifd_num == In::PRIMARY && is_writable(&field.value)) {
        let tag = field.tag;
        let (directory, is_kept) = match tag.context() {
            Context::Tiff => (0, DESCRIPTIVE.contains(&tag)),
            Context::Exif => (1, !OF_THE_FILE.contains(&tag) && tag.number() < PRIVATE),
            Context::Gps => (2, keep_gps),
            _ => (3, false),
        };
        if is_kept {
            // Damaged files may have a tag twice; the first is used.
            fields.entry((directory, tag.number())).or_insert(field);
        }
    }
    if fields.is_empty() {
        return None;
    }
    let mut writer = Writer::new();
    fields.values().for_each(|field| writer.push_field(field));
    let mut block = Cursor::new(Vec::new());
    writer.write(&mut block, false).ok()?;
    Some(block.into_inner())
}

/// Whether the value has a known type and a length of 1 to [`LONGEST`] bytes.
fn is_writable(value: &Value) -> bool {
    let bytes = match value {
        Value::Byte(v) => v.len(),
        Value::Ascii(lines) => lines.iter().map(|line| line.len() + 1).sum(),
        Value::Short(v) => 2 * v.len(),
        Value::Long(v) => 4 * v.len(),
        Value::Rational(v) => 8 * v.len(),
        Value::SByte(v) => v.len(),
        Value::Undefined(v, _) => v.len(),
        Value::SShort(v) => 2 * v.len(),
        Value::SLong(v) => 4 * v.len(),
        Value::SRational(v) => 8 * v.len(),
        Value::Float(v) => 4 * v.len(),
        Value::Double(v) => 8 * v.len(),
        Value::Unknown(..) => 0,
    };
    (1..=LONGEST).contains(&bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn field(tag: Tag, value: Value) -> Field {
        Field { tag, ifd_num: In::PRIMARY, value }
    }

    fn read(block: Vec<u8>) -> Exif {
        exif::Reader::new().read_raw(block).unwrap()
    }

    fn block(fields: &[Field]) -> Exif {
        let mut writer = Writer::new();
        fields.iter().for_each(|field| writer.push_field(field));
        let mut bytes = Cursor::new(Vec::new());
        writer.write(&mut bytes, true).unwrap();
        read(bytes.into_inner())
    }

    #[test]
    fn valid_exif_is_copied_and_gps_only_on_request() {
        let original = block(&[
            field(Tag::Make, Value::Ascii(vec![b"Maker".to_vec()])),
            field(Tag::Orientation, Value::Short(vec![6])),
            field(Tag::Software, Value::Ascii(vec![b"Firmware 1".to_vec()])),
            field(Tag::FNumber, Value::Rational(vec![exif::Rational { num: 28, denom: 10 }])),
            field(Tag::LensModel, Value::Ascii(vec![b"50 mm".to_vec()])),
            field(Tag::ImageUniqueID, Value::Ascii(vec![b"0123456789abcdef0123456789abcdef".to_vec()])),
            field(Tag::MakerNote, Value::Undefined(vec![1; 99], 0)),
            field(Tag::PixelXDimension, Value::Long(vec![4000])),
            field(Tag::UserComment, Value::Undefined(vec![65; LONGEST + 1], 0)),
            field(Tag::GPSLatitudeRef, Value::Ascii(vec![b"N".to_vec()])),
            Field { tag: Tag::Model, ifd_num: In::THUMBNAIL, value: Value::Ascii(vec![b"Thumb".to_vec()]) },
        ]);
        let tags = |keep| {
            let carried = read(carried(&original, keep).unwrap());
            carried.fields().map(|f| f.tag).collect::<Vec<_>>()
        };
        let mut expected = vec![Tag::Make, Tag::FNumber, Tag::LensModel];
        assert_eq!(tags(false), expected);
        expected.push(Tag::GPSLatitudeRef);
        assert_eq!(tags(true), expected);
        assert_eq!(carried(&block(&[field(Tag::Orientation, Value::Short(vec![6]))]), true), None);
    }
}
