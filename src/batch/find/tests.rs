//! Tests of the search in folders of files that contain EXIF.

use super::*;
use exif::experimental::Writer;
use exif::{Field, In, Rational, SRational, Tag, Value};
use std::fs;
use std::io::Cursor;
use std::path::Path;

/// The content of the EXIF of a photograph.
#[derive(Clone)]
struct Says {
    model: &'static str,
    /// Time of the photograph, in hundredths of a second after noon.
    at: u32,
    /// Shutter time in seconds: numerator and denominator.
    time: (u32, u32),
    /// EXIF ExposureMode: 0 is automatic, 1 manual, 2 automatic bracket.
    mode: u16,
    bias: i32,
    flash: bool,
    portrait: bool,
    software: &'static str,
}

const MIDDLE: Says =
    Says { model: "A", at: 0, time: (1, 60), mode: 2, bias: 0, flash: false, portrait: false, software: "" };

fn exif(says: &Says) -> Vec<u8> {
    let text = |text: &str| Value::Ascii(vec![text.as_bytes().to_vec()]);
    let seconds = says.at / 100;
    let date = format!("2026:05:01 {:02}:{:02}:{:02}", 12 + seconds / 3600, seconds / 60 % 60, seconds % 60);
    let fields = [
        (Tag::Make, text("Maker")),
        (Tag::Model, text(says.model)),
        (Tag::Software, text(says.software)),
        (Tag::Orientation, Value::Short(vec![if says.portrait { 6 } else { 1 }])),
        (Tag::DateTimeOriginal, text(&date)),
        (Tag::SubSecTimeOriginal, text(&format!("{:02}", says.at % 100))),
        (Tag::ExposureTime, Value::Rational(vec![Rational { num: says.time.0, denom: says.time.1 }])),
        (Tag::FNumber, Value::Rational(vec![Rational { num: 8, denom: 1 }])),
        (Tag::PhotographicSensitivity, Value::Short(vec![100])),
        (Tag::ExposureBiasValue, Value::SRational(vec![SRational { num: says.bias, denom: 1 }])),
        (Tag::ExposureMode, Value::Short(vec![says.mode])),
        (Tag::Flash, Value::Short(vec![u16::from(says.flash)])),
    ];
    let fields = fields.map(|(tag, value)| Field { tag, ifd_num: In::PRIMARY, value });
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut block = Cursor::new(Vec::new());
    writer.write(&mut block, false).unwrap();
    block.into_inner()
}

/// Returns a JPEG file that ends before its pixel data. The search reads only the part before.
fn jpeg(exif: Option<Vec<u8>>, (width, height): (u16, u16)) -> Vec<u8> {
    let mut bytes = b"\xff\xd8".to_vec();
    let mut segment = |code: u8, content: &[u8]| {
        bytes.extend([0xFF, code]);
        bytes.extend((content.len() as u16 + 2).to_be_bytes());
        bytes.extend(content);
    };
    if let Some(exif) = exif {
        segment(0xE1, &[&b"Exif\0\0"[..], &exif].concat());
    }
    let ([h1, h2], [w1, w2]) = (height.to_be_bytes(), width.to_be_bytes());
    segment(0xC0, &[8, h1, h2, w1, w2, 1, 1, 0x11, 0]);
    segment(0xDA, &[1, 1, 0, 0, 63, 0]);
    bytes
}

fn put(folder: &Path, name: &str, says: &Says) {
    fs::create_dir_all(folder.join(name).parent().unwrap()).unwrap();
    fs::write(folder.join(name), jpeg(Some(exif(says)), (300, 200))).unwrap();
}

/// Writes three frames of an automatic bracket, 0.33 s apart; the first has the time `at`. The numbers in the file
/// names start at `first`.
fn put_bracket(folder: &Path, first: u32, at: u32, says: &Says) {
    for (i, (time, bias)) in [((1, 60), 0), ((1, 250), -2), ((1, 15), 2)].into_iter().enumerate() {
        let says = Says { at: at + 33 * i as u32, time, bias, ..says.clone() };
        put(folder, &format!("IMG_{:04}.JPG", first + i as u32), &says);
    }
}

fn found(folder: &Path, options: &FindOptions) -> Found {
    find(&[folder.to_owned()], options, &|_| ()).unwrap()
}

/// Returns a text for each bracket: the file names of its photographs, without `IMG_` and extension.
fn names(found: &Found) -> Vec<String> {
    let name = |shot: &Shot| shot.path.file_stem().unwrap().to_string_lossy().replace("IMG_", "");
    found.brackets.iter().map(|b| b.photographs.iter().map(name).collect::<Vec<_>>().join(" ")).collect()
}

fn reasons(found: &Found) -> Vec<(String, Reason)> {
    let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
    found.left_over.iter().map(|left| (name(&left.path), left.reason.clone())).collect()
}

#[test]
fn two_bodies_at_once_a_flash_and_a_stray_are_distinguished() {
    let folder = tempfile::tempdir().unwrap();
    put_bracket(folder.path(), 1, 100, &MIDDLE);
    // Another camera takes a bracket at the same time. 0004 is an additional frame with flash, as real-estate
    // photographers take it.
    put_bracket(folder.path(), 101, 116, &Says { model: "B", ..MIDDLE });
    put(folder.path(), "IMG_0004.JPG", &Says { at: 400, flash: true, mode: 1, ..MIDDLE });
    put(folder.path(), "IMG_0005.JPG", &Says { at: 700, mode: 0, ..MIDDLE });
    put_bracket(folder.path(), 6, 1000, &MIDDLE);
    let found = found(folder.path(), &FindOptions::default());
    assert_eq!(names(&found), ["0001 0002 0003", "0101 0102 0103", "0006 0007 0008"]);
    assert_eq!(reasons(&found), [("IMG_0004.JPG".into(), Reason::Flash), ("IMG_0005.JPG".into(), Reason::Single)]);
    // The third bracket starts 9 s after the first. It is from the same camera and has the same exposure steps, so
    // both are in panorama 0.
    assert_eq!(found.brackets.iter().map(|b| b.set).collect::<Vec<_>>(), [0, 1, 0]);
}

#[test]
fn bracket_continues_over_the_rollover_of_the_counter() {
    let folder = tempfile::tempdir().unwrap();
    for (name, at, time, bias) in [
        ("100CANON/IMG_9998.JPG", 0, (1, 60), 0),
        ("100CANON/IMG_9999.JPG", 33, (1, 250), -2),
        ("101CANON/IMG_0001.JPG", 66, (1, 15), 2),
    ] {
        put(folder.path(), name, &Says { at, time, bias, ..MIDDLE });
    }
    let found = found(folder.path(), &FindOptions::default());
    assert_eq!(names(&found), ["9998 9999 0001"]);
    assert_eq!(found.brackets[0].folder, Path::new("100CANON"));
}

#[test]
fn counter_that_restarts_within_a_second_is_recognised_in_one_folder_and_in_the_next() {
    for folders in [["A", "A"], ["100CANON", "101CANON"]] {
        let folder = tempfile::tempdir().unwrap();
        let [before, after] = folders;
        put(folder.path(), &format!("{before}/IMG_9998.JPG"), &Says { time: (1, 60), ..MIDDLE });
        put(folder.path(), &format!("{before}/IMG_9999.JPG"), &Says { time: (1, 250), bias: -2, ..MIDDLE });
        put(folder.path(), &format!("{after}/IMG_0001.JPG"), &Says { time: (1, 15), bias: 2, ..MIDDLE });
        let found = found(folder.path(), &FindOptions::default());
        assert_eq!(names(&found), ["9998 9999 0001"], "{folders:?}");
    }
}

#[test]
fn each_shot_is_used_once_and_results_never() {
    let folder = tempfile::tempdir().unwrap();
    put_bracket(folder.path(), 1, 0, &MIDDLE);
    let at = |name: &str| folder.path().join(name);
    for name in ["IMG_0001.CR2", "IMG_0002.CR2", "IMG_0009.NEF", "IMG_0001.heic", "notes.txt"] {
        fs::write(at(name), "-").unwrap();
    }
    fs::write(at("._IMG_0001.JPG"), "-").unwrap();
    put(folder.path(), "IMG_0001-IMG_0003.jpg", &Says { software: "hdralign 0.1.0", at: 10, ..MIDDLE });
    fs::write(at("broken.jpg"), &jpeg(None, (300, 200))[..9]).unwrap();
    fs::write(at("plain.jpg"), jpeg(None, (300, 200))).unwrap();
    fs::hard_link(at("IMG_0002.JPG"), at("copy.jpg")).unwrap();
    let found = found(folder.path(), &FindOptions::default());
    assert_eq!(names(&found), ["0001 0002 0003"]);
    assert_eq!(found.other_files, 1);
    let own = |name: &str| at(name);
    let expected: [(&str, Reason); 8] = [
        ("IMG_0001-IMG_0003.jpg", Reason::Result("hdralign 0.1.0".into())),
        ("IMG_0001.CR2", Reason::Raw(Some(own("IMG_0001.JPG")))),
        ("IMG_0001.heic", Reason::Format("HEIC")),
        ("IMG_0002.CR2", Reason::Raw(Some(own("IMG_0002.JPG")))),
        ("IMG_0009.NEF", Reason::Raw(None)),
        ("broken.jpg", Reason::Unreadable(String::new())),
        ("copy.jpg", Reason::SameFile(own("IMG_0002.JPG"))),
        ("plain.jpg", Reason::NoExposure),
    ];
    let got = reasons(&found);
    assert_eq!(got.len(), expected.len(), "{got:#?}");
    for ((name, reason), (expected_name, expected_reason)) in got.into_iter().zip(expected) {
        assert_eq!(name, expected_name);
        match reason {
            Reason::Unreadable(why) => assert!(why.contains("truncated") && !why.contains('/'), "{why}"),
            other => assert_eq!(other, expected_reason),
        }
    }
}

#[test]
fn a_tiff_is_used_in_place_of_its_jpeg() {
    let folder = tempfile::tempdir().unwrap();
    put_bracket(folder.path(), 1, 0, &MIDDLE);
    // For each JPEG there is also a TIFF with the same name, exposure and time.
    for (i, (time, bias)) in [((1, 60), 0), ((1, 250), -2), ((1, 15), 2)].into_iter().enumerate() {
        let says = Says { at: 33 * i as u32, time, bias, ..MIDDLE };
        fs::write(folder.path().join(format!("IMG_{:04}.tif", i + 1)), tiff(&says)).unwrap();
    }
    let found = found(folder.path(), &FindOptions::default());
    assert_eq!(found.brackets.len(), 1);
    let shots = &found.brackets[0].photographs;
    assert!(shots.iter().all(|shot| shot.path.extension().unwrap() == "tif" && shot.header.depth == 16), "{shots:?}");
    assert_eq!(shots[1].header.bias_stops, Some(-2.0));
    assert!(reasons(&found).iter().all(|(_, reason)| matches!(reason, Reason::Twin(_))));
    assert_eq!(found.left_over.len(), 3);
}

/// Returns a 16-bit TIFF of 4 x 2 pixels with the EXIF of `says`.
fn tiff(says: &Says) -> Vec<u8> {
    use tiff::encoder::{TiffEncoder, colortype};
    use tiff::tags::Tag as Number;
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new(&mut bytes).unwrap();
    let read = exif::Reader::new().read_raw(exif(says)).unwrap();
    let text = |tag| read.get_field(tag, In::PRIMARY).unwrap().display_value().to_string().replace('"', "");
    let rational = |tag| match &read.get_field(tag, In::PRIMARY).unwrap().value {
        Value::Rational(v) => tiff::encoder::Rational { n: v[0].num, d: v[0].denom },
        other => panic!("{other:?}"),
    };
    let mut directory = encoder.extra_directory().unwrap();
    let date = text(Tag::DateTimeOriginal).replace('-', ":");
    directory.write_tag(Number::Unknown(Tag::DateTimeOriginal.number()), date.as_str()).unwrap();
    directory
        .write_tag(Number::Unknown(Tag::SubSecTimeOriginal.number()), text(Tag::SubSecTimeOriginal).as_str())
        .unwrap();
    directory.write_tag(Number::Unknown(Tag::ExposureTime.number()), rational(Tag::ExposureTime)).unwrap();
    directory.write_tag(Number::Unknown(Tag::FNumber.number()), rational(Tag::FNumber)).unwrap();
    let bias = tiff::encoder::SRational { n: says.bias, d: 1 };
    directory.write_tag(Number::Unknown(Tag::ExposureBiasValue.number()), bias).unwrap();
    directory.write_tag(Number::Unknown(Tag::ExposureMode.number()), says.mode).unwrap();
    let at = directory.finish_with_offsets().unwrap().offset;
    let mut image = encoder.new_image::<colortype::RGB16>(4, 2).unwrap();
    image.encoder().write_tag(Number::ExifDirectory, at).unwrap();
    image.encoder().write_tag(Number::Unknown(Tag::Model.number()), says.model).unwrap();
    image.write_data(&[7; 24]).unwrap();
    bytes.into_inner()
}

#[test]
fn by_count_and_by_folder_need_no_exif() {
    let folder = tempfile::tempdir().unwrap();
    for i in 1..=11 {
        fs::create_dir_all(folder.path().join("room")).unwrap();
        fs::write(folder.path().join(format!("room/{i}.jpg")), jpeg(None, (300, 200))).unwrap();
    }
    fs::write(folder.path().join("room/preview.jpg"), jpeg(None, (30, 20))).unwrap();
    let by_count = found(folder.path(), &FindOptions { frames: Some(3), ..FindOptions::default() });
    assert_eq!(names(&by_count), ["1 2 3", "4 5 6", "7 8 9"]);
    let left: Vec<_> = ["10.jpg", "11.jpg", "preview.jpg"].map(|name| (name.to_owned(), Reason::Remainder(3))).into();
    assert_eq!(reasons(&by_count), left);

    let by_folder = found(folder.path(), &FindOptions { by_folder: true, ..FindOptions::default() });
    assert_eq!(names(&by_folder), ["1 2 3 4 5 6 7 8 9 10 11"]);
    assert_eq!(reasons(&by_folder), [("preview.jpg".into(), Reason::OtherSize((30, 20), (300, 200)))]);
}

#[test]
fn hard_limit_ends_slow_bursts() {
    let folder = tempfile::tempdir().unwrap();
    for (i, time) in [(1, 2), (1, 8), (1, 30), (1, 125)].into_iter().enumerate() {
        let at = if i < 2 { 1000 * i } else { 1000 * i + 4000 };
        put(folder.path(), &format!("{i}.jpg"), &Says { at: at as u32, time, mode: 1, ..MIDDLE });
    }
    assert_eq!(names(&found(folder.path(), &FindOptions::default())), ["0 1 2 3"]);
    let hurried = FindOptions { gap_s: Some(20.0), ..FindOptions::default() };
    assert!(names(&found(folder.path(), &hurried)).iter().all(|name| name != "0 1 2 3"));
}

#[test]
fn search_does_not_depend_on_order_and_links_do_not_loop() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a"), folder.path().join("b"));
    put_bracket(&a, 1, 0, &MIDDLE);
    put_bracket(&b, 1, 9000, &MIDDLE);
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(folder.path(), a.join("above")).unwrap();
        std::os::unix::fs::symlink(b.join("IMG_0002.JPG"), a.join("linked.jpg")).unwrap();
    }
    let options = FindOptions::default();
    let once = find(&[a.clone(), b.clone()], &options, &|_| ()).unwrap();
    assert_eq!(once, find(&[b.clone(), a.clone(), b.clone()], &options, &|_| ()).unwrap());
    assert_eq!(names(&once), ["0001 0002 0003", "0001 0002 0003"]);
    assert_eq!(once.brackets[1].root, b);
    let skipping = FindOptions { skip: vec![b.clone()], ..options.clone() };
    assert_eq!(found(folder.path(), &skipping).brackets.len(), 1);
    let count = AtomicUsize::new(0);
    find(std::slice::from_ref(&a), &options, &|done| _ = count.fetch_max(done, Ordering::Relaxed)).unwrap();
    assert!(count.into_inner() >= 3);

    let missing = find(&[a.join("missing")], &options, &|_| ()).unwrap_err().to_string();
    assert!(missing.contains("missing: cannot be read"), "{missing}");
    let file = find(&[a.join("IMG_0001.JPG")], &options, &|_| ()).unwrap_err().to_string();
    assert!(file.contains("name the folder"), "{file}");
    let one = find(&[a], &FindOptions { frames: Some(1), ..options }, &|_| ()).unwrap_err();
    assert!(one.is_usage() && one.to_string().starts_with("--bracket"), "{one}");
}

#[test]
fn the_size_is_as_seen() {
    let folder = tempfile::tempdir().unwrap();
    put(folder.path(), "upright.jpg", &Says { portrait: true, ..MIDDLE });
    let header = Header::read(&folder.path().join("upright.jpg"), &Limits::default()).unwrap();
    assert_eq!((header.width, header.height), (200, 300));
}
