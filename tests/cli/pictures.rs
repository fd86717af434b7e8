//! Options of pictures: bits, formats, colours, capture data, crops and sizes. Results are read with other decoders.

use crate::support::{Folder, jpeg, small};
use hdralign::bracket::colour::{Conversion, Primaries, Space, srgb_to_linear};
use hdralign::merge::RadianceMap;
use hdralign::plane::Plane;
use hdralign::tonemap::DisplayImage;
use hdralign::write::{self, Metadata};
use image::{DynamicImage, ImageDecoder, ImageReader};

const MERGE: &str = "merge w2.jpg w3.jpg w4.jpg --align none -q --force";

/// Returns the code values of a 16-bit picture, and its size.
fn sixteen(folder: &Folder, name: &str) -> (Vec<u16>, (u32, u32)) {
    match image::open(folder.at(name)).unwrap_or_else(|e| panic!("{name}: {e}")) {
        DynamicImage::ImageRgb16(picture) => {
            let size = picture.dimensions();
            (picture.into_raw(), size)
        }
        other => panic!("{name}: {:?}", other.color()),
    }
}

/// Returns the code values of an 8-bit picture, and its size.
fn eight(folder: &Folder, name: &str) -> (Vec<u8>, (u32, u32)) {
    match image::open(folder.at(name)).unwrap_or_else(|e| panic!("{name}: {e}")) {
        DynamicImage::ImageRgb8(picture) => {
            let size = picture.dimensions();
            (picture.into_raw(), size)
        }
        other => panic!("{name}: {:?}", other.color()),
    }
}

/// Checks that `line` is refused as wrong usage, with a message that contains all of `said`.
fn refused(folder: &Folder, line: &str, said: &[&str]) {
    let before = folder.listing();
    let run = folder.line(line);
    assert_eq!((run.code, folder.listing()), (2, before), "{line}: {run:?}");
    assert!(said.iter().all(|part| run.stderr.contains(part)), "{line}: {}", run.stderr);
}

/// Code values of 8 and of 16 bits are rounded from the same floats: half an 8-bit step is 128.5 16-bit steps, and
/// tables add 0.05. If 16-bit values were scaled from 8 bits, all would be multiples of 257; of values rounded from
/// floats, one in 257 is.
#[test]
fn codes_of_16_bits_are_of_the_floats() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o a.exr --exr-type float")).done();
    for line in [MERGE, &format!("{MERGE} --tmo mertens"), &format!("{MERGE} --tmo drago"), "tonemap a.exr -q --force"]
    {
        folder.line(&format!("{line} -o a.png")).done();
        folder.line(&format!("{line} --bit-depth 16 -o b.png")).done();
        let ((coarse, size), (fine, fine_size)) = (eight(&folder, "a.png"), sixteen(&folder, "b.png"));
        assert_eq!(size, fine_size, "{line}");
        let off = coarse.iter().zip(&fine).map(|(&a, &b)| (257 * i32::from(a) - i32::from(b)).abs()).max();
        assert!(off <= Some(129), "{line}: {off:?}");
        let stretched = fine.iter().filter(|&&code| code % 65535 != 0 && code.is_multiple_of(257)).count();
        assert!(stretched * 50 < fine.len(), "{line}: {stretched} of {}", fine.len());
    }
}

#[test]
fn bits_that_a_file_does_not_hold_are_refused() {
    let folder = Folder::with_bracket();
    for line in [MERGE, "tonemap gone.exr"] {
        refused(&folder, &format!("{line} --bit-depth 16 -o a.png -o b.jpg"), &["--bit-depth", "b.jpg", "8 bits"]);
        refused(&folder, &format!("{line} --bit-depth 16 -o a.exr"), &["--bit-depth", "no picture is written"]);
        refused(&folder, &format!("{line} --bit-depth 12 -o a.png"), &["--bit-depth", "12", "16"]);
    }
}

/// Returns the profile embedded in a file, and its description.
fn profile(folder: &Folder, name: &str) -> Option<(moxcms::ColorProfile, String)> {
    let mut decoder = ImageReader::open(folder.at(name)).expect("a file").into_decoder().expect("a picture");
    let icc = decoder.icc_profile().expect("a readable file")?;
    let profile = moxcms::ColorProfile::new_from_slice(&icc).unwrap_or_else(|e| panic!("{name}: {e:?}"));
    let Some(moxcms::ProfileText::Localizable(words)) = &profile.description else { panic!("{name}: no words") };
    let words = words[0].value.clone();
    Some((profile, words))
}

/// Converts `codes` from `profile` to sRGB with another implementation of colour management.
fn to_srgb(profile: &moxcms::ColorProfile, codes: &[u8]) -> Vec<u8> {
    let (layout, srgb) = (moxcms::Layout::Rgb, moxcms::ColorProfile::new_srgb());
    let options = moxcms::TransformOptions::default();
    let transform = profile.create_transform_8bit(layout, &srgb, layout, options).expect("a way");
    let mut out = vec![0; codes.len()];
    transform.transform(codes, &mut out).expect("as many");
    out
}

/// Returns the mean difference of code values, and the difference that 19 of 20 do not exceed. (The largest differences
/// are not used, because saturated colours outside of a colour space are desaturated.)
fn difference(a: &[u8], b: &[u8]) -> (f64, u8) {
    let mut off: Vec<u8> = a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).collect();
    let mean = off.iter().map(|&d| f64::from(d)).sum::<f64>() / off.len() as f64;
    let place = off.len() * 95 / 100;
    (mean, *off.select_nth_unstable(place).1)
}

/// A picture in any colour space, converted to sRGB by its profile, looks like the picture in sRGB; read without the
/// profile, it does not.
#[test]
fn profile_describes_the_colours_in_every_format() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o a.exr --exr-type float")).done();
    for line in ["tonemap a.exr -q --force", &format!("{MERGE} --tmo mertens")] {
        let pictures = "--picture a.png --picture a.tif --picture a.jpg --gain-map none --jpeg-quality 100";
        folder.line(&format!("{line} {pictures}")).done();
        let srgb = ["a.png", "a.tif", "a.jpg"].map(|name| eight(&folder, name).0);
        assert!(srgb[0] == srgb[1], "{line}: the codes of a TIFF are those of a PNG");
        assert!(profile(&folder, "a.png").is_none(), "PNG says that it is sRGB");
        assert!(profile(&folder, "a.tif").is_some_and(|(_, words)| words.contains("sRGB")));
        for (colours, words) in [("display-p3", "Display P3"), ("adobe-rgb", "Adobe RGB (1998)")] {
            folder.line(&format!("{line} {pictures} --picture-colour {colours}")).done();
            for (name, srgb) in ["a.png", "a.tif", "a.jpg"].iter().zip(&srgb) {
                let (codes, _) = eight(&folder, name);
                let (profile, named) = profile(&folder, name).unwrap_or_else(|| panic!("{name} has no profile"));
                assert_eq!(named, words, "{name}");
                let (mean, most) = difference(&to_srgb(&profile, &codes), srgb);
                // Fusion depends on the code values, which differ between colour spaces; JPEG has losses even at the
                // best quality.
                let is_fused = line.contains("mertens");
                let allowed = if *name == "a.jpg" { 1.0 } else { 0.0 } + if is_fused { 2.2 } else { 0.7 };
                assert!(
                    mean < allowed && most <= if is_fused { 8 } else { 4 },
                    "{line} {name} {colours}: {mean}, {most}"
                );
                let (taken_for_srgb, _) = difference(&codes, srgb);
                assert!(taken_for_srgb > mean + 0.4, "{line} {name} {colours}: {taken_for_srgb}");
            }
        }
    }
    // The PNG has a cICP chunk of Display P3 for readers that support it, and the profile for other readers.
    folder.line("tonemap a.exr --picture a.png --picture-color display-p3 --bit-depth 16 -q --force").done();
    let bytes = folder.bytes("a.png");
    let at = |name: &[u8; 4]| bytes.windows(4).position(|w| w == name);
    let cicp = at(b"cICP").expect("cICP");
    assert_eq!(bytes[cicp + 4..cicp + 8], [12, 13, 0, 1]);
    assert!(Some(cicp) < at(b"iCCP") && at(b"iCCP") < at(b"IDAT") && at(b"sRGB").is_none());
}

/// The red of Display P3 is unchanged in a picture in Display P3, and desaturated in a picture in sRGB.
#[test]
fn gamut_is_that_of_the_picture() {
    let folder = Folder::empty();
    let pixels = Plane::from_rows(90, 60, |y, row| {
        for (x, p) in row.iter_mut().enumerate() {
            let v = libm::exp2f(x as f32 / 15.0 - 3.0);
            *p = if y < 30 { [v; 3] } else { [v, 0.0, 0.0] };
        }
    });
    let map = RadianceMap { pixels, primaries: Primaries::DISPLAY_P3 };
    let display = DisplayImage { pixels: Plane::filled(90, 60, [0; 3]) };
    let files = write::write(&[folder.at("a.tif")], &map, &display, &Metadata::default(), &write::Options::default());
    write::commit(files.expect("a file").into_iter().map(|w| w.file).collect(), false).expect("a name");
    // Green and blue light in the red pixels relative to red, in the primaries of Display P3.
    let other = |options: &str, space: Space| {
        folder.line(&format!("tonemap a.tif --tmo drago --picture p.png -q --force {options}")).done();
        let (codes, _) = eight(&folder, "p.png");
        let red = codes.chunks(3).nth(50 * 90 + 30).expect("a pixel");
        let light = [0, 1, 2].map(|c| srgb_to_linear(f64::from(red[c]) / 255.0) as f32);
        let light = Conversion::between(&space.primaries(), &Primaries::DISPLAY_P3).expect("a way").apply(light);
        (light[1] / light[0], light[2] / light[0])
    };
    let (p3, srgb) = (other("--picture-colour display-p3", Space::DisplayP3), other("", Space::Srgb));
    // The tone curve adds a little green and blue; rounding to 8 bits changes this by up to 5 %.
    assert!(p3.0 < 0.015 && (p3.0 / p3.1 - 1.0).abs() < 0.05, "{p3:?}");
    assert!(srgb.0 > 2.0 * p3.0, "{srgb:?} {p3:?}");
}

#[test]
fn picture_option_writes_a_picture_for_any_extension() {
    let folder = Folder::with_bracket();
    let run = folder.line(&format!("{MERGE} -o a.tif --picture b.tif --bit-depth 16 --picture c.png")).done();
    assert_eq!(run.stdout, "a.tif\nb.tif\nc.png\n");
    assert!(hdralign::read::read(&folder.at("a.tif")).is_ok(), "-o stays radiance");
    assert!(sixteen(&folder, "b.tif") == sixteen(&folder, "c.png"), "the same codes");
    let mut tiff = tiff::decoder::Decoder::new(std::io::Cursor::new(folder.bytes("b.tif"))).expect("a TIFF");
    let resolution = tiff.get_tag(tiff::tags::Tag::XResolution).expect("a resolution");
    assert_eq!(format!("{resolution:?}"), "Rational(72, 1)");
    assert_eq!(tiff.get_tag_u32(tiff::tags::Tag::ResolutionUnit).expect("a unit"), 2);
    assert_eq!(tiff.get_tag_u32(tiff::tags::Tag::Compression).expect("a kind"), 8);
    // Pictures that hdralign wrote are accepted neither as radiance nor as photographs.
    assert_eq!(folder.line("tonemap b.tif -o x.png").code, 1);
    refused(&folder, "merge w1.jpg w2.jpg b.tif -o x.exr", &["b.tif is a result of hdralign"]);
    // With --picture only a picture is written.
    let run = folder.line("tonemap a.tif --picture d.tif -q").done();
    assert_eq!(run.stdout, "d.tif\n");
    assert!(eight(&folder, "d.tif").1 == (300, 200) && !folder.at("a.png").exists());
    for (line, said) in [
        ("--picture a.exr", &["--picture", "a.exr is a radiance format", "-o"][..]),
        ("--picture a.bmp", &["a.bmp", ".tif"]),
        ("--picture w2.jpg", &["--picture", "w2.jpg", "also an input file"]),
        ("-o x.png --picture x.png", &["--picture", "named twice, also by -o"]),
        ("--picture a.jpg --picture-colour adobe-rgb", &["--picture-colour", "a.jpg", "--gain-map none"]),
        ("-o a.exr --picture-colour display-p3", &["--picture-colour", "no picture is written"]),
        ("--picture a.png --picture-colour prophoto", &["prophoto", "adobe-rgb"]),
    ] {
        refused(&folder, &format!("{MERGE} {line}"), said);
    }
}

#[test]
fn batch_makes_pictures_beside_its_results() {
    let folder = Folder::empty();
    for i in 2..=4 {
        std::fs::create_dir_all(folder.at("in")).expect("a folder");
        folder.put(&format!("in/w{i}.jpg"), crate::support::small_jpeg(i));
    }
    let line = "batch in -d out -q --formats exr --pictures tif,png --bit-depth 16 --picture-colour display-p3";
    let run = folder.line(line).done();
    assert_eq!(
        run.stdout,
        "out/w2-w4.exr\nout/w2-w4.tif\nout/w2-w4.png\n".replace("out/", &format!("{}/", folder.at("out").display()))
    );
    assert!(sixteen(&folder, "out/w2-w4.tif") == sixteen(&folder, "out/w2-w4.png"));
    let before = folder.bytes("out/w2-w4.tif");
    folder.line(line).done();
    assert!(before == folder.bytes("out/w2-w4.tif"), "done before");
    refused(&folder, "batch in -d other --formats exr,tif --pictures tif", &["--pictures", "tif is given twice"]);
    refused(
        &folder,
        "batch in -d other --formats png --pictures exr",
        &["--pictures", "exr, hdr and dng with --formats"],
    );
    refused(&folder, "batch in -d other --formats exr --bit-depth 16", &["--bit-depth", "no picture"]);
    refused(&folder, "batch in -d other --formats png,jpg --bit-depth 16", &["--bit-depth", "JPEG"]);
}

/// Without deghosting, whose cells depend on the crop, the radiance of a crop is equal to that part of the whole, bit
/// by bit; all results show the crop.
#[test]
fn crop_equals_that_part_of_the_whole() {
    let folder = Folder::with_bracket();
    let merge = "merge w1.jpg w2.jpg w3.jpg w4.jpg --reference w3.jpg --deghost=off --exr-type float -q --force";
    folder.line(&format!("{merge} -C none -o whole.exr")).done();
    // The crop is at the upper left corner, which some frames do not cover.
    let outputs = "-o part.exr --picture part.tif --save-aligned al_ --report r.json";
    folder.line(&format!("{merge} -C 0,5,120,90 {outputs}")).done();
    let radiance = |name: &str| hdralign::read::read(&folder.at(name)).expect("radiance").0.pixels;
    let (whole, part) = (radiance("whole.exr"), radiance("part.exr"));
    assert_eq!((part.width(), part.height()), (120, 90));
    assert!((0..90).all(|y| part.row(y) == &whole.row(y + 5)[..120]));
    assert_eq!((eight(&folder, "part.tif").1, eight(&folder, "al_w3.tif").1), ((120, 90), (120, 90)));
    let report: serde_json::Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
    assert_eq!(report["options"]["crop"], "0,5,120,90");
    let sides = ["x_px", "y_px", "width_px", "height_px"].map(|key| report["crop"][key].as_u64());
    assert_eq!(sides, [Some(0), Some(5), Some(120), Some(90)]);
    for (part, said) in [
        ("0,0,301,10", "300 x 200 pixels"),
        ("0,190,10,11", "not inside the reference"),
        ("5,5,0,5", "empty"),
        ("5,5,5", "X,Y,WIDTH,HEIGHT"),
    ] {
        refused(&folder, &format!("{merge} -C {part} -o x.exr"), &["--crop", said]);
        refused(&folder, &format!("align w2.jpg w3.jpg --crop={part}"), &["--crop", said]);
    }
}

/// Compares with another implementation of Lanczos resampling in linear light, which differs only by the limitation of
/// ringing and by rounding.
#[test]
fn smaller_picture_is_the_light_of_the_large_one() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o a.exr --exr-type float")).done();
    for (line, colours) in [("tonemap a.exr -q --force", "srgb"), (&*format!("{MERGE} --tmo mertens"), "adobe-rgb")] {
        let line = format!("{line} --bit-depth 16 --picture-colour {colours}");
        folder.line(&format!("{line} --picture large.png")).done();
        folder.line(&format!("{line} --picture small.png --picture small.tif -o again.exr --resize 37%")).done();
        let ((large, size), (small, small_size)) = (sixteen(&folder, "large.png"), sixteen(&folder, "small.png"));
        assert_eq!((size, small_size), ((300, 200), (111, 74)));
        assert!(sixteen(&folder, "small.tif").0 == small);
        assert_eq!(hdralign::read::read(&folder.at("again.exr")).expect("radiance").0.pixels.width(), 300);
        let exponent = if colours == "srgb" { None } else { Some(563.0 / 256.0) };
        let light = |code: f64| exponent.map_or_else(|| srgb_to_linear(code), |e| code.powf(e));
        let of_large: Vec<f32> = large.iter().map(|&code| light(f64::from(code) / 65535.0) as f32).collect();
        let of_large = image::Rgb32FImage::from_raw(size.0, size.1, of_large).expect("a picture");
        let theirs = image::imageops::resize(&of_large, 111, 74, image::imageops::FilterType::Lanczos3);
        let off = |a: f32, b: f32| f64::from((a - b).abs());
        let ours = small.iter().map(|&code| light(f64::from(code) / 65535.0) as f32);
        let mut off: Vec<f64> = ours.zip(theirs.as_raw()).map(|(a, &b)| off(a, b)).collect();
        off.sort_by(f64::total_cmp);
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        assert!(mean < 0.004 && off[off.len() / 2] < 0.0005, "{line}: {mean}, {}", off[off.len() / 2]);
    }
}

#[test]
fn gain_map_follows_the_smaller_picture() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o a.exr --exr-type float")).done();
    let run = folder.line("tonemap a.exr --picture a.jpg --resize 150").done();
    assert!(run.stderr.contains("300 x 200 pixels, picture 150 x 100, "), "{}", run.stderr);
    let bytes = folder.bytes("a.jpg");
    let second = bytes.windows(4).rposition(|w| w[..3] == [0xFF, 0xD8, 0xFF]).expect("a second picture");
    let [base, map] = [&bytes[..second], &bytes[second..]].map(|jpeg| image::load_from_memory(jpeg).expect("a JPEG"));
    assert_eq!((base.width(), base.height(), map.width(), map.height()), (150, 100, 150, 100));
}

#[test]
fn picture_is_never_enlarged_and_size_without_picture_is_refused() {
    let folder = Folder::with_bracket();
    let run = folder.line("merge w2.jpg w3.jpg --align none -o a.png --resize 2048 --strict").done();
    assert!(run.stderr.contains("not enlarged to 2048"), "{}", run.stderr);
    assert_eq!(eight(&folder, "a.png").1, (300, 200));
    for (options, said) in [
        ("-o a.exr --resize 50%", &["--resize", "no picture is written"][..]),
        ("-o b.png --resize 120%", &["--resize", "never enlarged"]),
        ("-o b.png --resize 0", &["--resize", "2048", "50%"]),
        ("-o b.png --resize half", &["--resize", "half", "50%"]),
    ] {
        refused(&folder, &format!("{MERGE} {options}"), said);
    }
}

/// A reduced picture that consists of several slabs has the same bytes on any number of threads and with little memory.
#[test]
fn smaller_picture_has_the_same_bytes_on_any_threads_and_memory() {
    let folder = Folder::empty();
    for i in 2..=4 {
        let frame = image::imageops::resize(&small(i), 1200, 800, image::imageops::FilterType::Triangle);
        folder.put(&format!("w{i}.jpg"), &jpeg(&frame, Some(i)));
    }
    let made = |options: &str| {
        let pictures = "--picture a.tif --bit-depth 16 --resize 45%";
        folder.line(&format!("merge w2.jpg w3.jpg w4.jpg -C 3,5,1150,777 {pictures} -q --force {options}")).done();
        folder.bytes("a.tif")
    };
    let whole = made("--threads 1");
    assert!(whole == made("--threads 5") && whole == made("--threads 2 --max-memory 90MB"));
}
