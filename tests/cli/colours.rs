//! Colour spaces of inputs: PNG chunks, profile curves, and primaries that a format does not support, tested with the
//! program and its files.

use crate::support::{Folder, Run, small};
use hdralign::bracket::colour::{Conversion, Curve, Primaries, Profile, Transfer, linear_to_srgb, srgb_to_linear};
use hdralign::merge::RadianceMap;
use hdralign::plane::Plane;
use hdralign::read::read;
use hdralign::tonemap::DisplayImage;
use hdralign::write::{self, Metadata, tiff};
use image::RgbImage;
use serde_json::Value;

const MERGE: &str = "--align none -e=-2,0,2 --json -q --force";

fn json(run: &Run) -> Value {
    serde_json::from_str(&run.stdout).unwrap_or_else(|e| panic!("{e}: {run:?}"))
}

/// Name and content of a PNG chunk.
type Chunk = (&'static [u8; 4], Vec<u8>);

/// Returns the CRC of a PNG chunk (PNG specification, annex D).
fn crc(bytes: &[u8]) -> u32 {
    let step = |crc: u32, _| if crc & 1 == 1 { 0xEDB8_8320 ^ (crc >> 1) } else { crc >> 1 };
    !bytes.iter().fold(u32::MAX, |crc, &b| (0..8).fold(crc ^ u32::from(b), step))
}

/// Returns `picture` as a PNG with `chunks` after its header.
fn png(picture: &RgbImage, chunks: &[Chunk]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png).expect("a PNG");
    let bytes = bytes.into_inner();
    let mut out = bytes[..33].to_vec();
    for (kind, content) in chunks {
        let named = [&kind[..], content].concat();
        out.extend((content.len() as u32).to_be_bytes());
        out.extend(&named);
        out.extend(crc(&named).to_be_bytes());
    }
    out.extend(&bytes[33..]);
    out
}

/// Returns the content of a cHRM chunk: white, red, green, blue.
fn chrm(p: &Primaries) -> Vec<u8> {
    let numbers = [p.white, p.red, p.green, p.blue].concat();
    numbers.iter().flat_map(|v| ((v * 1e5).round() as u32).to_be_bytes()).collect()
}

fn gama(gamma: f64) -> Vec<u8> {
    ((gamma * 1e5).round() as u32).to_be_bytes().to_vec()
}

#[test]
fn png_colour_chunks_are_read_and_unsupported_ones_reported() {
    let folder = Folder::empty();
    let merged = |chunks: &[Chunk]| {
        for i in 2..=4 {
            folder.put(&format!("p{i}.png"), &png(&small(i), chunks));
        }
        let report = json(&folder.line(&format!("merge p2.png p3.png p4.png -o a.exr {MERGE}")));
        let said = report["warnings"].to_string();
        (report["colour"]["space"].as_str().map(str::to_owned), said)
    };
    let spaces: [(&str, &[Chunk]); 5] = [
        ("rec2020", &[(b"cICP", vec![9, 8, 0, 1])]),
        ("display-p3", &[(b"cICP", vec![12, 13, 0, 1]), (b"gAMA", gama(1.0))]),
        ("adobe-rgb", &[(b"gAMA", gama(0.45471)), (b"cHRM", chrm(&Primaries::ADOBE_RGB))]),
        ("srgb", &[(b"gAMA", gama(0.45455)), (b"cHRM", chrm(&Primaries::SRGB))]),
        ("srgb", &[(b"sRGB", vec![0]), (b"cHRM", chrm(&Primaries::ADOBE_RGB))]),
    ];
    for (space, chunks) in spaces {
        let (found, said) = merged(chunks);
        assert_eq!(found.as_deref(), Some(space), "{chunks:?}");
        assert!(!said.contains("colour") && !said.contains("cICP") && !said.contains("cHRM"), "{chunks:?}: {said}");
    }
    let doubtful: [(&str, &[Chunk]); 2] =
        [("cICP", &[(b"cICP", vec![9, 16, 0, 1])]), ("cHRM", &[(b"cHRM", vec![0; 32])])];
    for (chunk, chunks) in doubtful {
        let (found, said) = merged(chunks);
        assert!(found.as_deref() == Some("srgb") && said.contains(chunk), "{chunk}: {found:?} {said}");
    }
}

#[test]
fn png_of_linear_codes_equals_itself_in_srgb() {
    let folder = Folder::empty();
    let encoded = small(3);
    let linear = RgbImage::from_fn(encoded.width(), encoded.height(), |x, y| {
        image::Rgb(encoded.get_pixel(x, y).0.map(|v| (255.0 * srgb_to_linear(f64::from(v) / 255.0) + 0.5) as u8))
    });
    let again = RgbImage::from_fn(encoded.width(), encoded.height(), |x, y| {
        image::Rgb(linear.get_pixel(x, y).0.map(|v| (255.0 * linear_to_srgb(f64::from(v) / 255.0) + 0.5) as u8))
    });
    folder.put("linear.png", &png(&linear, &[(b"gAMA", gama(1.0))]));
    folder.put("srgb.png", &png(&again, &[]));
    let run = folder.line("compare srgb.png linear.png --tolerance-de 2 --json");
    // Code values are rounded twice, and the allowed difference is dE 2. If linear code values were read as sRGB, the
    // difference would be 30.
    assert!(run.code == 0, "{}", json(&run)["reason"]);
}

/// A bracket of ProPhoto TIFFs from a raw converter gives the same fused picture as the bracket in sRGB.
#[test]
fn fusion_decodes_by_the_curve_of_the_profile() {
    let folder = Folder::empty();
    let profile = Profile::of(&Primaries::PROPHOTO, Curve::Power(1.8), "ProPhoto RGB").expect("a profile");
    let transfer = Transfer::of(Some(&profile));
    assert!((transfer.light(1, 0.5) - libm::pow(0.5, 1.8)).abs() < 1e-4 && !transfer.is_srgb());
    let wide = Conversion::between(&Primaries::SRGB, &Primaries::PROPHOTO).expect("two spaces");
    for i in 2..=4 {
        let picture = small(i);
        picture.save(folder.at(format!("s{i}.png"))).expect("a PNG");
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        let codes = Plane::from_rows(width, height, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let rgb = picture.get_pixel(x as u32, y as u32).0;
                let light = wide.apply(rgb.map(|v| srgb_to_linear(f64::from(v) / 255.0) as f32));
                *p = light.map(|v| (65535.0 * libm::pow(f64::from(v), 1.0 / 1.8) + 0.5) as u16);
            }
        });
        let software = "a raw converter".to_owned();
        let metadata = Metadata { profile: Some(profile.clone()), software, ..Metadata::default() };
        let pending = write::Pending::create(&folder.at(format!("w{i}.tif"))).expect("a file");
        let writer = Box::new(tiff::Writer::<u16>::new(pending, (width, height), &metadata).expect("a TIFF"));
        write::commit(vec![write::push_all(writer, &codes).expect("a TIFF").file], false).expect("a TIFF");
    }
    let fused = |images: &str| {
        folder.line(&format!("merge {images} --tmo mertens -o p.png {MERGE}")).done();
        image::open(folder.at("p.png")).expect("a picture").to_rgb8().into_raw()
    };
    let (expected, found) = (fused("s2.png s3.png s4.png"), fused("w2.tif w3.tif w4.tif"));
    let off: u64 = expected.iter().zip(&found).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
    // Code values of 16 and of 8 bits are equal except for rounding. Values near white differ more, because some are
    // above 1 by rounding and clip.
    let mean = off as f64 / expected.len() as f64;
    assert!(mean < 1.0, "{mean}");
}

/// Tests ACES2065-1, whose blue has a negative y.
#[test]
fn primaries_with_a_negative_chromaticity_come_back_from_every_format() {
    let folder = Folder::empty();
    let to_ap0 = Conversion::between(&Primaries::SRGB, &Primaries::ACES_AP0).expect("two spaces");
    let scene = Plane::from_rows(90, 60, |y, row| {
        for (x, p) in row.iter_mut().enumerate() {
            let v = libm::exp2f(x as f32 / 15.0 - 3.0);
            *p = [v, v * (0.4 + y as f32 / 100.0), 0.3 * v];
        }
    });
    let put = |name: &str, primaries: Primaries, pixels: Plane<[f32; 3]>| {
        let map = RadianceMap { pixels, primaries };
        let display = DisplayImage { pixels: Plane::filled(1, 1, [0; 3]) };
        let options = write::Options {
            exr: write::exr::Options { sample: write::exr::Sample::Float, ..Default::default() },
            ..Default::default()
        };
        let files = write::write(&[folder.at(name)], &map, &display, &Metadata::default(), &options).expect("files");
        write::commit(files.into_iter().map(|w| w.file).collect(), true).expect("a name");
    };
    let wide = scene.as_slice().iter().map(|p| to_ap0.apply(*p)).collect();
    put("ap0.exr", Primaries::ACES_AP0, Plane::from_vec(90, 60, wide));
    put("srgb.exr", Primaries::SRGB, scene);
    let outputs = ["a.tif", "a.hdr", "b.exr", "a.png", "a.jpg"].map(|name| format!("-o {name}")).join(" ");
    folder.line(&format!("tonemap ap0.exr {outputs} --exr-type float -q")).done();
    for (name, tolerance) in [("a.tif", 2e-4), ("a.hdr", 1e-4), ("b.exr", 1e-6)] {
        let (map, _) = read(&folder.at(name)).expect("radiance");
        assert!(map.primaries.is_close(&Primaries::ACES_AP0, tolerance), "{name}: {:?}", map.primaries);
    }
    // A mantissa of RGBE is truncated by up to 1/128 of the largest component, which is a larger share of smaller ones.
    for (name, stops) in [("a.tif", 0.002), ("b.exr", 0.0001), ("a.hdr", 0.1)] {
        let run = folder.line(&format!("compare srgb.exr {name} --tolerance-stops {stops} --json"));
        assert_eq!(run.code, 0, "{name}: {}", json(&run)["reason"]);
    }
    folder.line("tonemap srgb.exr -o s.png -o s.jpg -q").done();
    for (a, b) in [("s.png", "a.png"), ("s.jpg", "a.jpg")] {
        let run = folder.line(&format!("compare {a} {b} --min-psnr 40 --json"));
        assert_eq!(run.code, 0, "{b}: {}", json(&run)["reason"]);
    }
}
