//! The camera: from radiance to a JPEG with EXIF.
//!
//! The exposure is X = L t / [`SATURATION`], 1 where the sensor is full. The photo-electrons have shot and read noise.
//! The response is the S curve of a film, f(X) = (1 + s) X^n / (X^n + s).

use std::io::Cursor;

use exif::experimental::Writer;
use exif::{Field, In, Rational, Tag, Value};
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use img_parts::ImageEXIF;
use img_parts::jpeg::Jpeg;

use super::noise::gaussian;
use super::scene::{HEIGHT, WIDTH};
use super::vec3::V3;

/// Exposure times of the frames as fractions of a second: two stops apart, darkest first.
pub const TIMES: [(u32, u32); 5] = [(1, 512), (1, 128), (1, 32), (1, 8), (1, 2)];
/// Index of the reference frame, the middle one.
pub const REFERENCE: usize = 2;
pub const F_NUMBER: u32 = 8;
pub const ISO: u16 = 100;

/// Luminance times exposure time that fills the sensor at f/8 and ISO 100, in cd s/m2: 78 / ISO * N^2 / 0.65.
pub const SATURATION: f64 = 76.8;

/// Number of photo-electrons at saturation.
pub const FULL_WELL: f64 = 20_000.0;
/// Standard deviation of the read noise, in electrons.
pub const READ_NOISE: f64 = 4.0;

/// The constant n of the response.
pub const POWER: f64 = 0.8;
/// The constant s of the response.
pub const KNEE: f64 = 0.45;

/// The response as a formula, for readers of `truth.json`.
pub const FORMULA: &str =
    "f(X) = (1 + s) X^n / (X^n + s), n = 0.8, s = 0.45; X = 1 at saturation; value = round(255 f(X))";

pub const QUALITY: u8 = 90;

/// Returns the brightness 0..1 for the exposure `x` 0..1, by the S curve of a film.
pub fn response(x: f64) -> f64 {
    let p = x.clamp(0.0, 1.0).powf(POWER);
    (1.0 + KNEE) * p / (p + KNEE)
}

/// Returns the exposure 0..1 for the brightness `y` 0..1: the inverse of [`response`].
pub fn inverse_response(y: f64) -> f64 {
    (y * KNEE / (1.0 + KNEE - y)).powf(1.0 / POWER)
}

/// Returns the exposure time of frame `i` in seconds.
pub fn seconds(i: usize) -> f64 {
    f64::from(TIMES[i].0) / f64::from(TIMES[i].1)
}

/// Returns the code values of frame `i` (RGB by rows) for the `radiance` on its pixels, in cd/m2.
pub fn expose(radiance: &[V3], i: usize) -> Vec<u8> {
    let one = |l: f32, pixel: usize, channel: usize| {
        let electrons = f64::from(l) * seconds(i) / SATURATION * FULL_WELL;
        let sigma = (electrons.max(0.0) + READ_NOISE * READ_NOISE).sqrt();
        let noise = f64::from(gaussian(pixel as u32, 7 + i as u32, channel as u32));
        (255.0 * response((electrons + sigma * noise) / FULL_WELL)).round() as u8
    };
    radiance.iter().enumerate().flat_map(|(k, p)| [one(p.x, k, 0), one(p.y, k, 1), one(p.z, k, 2)]).collect()
}

/// Encodes code values as a JPEG with the EXIF of frame `i`.
pub fn jpeg(values: &[u8], i: usize) -> Vec<u8> {
    let mut plain = Vec::new();
    JpegEncoder::new_with_quality(&mut plain, QUALITY)
        .write_image(values, WIDTH as u32, HEIGHT as u32, ExtendedColorType::Rgb8)
        .expect("a JPEG in memory");
    let mut whole = Jpeg::from_bytes(plain.into()).expect("our own JPEG");
    whole.set_exif(Some(exif_block(i).into()));
    let mut out = Vec::new();
    whole.encoder().write_to(&mut out).expect("a JPEG in memory");
    out
}

/// Returns the file name of frame `i`.
pub fn file_name(i: usize) -> String {
    format!("window_{}.jpg", i + 1)
}

/// Returns the EXIF fields of frame `i`: they differ between frames only in the times.
pub fn exif_fields(i: usize) -> Vec<Field> {
    let field = |tag, value| Field { tag, ifd_num: In::PRIMARY, value };
    let text = |s: &str| Value::Ascii(vec![s.as_bytes().to_vec()]);
    let ratio = |num, denom| Value::Rational(vec![Rational { num, denom }]);
    // The frames are taken a second apart.
    let taken = text(&format!("2026:09:19 17:42:{:02}", 10 + i));
    vec![
        field(Tag::Make, text("hdralign")),
        field(Tag::Model, text("testdata")),
        field(Tag::Software, text("hdralign tests/window")),
        field(Tag::DateTime, taken.clone()),
        field(Tag::Orientation, Value::Short(vec![1])),
        field(Tag::ExposureTime, ratio(TIMES[i].0, TIMES[i].1)),
        field(Tag::FNumber, ratio(F_NUMBER, 1)),
        field(Tag::PhotographicSensitivity, Value::Short(vec![ISO])),
        field(Tag::DateTimeOriginal, taken),
        field(Tag::FocalLength, ratio(24, 1)),
        field(Tag::FocalLengthIn35mmFilm, Value::Short(vec![24])),
        field(Tag::ColorSpace, Value::Short(vec![1])),
        field(Tag::PixelXDimension, Value::Long(vec![WIDTH as u32])),
        field(Tag::PixelYDimension, Value::Long(vec![HEIGHT as u32])),
    ]
}

fn exif_block(i: usize) -> Vec<u8> {
    let fields = exif_fields(i);
    let mut writer = Writer::new();
    for f in &fields {
        writer.push_field(f);
    }
    let mut block = Cursor::new(Vec::new());
    writer.write(&mut block, false).expect("EXIF in memory");
    block.into_inner()
}
