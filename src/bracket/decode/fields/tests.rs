//! Exposures in the places where programs write them, in each format.

use crate::bracket::decode::tests::{LIMIT, at_most, eight, exif_bytes, read};
use crate::bracket::decode::{decode, head};
use crate::bracket::exposure::ExposureTags;
use exif::Tag;
use std::io::Cursor;
use std::path::Path;

/// Returns the exposure time and f-number that the decoder finds, and checks that the header has the same values.
fn exposure(bytes: &[u8]) -> (Option<f64>, Option<f64>) {
    let wanted = [Tag::Orientation, Tag::ExposureTime, Tag::FNumber];
    let head = head(Path::new("picture"), Cursor::new(bytes), &wanted, &at_most(LIMIT)).unwrap();
    let decoded = decode(Path::new("picture"), bytes.to_vec(), &at_most(LIMIT)).unwrap();
    assert_eq!((head.width, head.height), (decoded.width, decoded.height));
    assert!(head.refused.is_none(), "{:?}", head.refused);
    let [of_head, of_picture] = [head.exif, decoded.exif].map(|exif| {
        let tags = exif.as_ref().map(ExposureTags::read).unwrap_or_default();
        (tags.time_s.map(|t| t.0), tags.f_number.map(|n| n.0))
    });
    assert_eq!(of_head, of_picture);
    of_picture
}

#[test]
fn png_of_raw_profiles_has_its_exif() {
    let block = |time: u32| {
        let ratio = exif::Value::Rational(vec![exif::Rational { num: 1, denom: time }]);
        exif_bytes(&[(Tag::ExposureTime, ratio)])
    };
    let profile = |bytes: &[u8]| {
        let digits: String = bytes.iter().map(|b| format!("{b:02x}")).collect();
        let lines: Vec<&str> = (0..digits.len()).step_by(72).map(|i| &digits[i..digits.len().min(i + 72)]).collect();
        format!("\nexif\n{:8}\n{}\n", bytes.len(), lines.join("\n"))
    };
    let with_marker = profile(&[&b"Exif\0\0"[..], &block(60)].concat());
    let png = |write: &dyn Fn(&mut ::png::Encoder<&mut Vec<u8>>)| {
        let mut bytes = Vec::new();
        let mut encoder = ::png::Encoder::new(&mut bytes, 2, 1);
        write(&mut encoder);
        encoder.write_header().unwrap().write_image_data(&[1, 2]).unwrap();
        bytes
    };
    let name = "Raw profile type exif".to_owned();
    let expected = (Some(1.0 / 60.0), None);
    assert_eq!(exposure(&png(&|e| e.add_ztxt_chunk(name.clone(), with_marker.clone()).unwrap())), expected);
    assert_eq!(exposure(&png(&|e| e.add_text_chunk(name.clone(), profile(&block(60))).unwrap())), expected);
    assert_eq!(exposure(&png(&|e| e.add_itxt_chunk(name.clone(), with_marker.clone()).unwrap())), expected);
    let other = "Raw profile type APP1".to_owned();
    assert_eq!(exposure(&png(&|e| e.add_ztxt_chunk(other.clone(), with_marker.clone()).unwrap())), expected);
    // Raw profiles with a wrong length or without digits are ignored.
    for bad in [with_marker.replace("exif\n ", "exif\n9"), with_marker.replace('4', "x"), String::new()] {
        assert_eq!(exposure(&png(&|e| e.add_ztxt_chunk(name.clone(), bad.clone()).unwrap())), (None, None));
    }
    // An eXIf chunk takes precedence over a raw profile.
    let mut both = png(&|e| e.add_ztxt_chunk(name.clone(), with_marker.clone()).unwrap());
    let mut info = ::png::Info::with_size(2, 1);
    info.color_type = ::png::ColorType::Grayscale;
    info.exif_metadata = Some(block(30).into());
    let mut plain = Vec::new();
    let mut encoder = ::png::Encoder::with_info(&mut plain, info).unwrap().write_header().unwrap();
    encoder.write_image_data(&[1, 2]).unwrap();
    drop(encoder);
    let at = |bytes: &[u8], kind: &[u8]| bytes.windows(4).position(|w| w == kind).unwrap() - 4;
    let chunk = plain[at(&plain, b"eXIf")..at(&plain, b"IDAT")].to_vec();
    let place = at(&both, b"IDAT");
    both.splice(place..place, chunk);
    assert_eq!(exposure(&both), (Some(1.0 / 30.0), None));
}

#[test]
fn tiff_with_its_exposure_in_the_first_directory_has_it() {
    use crate::tiff_file::tests::{DATA, file, rgb, with};
    let time = |num, denom| (33434, 5, vec![num, denom]);
    let picture = || with(with(rgb(5, 4, DATA), time(1, 60)), (33437, 5, vec![28, 10]));
    let data: Vec<u8> = (0..60).collect();
    assert_eq!(exposure(&file(&data, &[picture()])), (Some(1.0 / 60.0), Some(2.8)));
    // Where the first directory describes a thumbnail, tags that the picture lacks are taken from this directory,
    // except for the orientation.
    let turned = (274, 3, vec![6]);
    let thumbnail = with(with(with(rgb(1, 1, DATA), (254, 4, vec![1])), time(1, 30)), turned.clone());
    assert_eq!(exposure(&file(&data, &[thumbnail.clone(), rgb(5, 4, DATA)])), (Some(1.0 / 30.0), None));
    let bytes = file(&data, &[thumbnail.clone(), picture()]);
    assert_eq!(exposure(&bytes), (Some(1.0 / 60.0), Some(2.8)));
    assert_eq!(eight(read(&bytes)), data);
    let decoded = read(&file(&data, &[thumbnail, with(picture(), turned)])).unwrap();
    assert_eq!((decoded.width, decoded.height), (4, 5));
}
