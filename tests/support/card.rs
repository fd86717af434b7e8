//! A simulated memory card, for tests and trials: brackets with all their EXIF, made from `testdata/window`.
//!
//! In: the shots (exposures, pauses, camera, size), added to a [`Card`] one by one. Out: JPEG files in a folder. Each
//! bracket shows another part of the room of `testdata/window`, mirrored or not, so that no two are equal; motion and
//! response are those of `testdata/window`. An exposure between the five of `testdata/window` is made from the next
//! darker one with the known response. Cost: about 15 ms of one core per frame of 960 px.

#![allow(dead_code, reason = "each test program uses a part of it")]

use exif::experimental::Writer;
use exif::{Field, In, Rational, SRational, Tag, Value};
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};
use img_parts::jpeg::Jpeg;
use img_parts::{Bytes, ImageEXIF};
use rayon::prelude::*;
use std::fs::{self, File};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::{Duration, UNIX_EPOCH};

/// 2026-09-19 00:00:00, in seconds since 1970: the day on which every card begins.
const DAY: u64 = 1_789_776_000;

/// Exposures of the photographs of `testdata/window` in EV relative to 1/32 s, darkest first.
const WINDOW_EV: [f64; 5] = [-4.0, -2.0, 0.0, 2.0, 4.0];

/// Smallest fraction of the window's width that a bracket shows; smaller parts would be mostly wall.
const LEAST_PART: f64 = 0.7;

/// Exposure times as recorded by cameras, one stop apart, from 1/4000 s to 30 s; the eighth is the nominal 1/30 s of
/// 0 EV.
const PRINTED: [(u32, u32); 18] = [
    (1, 4000),
    (1, 2000),
    (1, 1000),
    (1, 500),
    (1, 250),
    (1, 125),
    (1, 60),
    (1, 30),
    (1, 15),
    (1, 8),
    (1, 4),
    (1, 2),
    (1, 1),
    (2, 1),
    (4, 1),
    (8, 1),
    (15, 1),
    (30, 1),
];
const PRINTED_ZERO: i32 = 7;

/// A camera, by the data that it writes into each file.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {
    pub make: String,
    pub model: String,
    pub serial: String,
    pub lens: String,
    pub f_number: f64,
    pub iso: u16,
    pub focal_length_mm: u32,
    /// Whether times are recorded to hundredths of a second, and not only to seconds, as by old cameras.
    pub has_sub_seconds: bool,
    /// Pause from the end of an exposure to the start of the next one in a bracket, in ms.
    pub between_ms: u64,
}

impl Default for Camera {
    fn default() -> Self {
        Camera {
            make: "hdralign".into(),
            model: "Card One".into(),
            serial: "0815001".into(),
            lens: "24mm F2.8".into(),
            f_number: 8.0,
            iso: 100,
            focal_length_mm: 24,
            has_sub_seconds: true,
            between_ms: 180,
        }
    }
}

/// A shot: a single photograph or one frame of a bracket.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Path relative to the folder of the card.
    pub name: PathBuf,
    pub camera: Camera,
    /// Number of the view; shots of one view are frames of one bracket.
    pub view: u64,
    /// Exposure in EV relative to 1/32 s at the f-number and ISO of the camera; at least -4. It determines the exposure
    /// time.
    pub ev: f64,
    /// The value of `ExposureBiasValue`.
    pub bias_ev: f64,
    /// Start of the exposure, in ms since the beginning of the first day of the card.
    pub begin_ms: u64,
    pub is_auto_bracket: bool,
    pub has_flash: bool,
    /// EXIF orientation, 1 to 8.
    pub orientation: u16,
    pub has_exif: bool,
    /// Whether the file is truncated in the picture data, as by removing the card too early; the header is complete.
    pub is_truncated: bool,
}

impl Shot {
    /// Returns the exact exposure time in seconds.
    pub fn time_s(&self) -> f64 {
        self.ev.exp2() / 32.0
    }

    /// Returns the end of the exposure, in ms since the beginning of the first day of the card.
    pub fn end_ms(&self) -> u64 {
        self.begin_ms + (1000.0 * self.time_s()).ceil() as u64
    }
}

/// A card that is being filled. Settings apply to the following shots.
#[derive(Clone, Debug)]
pub struct Card {
    pub camera: Camera,
    /// Width of the pictures in pixels before orientation, 64 to 1200; the height is two thirds of it.
    pub width: u32,
    /// Folder of the next shots, relative to the folder of the card, such as `DCIM/100TEST`; empty at first.
    pub folder: PathBuf,
    /// Number in the name of the next file.
    pub number: u32,
    /// The view of the next bracket.
    pub view: u64,
    /// Earliest start of the next exposure, in ms since the beginning of the first day of the card.
    pub clock_ms: u64,
    /// Pause from the end of a bracket to the start of the next one, in ms.
    pub pause_ms: u64,
    pub orientation: u16,
    /// Whether brackets are taken by automatic bracketing and recorded as such.
    pub is_auto_bracket: bool,
    pub has_exif: bool,
    pub shots: Vec<Shot>,
}

impl Card {
    /// Creates an empty card: pictures of `width` pixels, from `IMG_0001.JPG` on, at 17:42.
    pub fn new(width: u32) -> Self {
        assert!((64..=1200).contains(&width), "a card's pictures are 64 to 1200 px wide, not {width}");
        Card {
            camera: Camera::default(),
            width,
            folder: PathBuf::new(),
            number: 1,
            view: 0,
            clock_ms: (17 * 60 + 42) * 60_000,
            pause_ms: 8_000,
            orientation: 1,
            is_auto_bracket: true,
            has_exif: true,
            shots: Vec::new(),
        }
    }

    /// Adds a bracket of these exposures, in the order in which they are taken.
    pub fn bracket(&mut self, evs: &[f64]) -> &mut Self {
        let base = evs.first().copied().unwrap_or_default();
        for ev in evs {
            let bias = if self.is_auto_bracket { ev - base } else { 0.0 };
            self.shot(*ev, bias, self.is_auto_bracket);
        }
        self.view += 1;
        self.pause(self.pause_ms)
    }

    /// Adds `brackets` brackets of `frames` frames `step` EV apart, in the order of most cameras: the metered one,
    /// darker, brighter, ...
    pub fn brackets(&mut self, brackets: usize, frames: usize, step: f64) -> &mut Self {
        // An even number of frames has one more on the brighter side.
        let side = |k: usize| if k % 2 == 1 { -(k.div_ceil(2) as f64) } else { (k / 2) as f64 };
        let signs = if frames.is_multiple_of(2) { -1.0 } else { 1.0 };
        let evs: Vec<f64> = (0..frames).map(|k| signs * side(k) * step).collect();
        for _ in 0..brackets {
            self.bracket(&evs);
        }
        self
    }

    /// Adds a single photograph.
    pub fn single(&mut self, ev: f64) -> &mut Self {
        self.shot(ev, 0.0, false);
        self.view += 1;
        self.pause(self.pause_ms)
    }

    /// Adds a pause.
    pub fn pause(&mut self, ms: u64) -> &mut Self {
        self.clock_ms += ms;
        self
    }

    /// Returns the last shot, to be changed.
    pub fn last(&mut self) -> &mut Shot {
        self.shots.last_mut().expect("a shot")
    }

    fn shot(&mut self, ev: f64, bias_ev: f64, is_auto_bracket: bool) {
        assert!(ev >= WINDOW_EV[0], "{ev} EV: nothing darker than {} EV is there", WINDOW_EV[0]);
        let shot = Shot {
            name: self.folder.join(format!("IMG_{:04}.JPG", self.number)),
            camera: self.camera.clone(),
            view: self.view,
            ev,
            bias_ev,
            begin_ms: self.clock_ms,
            is_auto_bracket,
            has_flash: false,
            orientation: self.orientation,
            has_exif: self.has_exif,
            is_truncated: false,
        };
        self.number += 1;
        self.clock_ms = shot.end_ms() + self.camera.between_ms;
        self.shots.push(shot);
    }

    /// Returns the paths of the shots, bracket by bracket, as [`Card::write`] writes them into `folder`.
    pub fn paths(&self, folder: &Path) -> Vec<Vec<PathBuf>> {
        let same = |a: &Shot, b: &Shot| a.view == b.view && a.camera == b.camera;
        self.shots.chunk_by(same).map(|group| group.iter().map(|s| folder.join(&s.name)).collect()).collect()
    }

    /// Writes all shots into `folder`, with the dates when they were taken. Returns their paths, bracket by bracket.
    pub fn write(&self, folder: &Path) -> Vec<Vec<PathBuf>> {
        self.shots.par_iter().for_each(|shot| {
            let path = folder.join(&shot.name);
            fs::create_dir_all(path.parent().expect("a folder")).expect("the card's folder");
            fs::write(&path, jpeg(shot, self.width)).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            let taken = UNIX_EPOCH + Duration::from_secs(DAY) + Duration::from_millis(shot.end_ms());
            File::options().append(true).open(&path).and_then(|f| f.set_modified(taken)).expect("a file's date");
        });
        self.paths(folder)
    }
}

/// Returns the photographs of `testdata/window`, darkest first.
fn window() -> &'static [RgbImage] {
    static FRAMES: OnceLock<Vec<RgbImage>> = OnceLock::new();
    FRAMES.get_or_init(|| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/window");
        let open = |i: usize| image::open(folder.join(format!("window_{i}.jpg"))).expect("testdata/window").to_rgb8();
        (1..=WINDOW_EV.len()).into_par_iter().map(open).collect()
    })
}

/// Returns a number in 0..1 that depends only on `view` and `what` (splitmix64).
fn chance(view: u64, what: u64) -> f64 {
    let mut z = (view * 16 + what + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
}

/// Returns the code value that a pixel has after `ev` more stops of exposure, if its code value was `value`. The camera
/// is that of `testdata/window` (`tests/library/testdata/window/camera.rs`).
fn pushed(value: u8, ev: f64) -> u8 {
    let (power, knee) = (0.8, 0.45);
    let y = f64::from(value) / 255.0;
    let exposure = (y * knee / (1.0 + knee - y)).powf(1.0 / power) * ev.exp2();
    let p = exposure.min(1.0).powf(power);
    (255.0 * (1.0 + knee) * p / (p + knee)).round() as u8
}

/// Returns the picture of the shot.
fn picture(shot: &Shot, width: u32) -> RgbImage {
    let darker = WINDOW_EV.iter().rposition(|ev| *ev <= shot.ev).expect("not darker than the darkest");
    let whole = &window()[darker];
    let least = (f64::from(width) / f64::from(whole.width())).max(LEAST_PART);
    let part = least + (1.0 - least) * chance(shot.view, 0);
    let [w, h] = [whole.width(), whole.height()].map(|side| (f64::from(side) * part).floor() as u32);
    let at = |room: u32, what: u64| (f64::from(room) * chance(shot.view, what)) as u32;
    let crop = imageops::crop_imm(whole, at(whole.width() - w, 1), at(whole.height() - h, 2), w, h).to_image();
    let mut small = imageops::resize(&crop, width, width * 2 / 3, FilterType::Triangle);
    if chance(shot.view, 3) < 0.5 {
        imageops::flip_horizontal_in_place(&mut small);
    }
    if chance(shot.view, 4) < 0.25 {
        imageops::flip_vertical_in_place(&mut small);
    }
    let push = shot.ev - WINDOW_EV[darker];
    if push > 0.0 {
        let table: Vec<u8> = (0..=255).map(|v| pushed(v, push)).collect();
        small.pixels_mut().for_each(|p| *p = Rgb(p.0.map(|v| table[usize::from(v)])));
    }
    small
}

fn encoded(picture: &RgbImage, quality: u8) -> Vec<u8> {
    let mut plain = Vec::new();
    JpegEncoder::new_with_quality(&mut plain, quality).encode_image(picture).expect("a JPEG");
    plain
}

/// Returns the JPEG file of the shot.
pub fn jpeg(shot: &Shot, width: u32) -> Vec<u8> {
    let picture = picture(shot, width);
    let mut file = encoded(&picture, 92);
    if shot.has_exif {
        let thumbnail = encoded(&imageops::resize(&picture, 160, 106, FilterType::Triangle), 75);
        let mut whole = Jpeg::from_bytes(Bytes::from(file)).expect("our own JPEG");
        whole.set_exif(Some(exif_block(shot, &picture, &thumbnail).into()));
        file = whole.encoder().bytes().to_vec();
    }
    if shot.is_truncated {
        // The EXIF is at the start and less than half of the file, so only picture data are lost.
        file.truncate(file.len() - file.len() / 4);
    }
    file
}

/// Returns the value of `ExposureTime`: as recorded by cameras if the exposure is a whole stop; otherwise in
/// microseconds.
fn printed_time(shot: &Shot) -> Rational {
    let place = PRINTED_ZERO + shot.ev.round() as i32;
    match usize::try_from(place).ok().and_then(|k| PRINTED.get(k)) {
        Some((num, denom)) if shot.ev.fract() == 0.0 => Rational { num: *num, denom: *denom },
        _ => Rational { num: (1e6 * shot.time_s()).round() as u32, denom: 1_000_000 },
    }
}

/// Returns the EXIF fields of a shot.
pub fn exif_fields(shot: &Shot, width: u32, height: u32) -> Vec<Field> {
    let field = |tag, value| Field { tag, ifd_num: In::PRIMARY, value };
    let text = |s: &str| Value::Ascii(vec![s.as_bytes().to_vec()]);
    let tenths = |x: f64| Value::Rational(vec![Rational { num: (10.0 * x).round() as u32, denom: 10 }]);
    let camera = &shot.camera;
    let s = shot.begin_ms / 1000;
    let day = 19 + s / 86_400;
    assert!(day <= 30, "a card is full after eleven days");
    let taken = text(&format!("2026:09:{day} {:02}:{:02}:{:02}", s / 3600 % 24, s / 60 % 60, s % 60));
    let mut fields = vec![
        field(Tag::Make, text(&camera.make)),
        field(Tag::Model, text(&camera.model)),
        field(Tag::Orientation, Value::Short(vec![shot.orientation])),
        field(Tag::DateTime, taken.clone()),
        field(Tag::ExposureTime, Value::Rational(vec![printed_time(shot)])),
        field(Tag::FNumber, tenths(camera.f_number)),
        field(Tag::ExposureProgram, Value::Short(vec![3])),
        field(Tag::PhotographicSensitivity, Value::Short(vec![camera.iso])),
        field(Tag::DateTimeOriginal, taken.clone()),
        field(Tag::DateTimeDigitized, taken),
        field(
            Tag::ExposureBiasValue,
            Value::SRational(vec![SRational { num: (3.0 * shot.bias_ev).round() as i32, denom: 3 }]),
        ),
        field(Tag::MeteringMode, Value::Short(vec![5])),
        field(Tag::Flash, Value::Short(vec![if shot.has_flash { 0x9 } else { 0x10 }])),
        field(Tag::FocalLength, tenths(f64::from(camera.focal_length_mm))),
        field(Tag::ColorSpace, Value::Short(vec![1])),
        field(Tag::PixelXDimension, Value::Long(vec![width])),
        field(Tag::PixelYDimension, Value::Long(vec![height])),
        field(Tag::ExposureMode, Value::Short(vec![if shot.is_auto_bracket { 2 } else { 0 }])),
        field(Tag::WhiteBalance, Value::Short(vec![1])),
        field(Tag::BodySerialNumber, text(&camera.serial)),
        field(Tag::LensModel, text(&camera.lens)),
    ];
    if camera.has_sub_seconds {
        let hundredths = text(&format!("{:02}", shot.begin_ms % 1000 / 10));
        fields.push(field(Tag::SubSecTimeOriginal, hundredths.clone()));
        fields.push(field(Tag::SubSecTimeDigitized, hundredths));
    }
    fields
}

fn exif_block(shot: &Shot, picture: &RgbImage, thumbnail: &[u8]) -> Vec<u8> {
    let fields = exif_fields(shot, picture.width(), picture.height());
    let compression = Field { tag: Tag::Compression, ifd_num: In::THUMBNAIL, value: Value::Short(vec![6]) };
    let mut writer = Writer::new();
    fields.iter().for_each(|f| writer.push_field(f));
    writer.push_field(&compression);
    writer.set_jpeg(thumbnail, In::THUMBNAIL);
    let mut block = Cursor::new(Vec::new());
    writer.write(&mut block, true).expect("EXIF in memory");
    block.into_inner()
}
