//! Common parts of the tests: the bracket of `testdata/window`, smaller copies of it, and runs of the program.

#![allow(dead_code, reason = "each test program uses a part of it")]

pub mod card;

use exif::experimental::Writer;
use exif::{Field, In, Rational, Tag, Value};
use image::codecs::jpeg::JpegEncoder;
use image::{Rgb, RgbImage};
use img_parts::jpeg::Jpeg;
use img_parts::{Bytes, ImageEXIF};
use std::ffi::OsStr;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use tempfile::TempDir;

/// Number of frames of the bracket.
pub const FRAMES: usize = 5;

/// Returns the path of frame `i` of the bracket, from 1.
pub fn window(i: usize) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("testdata/window/window_{i}.jpg"))
}

/// Returns the means of blocks of `side` x `side` pixels, rounded half up: integers, which are the same on every
/// machine.
pub fn shrink(picture: &RgbImage, side: u32) -> RgbImage {
    RgbImage::from_fn(picture.width() / side, picture.height() / side, |x, y| {
        let mean = |c: usize| {
            let pixels = (0..side * side).map(|k| picture.get_pixel(x * side + k % side, y * side + k / side)[c]);
            ((pixels.map(u32::from).sum::<u32>() + side * side / 2) / (side * side)) as u8
        };
        Rgb([mean(0), mean(1), mean(2)])
    })
}

/// Returns frame `i` at 300 x 200 pixels.
pub fn small(i: usize) -> RgbImage {
    shrink(&image::open(window(i)).expect("a frame of testdata/window").to_rgb8(), 4)
}

/// Returns `picture` as a JPEG with the EXIF of frame `exif_of`, or without EXIF.
pub fn jpeg(picture: &RgbImage, exif_of: Option<usize>) -> Vec<u8> {
    let mut plain = Vec::new();
    JpegEncoder::new_with_quality(&mut plain, 95).encode_image(picture).expect("a JPEG");
    let Some(i) = exif_of else { return plain };
    let read = |bytes: Vec<u8>| Jpeg::from_bytes(Bytes::from(bytes)).expect("a JPEG");
    let exif = read(fs::read(window(i)).expect("a frame")).exif();
    assert!(exif.is_some(), "frame {i} has lost its EXIF");
    let mut file = read(plain);
    file.set_exif(exif);
    file.encoder().bytes().to_vec()
}

/// Returns `picture` as a JPEG whose EXIF has these fields and no others.
pub fn jpeg_with(picture: &RgbImage, fields: &[(Tag, Value)]) -> Vec<u8> {
    let field = |(tag, value): &(Tag, Value)| Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() };
    let fields: Vec<Field> = fields.iter().map(field).collect();
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut exif = Cursor::new(Vec::new());
    writer.write(&mut exif, false).expect("EXIF");
    let mut file = Jpeg::from_bytes(Bytes::from(jpeg(picture, None))).expect("a JPEG");
    file.set_exif(Some(exif.into_inner().into()));
    file.encoder().bytes().to_vec()
}

/// Returns an EXIF rational.
pub fn ratio(num: u32, denom: u32) -> Value {
    Value::Rational(vec![Rational { num, denom }])
}

/// Returns the small frames as JPEGs with EXIF; they are made once per test program.
fn small_jpegs() -> &'static [Vec<u8>] {
    static FILES: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    FILES.get_or_init(|| (1..=FRAMES).map(|i| jpeg(&small(i), Some(i))).collect())
}

/// Returns the path of the program under test: that of this build, or that in `HDRALIGN_BIN`.
pub fn program() -> PathBuf {
    std::env::var_os("HDRALIGN_BIN").map_or_else(|| env!("CARGO_BIN_EXE_hdralign").into(), PathBuf::from)
}

/// Returns the prefix of a command line that runs the command as on a system without a feature: `anonymous` files, hard
/// `link`s, or renaming with `noreplace`. `None` if this machine does not allow it.
pub fn without(lacks: &str) -> Option<[String; 3]> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/without.py");
    let words = ["python3", script, lacks].map(str::to_owned);
    let tried = Command::new(&words[0]).args(&words[1..]).arg("true").stderr(Stdio::null()).status();
    tried.is_ok_and(|status| status.success()).then_some(words)
}

/// A temporary folder for one test.
pub struct Folder(TempDir);

impl Folder {
    pub fn empty() -> Self {
        Folder(tempfile::tempdir().expect("a temporary folder"))
    }

    /// Creates a folder with the small bracket, `w1.jpg` to `w5.jpg`.
    pub fn with_bracket() -> Self {
        let folder = Folder::empty();
        for i in 1..=FRAMES {
            folder.put(&format!("w{i}.jpg"), small_jpeg(i));
        }
        folder
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }

    pub fn at(&self, name: impl AsRef<Path>) -> PathBuf {
        self.path().join(name)
    }

    pub fn put(&self, name: &str, bytes: &[u8]) {
        fs::write(self.at(name), bytes).expect("a file in the temporary folder");
    }

    pub fn bytes(&self, name: &str) -> Vec<u8> {
        fs::read(self.at(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// Returns every name in the folder, including hidden ones, with its length in bytes.
    pub fn listing(&self) -> Vec<(String, u64)> {
        let entry = |e: std::io::Result<fs::DirEntry>| {
            let e = e.expect("an entry");
            (e.file_name().to_string_lossy().into_owned(), e.metadata().expect("its size").len())
        };
        let mut names: Vec<(String, u64)> = fs::read_dir(self.path()).expect("the folder").map(entry).collect();
        names.sort();
        names
    }

    /// Runs the program in this folder.
    pub fn run<S: AsRef<OsStr>>(&self, arguments: impl IntoIterator<Item = S>) -> Run {
        let output = Command::new(program()).args(arguments).current_dir(self.path()).stdin(Stdio::null()).output();
        let output = output.expect("the program starts");
        Run {
            code: output.status.code().expect("an exit code"),
            stdout: String::from_utf8(output.stdout).expect("UTF-8 on stdout"),
            stderr: String::from_utf8(output.stderr).expect("UTF-8 on stderr"),
        }
    }

    /// Runs the program with `line`, split at spaces.
    pub fn line(&self, line: &str) -> Run {
        self.run(line.split_whitespace())
    }
}

/// Returns small frame `i` as a JPEG with EXIF.
pub fn small_jpeg(i: usize) -> &'static [u8] {
    &small_jpegs()[i - 1]
}

/// The result of a run of the program.
#[derive(Debug)]
pub struct Run {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Run {
    /// Returns the run; panics if it did not exit with 0.
    pub fn done(self) -> Self {
        assert_eq!(self.code, 0, "{}", self.stderr);
        self
    }
}
