//! EXIF of a picture: the capture data of the reference frame, and the properties of the file.
//!
//! In: the [`Metadata`], with the EXIF fields of the reference frame where it has any. Out: an EXIF block, which has
//! the structure of a TIFF, or its fields. Cost: negligible. Source: EXIF 2.32, sections 4.6.4 and 4.6.5, and table
//! 17 for the fields that a JPEG must have.

use super::metadata::{Metadata, one_line};
use ::exif::experimental::Writer;
use ::exif::{Field, In, Rational, Reader, Tag, Value};
use std::collections::BTreeMap;
use std::io::Cursor;

/// Largest size of an EXIF block in bytes. A JPEG segment has at most 65,533 bytes, including the name of its
/// content.
const MOST_BYTES: usize = 65_500;

/// Whether the metadata have capture data of the photograph.
pub(crate) fn tells(metadata: &Metadata) -> bool {
    !of_the_photograph(metadata).is_empty()
}

/// Returns the EXIF block of a picture of `size` pixels.
pub(crate) fn block(size: (usize, usize), metadata: &Metadata) -> Option<Vec<u8>> {
    let whole = written(&fields(of_the_photograph(metadata), size, metadata));
    // A block that does not fit into a JPEG segment is not from a camera. In this case no EXIF fields of the frame
    // are copied, and only fields made from `metadata` are written.
    whole.filter(|block| block.len() <= MOST_BYTES).or_else(|| written(&fields(of(metadata), size, metadata)))
}

/// Returns the fields of a TIFF picture of `size` pixels: all except those that EXIF defines for JPEG only.
pub(crate) fn of_tiff(size: (usize, usize), metadata: &Metadata) -> Vec<Field> {
    let of_jpeg = [Tag::YCbCrPositioning, Tag::ComponentsConfiguration, Tag::PixelXDimension, Tag::PixelYDimension];
    let all = fields(of_the_photograph(metadata), size, metadata).into_iter();
    all.filter(|field| !of_jpeg.contains(&field.tag)).collect()
}

/// Returns the EXIF fields of the reference frame or, if it has none, fields made from `metadata`.
fn of_the_photograph(metadata: &Metadata) -> Vec<Field> {
    let carried = metadata.capture.exif.clone().and_then(|raw| Reader::new().read_raw(raw).ok());
    carried.map_or_else(|| of(metadata), |exif| exif.fields().cloned().collect())
}

/// Adds the properties of the file to the fields `of_the_photograph`.
fn fields(of_the_photograph: Vec<Field>, size: (usize, usize), metadata: &Metadata) -> Vec<Field> {
    let mut fields: BTreeMap<Key, Field> = of_the_photograph.into_iter().map(|field| (key(field.tag), field)).collect();
    let at = |n: usize| Value::Long(vec![u32::try_from(n).unwrap_or(u32::MAX)]);
    for (tag, value) in [
        (Tag::Orientation, Value::Short(vec![1])),
        (Tag::Software, text(&one_line(&metadata.software))),
        (Tag::YCbCrPositioning, Value::Short(vec![1])),
        (Tag::ColorSpace, Value::Short(vec![if metadata.profile.is_none() { 1 } else { 0xFFFF }])),
        (Tag::ComponentsConfiguration, Value::Undefined(vec![1, 2, 3, 0], 0)),
        (Tag::PixelXDimension, at(size.0)),
        (Tag::PixelYDimension, at(size.1)),
    ] {
        fields.insert(key(tag), Field { tag, ifd_num: In::PRIMARY, value });
    }
    let inch = || Value::Rational(vec![Rational { num: 72, denom: 1 }]);
    for (tag, value) in [
        (Tag::ExifVersion, Value::Undefined(b"0232".to_vec(), 0)),
        (Tag::FlashpixVersion, Value::Undefined(b"0100".to_vec(), 0)),
        (Tag::XResolution, inch()),
        (Tag::YResolution, inch()),
        (Tag::ResolutionUnit, Value::Short(vec![2])),
    ] {
        fields.entry(key(tag)).or_insert(Field { tag, ifd_num: In::PRIMARY, value });
    }
    fields.into_values().collect()
}

fn written(fields: &[Field]) -> Option<Vec<u8>> {
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut block = Cursor::new(Vec::new());
    writer.write(&mut block, false).ok()?;
    Some(block.into_inner())
}

/// The key of a tag: its directory and its number.
type Key = (u8, u16);

fn key(tag: Tag) -> Key {
    (tag.context() as u8, tag.number())
}

fn text(text: &str) -> Value {
    Value::Ascii(vec![text.as_bytes().to_vec()])
}

/// Returns the capture data of the metadata as EXIF fields.
fn of(metadata: &Metadata) -> Vec<Field> {
    let capture = &metadata.capture;
    let mut fields = Vec::new();
    let mut put = |tag, value| fields.push(Field { tag, ifd_num: In::PRIMARY, value });
    let texts = [
        (Tag::Make, &capture.make),
        (Tag::Model, &capture.model),
        (Tag::DateTime, &capture.date),
        (Tag::DateTimeOriginal, &capture.date),
        (Tag::LensModel, &capture.lens),
    ];
    for (tag, value) in texts {
        if let Some(value) = value.as_deref().map(one_line).filter(|value| !value.is_empty()) {
            put(tag, text(&value));
        }
    }
    let numbers = [
        (Tag::ExposureTime, metadata.time_s),
        (Tag::FNumber, metadata.f_number),
        (Tag::FocalLength, capture.focal_length_mm),
    ];
    for (tag, value) in numbers {
        if let Some(value) = value.filter(|v| v.is_finite() && *v > 0.0) {
            let (num, denom) = fraction(value);
            put(tag, Value::Rational(vec![Rational { num, denom }]));
        }
    }
    if let Some(iso) = metadata.iso.map(f64::round).filter(|iso| *iso >= 1.0) {
        // EXIF requires the value 65535 for sensitivities that do not fit into 16 bits.
        put(Tag::PhotographicSensitivity, Value::Short(vec![iso.min(65535.0) as u16]));
    }
    fields
}

/// Returns numerator and denominator of a fraction close to `v`, which is 0 or above. The fraction is 1/n if that is
/// exact, otherwise a decimal fraction with as many digits as `v` needs or as 32 bits allow.
pub(crate) fn fraction(v: f64) -> (u32, u32) {
    let most = f64::from(u32::MAX);
    let whole = |x: f64| (x - x.round()).abs() <= 1e-6 * x && x.round() >= 1.0 && x < most;
    let inverse = 1.0 / v;
    if v < 1.0 && whole(inverse) {
        return (1, inverse.round() as u32);
    }
    let decimal = [1u32, 10, 100, 1000, 10_000, 100_000].into_iter();
    let exact = decimal.clone().find(|&d| (v * f64::from(d) - (v * f64::from(d)).round()).abs() <= 1e-9 * v);
    let finest = decimal.chain([1_000_000_000]).rfind(|&d| v * f64::from(d) < most).unwrap_or(1);
    let denominator = exact.filter(|&d| v * f64::from(d) < most).unwrap_or(finest);
    // The cast limits values above `u32::MAX` to `u32::MAX`.
    ((v * f64::from(denominator)).round() as u32, denominator)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::Capture;

    fn read(metadata: &Metadata) -> ::exif::Exif {
        Reader::new().read_raw(block((300, 200), metadata).unwrap()).unwrap()
    }

    fn shown(exif: &::exif::Exif, tag: Tag) -> Option<String> {
        exif.get_field(tag, In::PRIMARY).map(|f| f.display_value().to_string())
    }

    #[test]
    fn without_exif_the_report_has_the_data_of_headers() {
        let capture = Capture { make: Some("Maker".into()), focal_length_mm: Some(50.0), ..Capture::default() };
        let metadata = Metadata { capture, time_s: Some(0.02), iso: Some(409_600.0), ..Metadata::default() };
        let exif = read(&metadata);
        assert_eq!(shown(&exif, Tag::ExposureTime).as_deref(), Some("1/50"));
        assert_eq!(shown(&exif, Tag::PhotographicSensitivity).as_deref(), Some("65535"));
        assert_eq!(shown(&exif, Tag::PixelXDimension).as_deref(), Some("300"));
        assert_eq!(shown(&exif, Tag::Make).as_deref(), Some("\"Maker\""));
        assert_eq!(shown(&exif, Tag::Model), None);
    }

    #[test]
    fn copied_exif_is_kept_and_properties_of_the_file_are_corrected() {
        let first = Metadata { time_s: Some(0.5), iso: Some(100.0), ..Metadata::default() };
        // The block contains another size and another program, like the block of an edited photograph.
        let other = Metadata { software: "other".into(), ..first };
        let exif = block((9, 9), &other);
        let metadata = Metadata { capture: Capture { exif, ..Capture::default() }, ..Metadata::default() };
        let exif = read(&metadata);
        assert_eq!(shown(&exif, Tag::ExposureTime).as_deref(), Some("1/2"));
        assert_eq!(shown(&exif, Tag::PixelYDimension).as_deref(), Some("200"));
        assert_eq!(shown(&exif, Tag::Software), Some(format!("{:?}", metadata.software)));
        assert_eq!(exif.fields().filter(|f| f.tag == Tag::Software).count(), 1);
    }

    #[test]
    fn fractions_are_the_simplest() {
        assert_eq!([1.0 / 60.0, 0.125, 2.8, 30.0].map(fraction), [(1, 60), (1, 8), (28, 10), (30, 1)]);
        assert_eq!([0.3127, 0.0].map(fraction), [(3127, 10_000), (0, 1)]);
        for v in [0.318_753_1, 1_234.567_891, 3e9, 0.000_123_4] {
            let (n, d) = fraction(v);
            assert!((f64::from(n) / f64::from(d) - v).abs() <= 1e-6 * v, "{v}: {n}/{d}");
        }
        assert_eq!(fraction(1e12), (u32::MAX, 1));
    }
}
