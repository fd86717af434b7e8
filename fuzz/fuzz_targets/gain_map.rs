//! The gain-map writer.
//!
//! In: any radiance (also zeros, negative values, infinities and NaN, which no stage returns), any picture,
//! primaries, header texts and options. Checked: invalid options are an error; otherwise the file is accepted by a
//! strict reader, and its two pictures can be decoded and have the right sizes.
#![no_main]

use arbitrary::{Arbitrary, Unstructured};
use hdralign::bracket::Capture;
use hdralign::bracket::colour::{Primaries, Profile, Space};
use hdralign::merge::RadianceMap;
use hdralign::plane::Plane;
use hdralign::tonemap::DisplayImage;
use hdralign::write::jpeg::{self, Resolution};
use hdralign::write::{self, Metadata, commit};
use hdralign_fuzz::{folder, held, set_up, ultra_hdr as reader};
use libfuzzer_sys::fuzz_target;

fuzz_target!(init: set_up(), |case: Case| held(|| gain_map(case)));

/// The arguments of the writer, without its pixels.
#[derive(Debug, Arbitrary)]
struct Words {
    make: Option<String>,
    model: Option<String>,
    date: Option<String>,
    lens: Option<String>,
    focal_length_mm: Option<f64>,
    exif: Option<Vec<u8>>,
    software: String,
    time_s: Option<f64>,
    f_number: Option<f64>,
    iso: Option<f64>,
    profile: Option<(Vec<u8>, String)>,
}

#[derive(Debug)]
struct Case {
    words: Words,
    quality: u8,
    gain_map: Resolution,
    primaries: Primaries,
    radiance: Plane<[f32; 3]>,
    picture: Plane<[u8; 3]>,
}

impl<'a> Arbitrary<'a> for Case {
    fn arbitrary(u: &mut Unstructured<'a>) -> arbitrary::Result<Self> {
        // Wide or high pictures have several strips and a short last one.
        let (width, height) = match u.int_in_range(0..=9)? {
            0 => (u.int_in_range(1..=400)?, u.int_in_range(1..=3)?),
            1 => (u.int_in_range(1..=3)?, u.int_in_range(1..=400)?),
            _ => (u.int_in_range(1..=40)?, u.int_in_range(1..=40)?),
        };
        let primaries = match u.int_in_range(0..=7)? {
            0 => {
                let mut xy = || -> arbitrary::Result<[f64; 2]> { Ok([f64::arbitrary(u)?, f64::arbitrary(u)?]) };
                Primaries { red: xy()?, green: xy()?, blue: xy()?, white: xy()? }
            }
            1 => Space::Acescg.primaries(),
            2 => Space::Prophoto.primaries(),
            3 => Space::Rec2020.primaries(),
            _ => Primaries::SRGB,
        };
        let quality = if u.ratio(1, 8)? { u8::arbitrary(u)? } else { u.int_in_range(1..=100)? };
        let gain_map = *u.choose(&[Resolution::Full, Resolution::Half, Resolution::None])?;
        let words = if bool::arbitrary(u)? { Words::arbitrary(u)? } else { Words::arbitrary(&mut Unstructured::new(&[]))? };
        let kind = u.int_in_range(0..=3)?;
        // The bytes are repeated, so that any number of bytes is enough for a picture of any size.
        let bytes = u.bytes(u.len())?;
        let byte = |i: usize| bytes.get(i % bytes.len().max(1)).copied().unwrap_or(0);
        let any = |i: usize| f32::from_bits(u32::from_be_bytes([0, 1, 2, 3].map(|k| byte(4 * i + k))));
        let value = |i: usize| match kind {
            0 => any(i),
            1 => (f32::from(byte(i)) / 8.0 - 16.0).exp2(),
            2 => (f32::from(byte(i)) - 128.0).exp2(),
            _ => f32::from(byte(0)),
        };
        let at = |x: usize, y: usize, c: usize| 3 * (y * width + x) + c;
        let radiance = Plane::from_rows(width, height, |y, row| {
            row.iter_mut().enumerate().for_each(|(x, p)| *p = [0, 1, 2].map(|c| value(at(x, y, c))));
        });
        let picture = Plane::from_rows(width, height, |y, row| {
            row.iter_mut().enumerate().for_each(|(x, p)| *p = [0, 1, 2].map(|c| byte(at(x, y, c) + 7)));
        });
        Ok(Case { words, quality, gain_map, primaries, radiance, picture })
    }
}

fn gain_map(case: Case) {
    let Case { words, quality, gain_map, primaries, radiance, picture } = case;
    let capture = Capture {
        make: words.make,
        model: words.model,
        date: words.date,
        lens: words.lens,
        focal_length_mm: words.focal_length_mm,
        exif: words.exif,
        ..Capture::default()
    };
    let metadata = Metadata {
        capture,
        software: words.software,
        time_s: words.time_s,
        f_number: words.f_number,
        iso: words.iso,
        profile: words.profile.map(|(icc, description)| Profile { icc, description, primaries: None }),
        ..Metadata::default()
    };
    let options =
        write::Options { jpeg: jpeg::Options { quality, gain_map }, overwrite: true, ..write::Options::default() };
    let path = folder().join("g.jpg");
    let (width, height) = (radiance.width() as u32, radiance.height() as u32);
    let map = RadianceMap { pixels: radiance, primaries };
    let written = write::write(&[path.clone()], &map, &DisplayImage { pixels: picture }, &metadata, &options);
    let written = match written {
        Ok(written) => written,
        Err(e) => {
            assert!(options.jpeg.validate().is_err(), "{e}");
            return;
        }
    };
    assert!(options.jpeg.validate().is_ok());
    commit(written.into_iter().map(|w| w.file).collect(), true).expect("named");
    let bytes = std::fs::read(&path).expect("it was written");
    let step = match gain_map {
        Resolution::None => return assert_eq!(reader::check_plain(&bytes), (width, height)),
        Resolution::Full => 1,
        Resolution::Half => 2,
    };
    assert_eq!(reader::check(&bytes), [(width, height), (width.div_ceil(step), height.div_ceil(step))]);
}
