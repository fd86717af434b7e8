//! Every format, depth and kind of damage, on pictures made here.

use super::*;
use image::{ExtendedColorType, ImageEncoder, codecs, metadata::Orientation};
use std::io::Cursor;

pub(super) const LIMIT: u64 = 1 << 28;

pub(super) fn at_most(max_pixels: u64) -> Limits {
    Limits { max_pixels, memory: None }
}

/// Decodes `bytes`. Where this succeeds, checks that the header gives the same size and depth, and does not reject the
/// file.
pub(in crate::bracket) fn read(bytes: &[u8]) -> Result<Decoded> {
    let decoded = decode(Path::new("picture"), bytes.to_vec(), &at_most(LIMIT));
    let head = head(Path::new("picture"), Cursor::new(bytes), &[Tag::Orientation], &at_most(LIMIT));
    if let Ok(decoded) = &decoded {
        let head = head.unwrap();
        assert_eq!((head.width, head.height), (decoded.width, decoded.height));
        assert_eq!(u32::from(head.depth), u32::from(decoded.samples.max()).count_ones());
        assert!(head.refused.is_none(), "{:?}", head.refused);
    }
    decoded
}

#[test]
fn header_of_a_file_that_is_not_a_photograph_is_an_error() {
    let refused = |bytes: &[u8]| {
        head(Path::new("picture"), Cursor::new(bytes), &[], &at_most(100))
            .map(|head| head.refused)
            .unwrap_or_else(Some)
            .map(|e| e.to_string())
            .unwrap_or_default()
    };
    let float = tiff_of::<::tiff::encoder::colortype::RGB32Float>(&[0.5, 1.0, 2.0], 1, 1);
    assert!(refused(&float).contains("floating-point"));
    assert!(refused(&jpeg(&scene(40, 30), 40)).contains("40x30"));
    assert!(refused(&jpeg(&scene(8, 8), 8)[..100]).contains("truncated"));
    assert!(refused(b"Dear diary").contains("text"));
    assert!(refused(b"\x89PNG\r\n\x1a\n\0\0\0\x00IEND\0\0\0\0").contains("does not begin"));
    assert_eq!(refused(&jpeg(&scene(8, 8), 8)), "");
}

/// Returns a picture with detail everywhere, so that its JPEG has data everywhere.
pub(in crate::bracket) fn scene(width: usize, height: usize) -> Vec<u8> {
    let noise = |x: usize, y: usize, c: usize| (x * 37 + y * 91 + c * 53) * (x + 3 * y + 7) % 61;
    (0..height)
        .flat_map(|y| (0..width).flat_map(move |x| (0..3).map(move |c| (60 + x + y + noise(x, y, c)) as u8)))
        .collect()
}

pub(in crate::bracket) fn jpeg(rgb: &[u8], width: usize) -> Vec<u8> {
    let mut out = Vec::new();
    let height = rgb.len() / 3 / width;
    codecs::jpeg::JpegEncoder::new_with_quality(&mut out, 92)
        .write_image(rgb, width as u32, height as u32, ExtendedColorType::Rgb8)
        .unwrap();
    out
}

/// Returns the EXIF block of `fields`, from the TIFF header on.
pub(in crate::bracket) fn exif_bytes(fields: &[(Tag, exif::Value)]) -> Vec<u8> {
    let fields: Vec<exif::Field> = fields
        .iter()
        .map(|(tag, value)| exif::Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() })
        .collect();
    let mut writer = exif::experimental::Writer::new();
    fields.iter().for_each(|f| writer.push_field(f));
    let mut bytes = Cursor::new(Vec::new());
    writer.write(&mut bytes, false).unwrap();
    bytes.into_inner()
}

/// Returns `jpeg` with a segment inserted after its start marker.
pub(in crate::bracket) fn with_segment(jpeg: &[u8], marker: u8, content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u16 + 2).to_be_bytes();
    [&jpeg[..2], &[0xFF, marker], &length, content, &jpeg[2..]].concat()
}

pub(in crate::bracket) fn with_exif(jpeg: &[u8], fields: &[(Tag, exif::Value)]) -> Vec<u8> {
    with_segment(jpeg, 0xE1, &[&b"Exif\0\0"[..], &exif_bytes(fields)].concat())
}

fn png_of(values: &[u8], width: u32, height: u32, kind: ::png::ColorType, depth: ::png::BitDepth) -> Vec<u8> {
    let mut out = Vec::new();
    let mut encoder = ::png::Encoder::new(&mut out, width, height);
    encoder.set_color(kind);
    encoder.set_depth(depth);
    if kind == ::png::ColorType::Indexed {
        encoder.set_palette(vec![1, 2, 3, 40, 50, 60]);
    }
    encoder.write_header().unwrap().write_image_data(values).unwrap();
    out
}

pub(super) fn eight(decoded: Result<Decoded>) -> Vec<u8> {
    match decoded.unwrap().samples {
        Samples::Eight(v) => v,
        Samples::Sixteen(_) => panic!("8 bit was expected"),
    }
}

fn sixteen(decoded: Result<Decoded>) -> Vec<u16> {
    match decoded.unwrap().samples {
        Samples::Eight(_) => panic!("16 bit was expected"),
        Samples::Sixteen(v) => v,
    }
}

pub(super) fn is_damage(decoded: Result<Decoded>) -> bool {
    matches!(decoded, Err(Error::Decode { .. }))
}

#[test]
fn png_of_every_kind() {
    use ::png::{BitDepth::*, ColorType::*};
    assert_eq!(eight(read(&png_of(&[1, 2, 3, 4, 5, 6], 2, 1, Rgb, Eight))), [1, 2, 3, 4, 5, 6]);
    assert_eq!(eight(read(&png_of(&[1, 2, 3, 0, 4, 5, 6, 9], 2, 1, Rgba, Eight))), [1, 2, 3, 4, 5, 6]);
    assert_eq!(eight(read(&png_of(&[7, 9], 2, 1, Grayscale, Eight))), [7, 7, 7, 9, 9, 9]);
    assert_eq!(eight(read(&png_of(&[7, 0, 9, 255], 2, 1, GrayscaleAlpha, Eight))), [7, 7, 7, 9, 9, 9]);
    assert_eq!(eight(read(&png_of(&[0b0100_0000], 2, 1, Indexed, One))), [1, 2, 3, 40, 50, 60]);
    assert_eq!(eight(read(&png_of(&[0b0100_0000], 2, 1, Grayscale, One))), [0, 0, 0, 255, 255, 255]);
    assert_eq!(eight(read(&png_of(&[0b0110_0000], 2, 1, Grayscale, Two))), [85, 85, 85, 170, 170, 170]);
    assert_eq!(eight(read(&png_of(&[0x2F], 2, 1, Grayscale, Four))), [34, 34, 34, 255, 255, 255]);
    assert_eq!(sixteen(read(&png_of(&[1, 2, 3, 4, 5, 6], 1, 1, Rgb, Sixteen))), [258, 772, 1286]);
    assert_eq!(sixteen(read(&png_of(&[1, 2, 3, 4], 1, 1, GrayscaleAlpha, Sixteen))), [258, 258, 258]);
}

#[test]
fn damaged_png_is_an_error() {
    let whole = png_of(&scene(40, 30), 40, 30, ::png::ColorType::Rgb, ::png::BitDepth::Eight);
    assert!(read(&whole).is_ok());
    for cut in [30, whole.len() / 3, whole.len() * 95 / 100, whole.len() - 5] {
        assert!(is_damage(read(&whole[..cut])), "cut at {cut} of {}", whole.len());
    }
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 0x10;
    assert!(is_damage(read(&flipped)));
    // The checksum of the compressed data is wrong, in an IDAT chunk whose own checksum is right.
    let place = whole.windows(4).position(|kind| kind == b"IDAT").unwrap();
    let length = u32::from_be_bytes(whole[place - 4..place].try_into().unwrap()) as usize;
    let mut other = whole.clone();
    other[place + 4 + length - 1] ^= 1;
    let mut crc = flate2::Crc::new();
    crc.update(&other[place..place + 4 + length]);
    other[place + 4 + length..][..4].copy_from_slice(&crc.sum().to_be_bytes());
    assert!(is_damage(read(&other)));
}

fn tiff_of<C: ::tiff::encoder::colortype::ColorType>(values: &[C::Inner], width: u32, height: u32) -> Vec<u8>
where
    [C::Inner]: ::tiff::encoder::TiffValue,
{
    let mut out = Cursor::new(Vec::new());
    let mut encoder = ::tiff::encoder::TiffEncoder::new(&mut out).unwrap();
    encoder.write_image::<C>(width, height, values).unwrap();
    out.into_inner()
}

#[test]
fn tiff_of_every_kind() {
    use ::tiff::encoder::colortype::*;
    assert_eq!(eight(read(&tiff_of::<RGB8>(&[1, 2, 3, 4, 5, 6], 2, 1))), [1, 2, 3, 4, 5, 6]);
    assert_eq!(eight(read(&tiff_of::<RGBA8>(&[1, 2, 3, 0, 4, 5, 6, 9], 2, 1))), [1, 2, 3, 4, 5, 6]);
    assert_eq!(eight(read(&tiff_of::<Gray8>(&[7, 9], 2, 1))), [7, 7, 7, 9, 9, 9]);
    assert_eq!(eight(read(&tiff_of::<CMYK8>(&[255, 0, 0, 0, 0, 0, 0, 155], 2, 1))), [0, 255, 255, 100, 100, 100]);
    assert_eq!(sixteen(read(&tiff_of::<RGB16>(&[1, 2, 60000], 1, 1))), [1, 2, 60000]);
    assert_eq!(sixteen(read(&tiff_of::<Gray16>(&[300], 1, 1))), [300; 3]);
    assert_eq!(sixteen(read(&tiff_of::<CMYK16>(&[0, 65535, 0, 0], 1, 1))), [65535, 0, 65535]);
    let Err(Error::Decode { reason, .. }) = read(&tiff_of::<RGB32Float>(&[0.5, 1.0, 2.0], 1, 1)) else {
        panic!("float must be refused")
    };
    assert!(reason.contains("floating-point"), "{reason}");
}

#[test]
fn damaged_tiff_is_an_error() {
    let whole = tiff_of::<::tiff::encoder::colortype::RGB8>(&scene(40, 30), 40, 30);
    for cut in [6, 40, whole.len() / 2, whole.len() - 20] {
        assert!(is_damage(read(&whole[..cut])), "cut at {cut} of {}", whole.len());
    }
}

pub(super) const PROGRESSIVE: &[u8] = include_bytes!("../../../tests/fixtures/progressive.jpg");

#[test]
fn exif_turns_jpeg_png_and_tiff() {
    let rgb = scene(32, 16);
    let quarter = [(Tag::Orientation, exif::Value::Short(vec![6]))];
    let turned = |decoded: Result<Decoded>| decoded.map(|d| (d.width, d.height)).unwrap();
    assert_eq!(turned(read(&with_exif(&jpeg(&rgb, 32), &quarter))), (16, 32));

    let mut png = Vec::new();
    let mut info = ::png::Info::with_size(32, 16);
    info.color_type = ::png::ColorType::Rgb;
    info.bit_depth = ::png::BitDepth::Eight;
    info.exif_metadata = Some(exif_bytes(&quarter).into());
    let encoder = ::png::Encoder::with_info(&mut png, info).unwrap();
    encoder.write_header().unwrap().write_image_data(&rgb).unwrap();
    assert_eq!(turned(read(&png)), (16, 32));

    let mut tiff = Cursor::new(Vec::new());
    let mut encoder = ::tiff::encoder::TiffEncoder::new(&mut tiff).unwrap();
    let mut picture = encoder.new_image::<::tiff::encoder::colortype::RGB8>(32, 16).unwrap();
    picture.encoder().write_tag(::tiff::tags::Tag::Orientation, 6u16).unwrap();
    picture.write_data(&rgb).unwrap();
    let decoded = read(&tiff.into_inner()).unwrap();
    // In the upright picture, the bottom left corner of the stored picture is at the top left.
    assert_eq!((decoded.width, decoded.height), (16, 32));
    assert_eq!(eight(Ok(decoded))[..3], rgb[3 * 32 * 15..][..3]);
    // The `image` crate interprets orientation 6 in the same way.
    assert_eq!(Orientation::from_exif(6), Some(Orientation::Rotate90));
}

/// Found by code review: the header took the last EXIF of a PNG, and the decoder the first.
#[test]
fn the_header_of_a_png_turns_as_the_picture_does() {
    let turned = |orientation| {
        let mut bytes = Vec::new();
        let mut info = ::png::Info::with_size(4, 2);
        info.color_type = ::png::ColorType::Grayscale;
        info.exif_metadata = Some(exif_bytes(&[(Tag::Orientation, exif::Value::Short(vec![orientation]))]).into());
        let mut writer = ::png::Encoder::with_info(&mut bytes, info).unwrap().write_header().unwrap();
        writer.write_image_data(&[7; 8]).unwrap();
        drop(writer);
        bytes
    };
    let (upright, quarter) = (turned(1), turned(6));
    let at = |bytes: &[u8]| bytes.windows(4).position(|w| w == b"eXIf").unwrap() - 4;
    let chunk = |bytes: &[u8]| {
        let begin = at(bytes);
        let length = u32::from_be_bytes(bytes[begin..begin + 4].try_into().unwrap()) as usize;
        bytes[begin..begin + 12 + length].to_vec()
    };
    for (first, second) in [(&upright, &quarter), (&quarter, &upright)] {
        let end = at(first) + chunk(first).len();
        let both = [&first[..end], &chunk(second), &first[end..]].concat();
        let head = head(Path::new("picture"), Cursor::new(&both), &[], &Limits::default()).unwrap();
        if let Ok(decoded) = read(&both) {
            assert_eq!((head.width, head.height), (decoded.width, decoded.height));
        }
        let is_quarter = std::ptr::eq(first, &quarter);
        assert_eq!((head.width, head.height), if is_quarter { (2, 4) } else { (4, 2) });
    }
}

#[test]
fn sizes_beyond_the_limit_are_refused_before_decoding() {
    for bytes in
        [jpeg(&scene(64, 48), 64), png_of(&scene(64, 48), 64, 48, ::png::ColorType::Rgb, ::png::BitDepth::Eight)]
    {
        assert!(decode(Path::new("a"), bytes.clone(), &at_most(64 * 48)).is_ok());
        assert!(is_damage(decode(Path::new("a"), bytes, &at_most(64 * 48 - 1))));
    }
}

#[test]
fn damaged_exif_is_noted_and_the_picture_kept() {
    let bytes = with_segment(&jpeg(&scene(16, 16), 16), 0xE1, b"Exif\0\0II nonsense");
    assert_eq!(read(&bytes).unwrap().notes.len(), 1);
}

#[test]
fn flipped_bytes_never_panic() {
    let files = [
        jpeg(&scene(40, 24), 40),
        PROGRESSIVE.to_vec(),
        tiff_of::<::tiff::encoder::colortype::RGB8>(&scene(20, 10), 20, 10),
    ];
    let mut state = 1u32;
    for file in files {
        for _ in 0..400 {
            let mut bytes = file.clone();
            for _ in 0..3 {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let at = state as usize / 7 % bytes.len();
                bytes[at] = (state >> 24) as u8;
            }
            if let Ok(decoded) = decode(Path::new("a"), bytes, &at_most(1 << 20)) {
                assert_eq!(decoded.samples.len(), 3 * decoded.width * decoded.height);
            }
        }
    }
}
