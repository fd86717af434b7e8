//! Writing: every output goes to a temporary file in its folder and gets its name when all of a run are complete.
//!
//! In: pixels by rows, in order, in portions of any size, and the [`Metadata`] that headers are made of. Out: files. A name that
//! exists is a file that is whole; a failed run leaves nothing behind. Encoding goes by bands of 64 rows in parallel and is written
//! in order: the same bytes on any number of threads. Cost: see each format; the renaming waits for the disk (fsync).

pub mod aligned;
mod bands;
mod deflate;
pub mod display;
mod exif;
pub mod exr;
pub mod files;
pub mod gain_map;
pub mod hdr;
mod ifd;
pub mod jpeg;
pub mod logluv;
pub mod mask;
pub mod picture;
mod piz;
pub(crate) mod staging;
pub mod tiff;
pub mod ultra_hdr;

use crate::bracket::colour::{Primaries, Profile};
use crate::bracket::{Capture, Frame};
use crate::error::{Error, Result};
use crate::merge::calibration::Factor;
use crate::plane::Plane;
use std::path::{Path, PathBuf};

use bands::Bands;
pub use files::{Codes, Files, Settled, is_among, write};
use staging::clamped;
pub use staging::{
    NewFolder, Pending, Target, Whole, Written, abandon, bytes, check_targets, commit, place, sweep, text, whole,
};

/// The formats written, told by the extension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// OpenEXR, `.exr`: radiance.
    Exr,
    /// Radiance RGBE, `.hdr` or `.pic`: radiance.
    Hdr,
    /// TIFF with 32-bit floats or LogLuv, `.tif` or `.tiff`: radiance.
    Tiff,
    /// PNG, `.png`: the display picture.
    Png,
    /// JPEG with a gain map, `.jpg` or `.jpeg`: the display picture, and the radiance for HDR displays.
    Jpeg,
    /// TIFF with codes, `.tif` or `.tiff` where a picture is asked for: the display picture.
    TiffPicture,
}

impl Format {
    /// The extensions that are known, for messages.
    pub const KNOWN: &str = ".exr, .hdr, .pic, .tif, .tiff, .png, .jpg, .jpeg";

    /// The format that `path` asks for by its extension, in any case.
    ///
    /// # Errors
    /// [`Error::UnknownExtension`].
    pub fn of(path: &Path) -> Result<Format> {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        match extension.as_str() {
            "exr" => Ok(Format::Exr),
            "hdr" | "pic" => Ok(Format::Hdr),
            "tif" | "tiff" => Ok(Format::Tiff),
            "png" => Ok(Format::Png),
            "jpg" | "jpeg" => Ok(Format::Jpeg),
            _ => Err(Error::UnknownExtension { path: path.to_owned(), known: Format::KNOWN }),
        }
    }

    /// The format that `path` asks for by its extension where it is to be the display picture.
    ///
    /// # Errors
    /// [`Error::UnknownExtension`]; [`Error::Option`] for a format that holds radiance alone.
    pub fn of_picture(path: &Path) -> Result<Format> {
        const KNOWN: &str = ".png, .jpg, .jpeg, .tif, .tiff";
        match Format::of(path) {
            Ok(Format::Tiff) => Ok(Format::TiffPicture),
            Ok(format) if format.holds_radiance() => {
                let reason = format!("{} holds radiance; name it by -o, or a picture ({KNOWN})", path.display());
                Err(Error::Option { option: "--picture", reason })
            }
            Ok(format) => Ok(format),
            Err(_) => Err(Error::UnknownExtension { path: path.to_owned(), known: KNOWN }),
        }
    }

    /// Whether it holds linear radiance; if not, the display picture.
    pub fn holds_radiance(self) -> bool {
        match self {
            Format::Exr | Format::Hdr | Format::Tiff => true,
            Format::Png | Format::Jpeg | Format::TiffPicture => false,
        }
    }
}

/// A result: the file, and what it holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Output {
    /// The file.
    pub path: PathBuf,
    /// Its format.
    pub format: Format,
}

impl Output {
    /// What `-o` names: `paths` by their extensions.
    ///
    /// # Errors
    /// [`Error::UnknownExtension`].
    pub fn results(paths: &[PathBuf]) -> Result<Vec<Output>> {
        paths.iter().map(|path| Ok(Output { path: path.clone(), format: Format::of(path)? })).collect()
    }

    /// What `--picture` names: the display picture, whatever the extension.
    ///
    /// # Errors
    /// Those of [`Format::of_picture`].
    pub fn pictures(paths: &[PathBuf]) -> Result<Vec<Output>> {
        paths.iter().map(|path| Ok(Output { path: path.clone(), format: Format::of_picture(path)? })).collect()
    }
}

/// What headers are made of. Nothing in it depends on the clock.
#[derive(Debug, Clone, PartialEq)]
pub struct Metadata {
    /// The program and its version: `hdralign 0.1.0`.
    pub software: String,
    /// Camera make and model, and the capture date of the reference.
    pub capture: Capture,
    /// Shutter time of the reference in seconds.
    pub time_s: Option<f64>,
    /// The f-number of the reference.
    pub f_number: Option<f64>,
    /// The sensitivity of the reference.
    pub iso: Option<f64>,
    /// What red, green, blue and white of the pixels are.
    pub primaries: Primaries,
    /// The factor by which the pixels given were multiplied: a pixel divided by it is radiance. 1 where they are radiance as merged.
    pub exposure_scale: Factor,
    /// The luminance of radiance (1, 1, 1), before [`exposure_scale`](Self::exposure_scale), in cd/m2, where it is calibrated.
    pub cd_m2_per_unit: Option<Factor>,
    /// The ICC profile of display-encoded pixels (8- and 16-bit TIFF, PNG); none is taken for sRGB. Radiance formats record primaries.
    pub profile: Option<Profile>,
    /// Further lines for people.
    pub comments: Vec<String>,
}

impl Default for Metadata {
    fn default() -> Self {
        Metadata {
            software: concat!("hdralign ", env!("CARGO_PKG_VERSION")).into(),
            capture: Capture::default(),
            time_s: None,
            f_number: None,
            iso: None,
            primaries: Primaries::SRGB,
            exposure_scale: Factor::ONE,
            cd_m2_per_unit: None,
            profile: None,
            comments: Vec::new(),
        }
    }
}

impl Metadata {
    /// What the reference frame tells of itself; everything else as by default.
    pub fn of(reference: &Frame) -> Self {
        Metadata {
            capture: reference.capture.clone(),
            time_s: reference.exposure.time_s,
            f_number: reference.exposure.f_number,
            iso: reference.exposure.iso,
            profile: reference.profile.clone(),
            ..Metadata::default()
        }
    }

    /// The camera on one line; `None` when it is unknown.
    fn camera(&self) -> Option<String> {
        self.capture.camera().map(|name| one_line(&name)).filter(|name| !name.is_empty())
    }

    /// The luminance of a stored (1, 1, 1) in cd/m2, where it is known.
    fn white_luminance(&self) -> Option<f64> {
        Some(self.cd_m2_per_unit?.over(self.exposure_scale)?.get())
    }
}

/// `text` as printable ASCII on one line: a camera's name must not be able to add a line to a header, and readers expect ASCII.
fn one_line(text: &str) -> String {
    let ascii: String = text
        .trim_matches(['\0', ' '])
        .chars()
        .map(|c| match c {
            ' '..='~' => c,
            _ if c.is_whitespace() || c.is_control() => ' ',
            _ => '?',
        })
        .collect();
    ascii.trim().into()
}

/// What every output format implements: rows in, in order, then the end. `P` is the pixel.
///
/// Bands may arrive as they are merged while several writers run; a writer encodes what it is given in parallel before it returns.
/// A writer that is dropped unfinished leaves nothing behind.
pub trait RowWriter<P>: Send {
    /// Takes the next rows, whole and without gaps: any number of them, `rows.len()` a multiple of the width.
    ///
    /// # Errors
    /// [`Error::Write`] when the encoder or the disk fails.
    ///
    /// # Panics
    /// When a row is not whole or there are more than the picture has: a fault of the caller, never of a file.
    fn push(&mut self, rows: &[P]) -> Result<()>;

    /// Ends the file after its last row.
    ///
    /// # Errors
    /// [`Error::Write`] when the disk fails or rows are missing.
    fn finish(self: Box<Self>) -> Result<Written>;
}

/// How results are written.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Whether files that exist are replaced. No by default.
    pub overwrite: bool,
    /// How OpenEXR is encoded.
    pub exr: exr::Options,
    /// What the pixels of `.hdr` are.
    pub hdr: hdr::Encoding,
    /// What the pixels of a radiance `.tif` are.
    pub tiff: tiff::Encoding,
    /// How `.jpg` is encoded.
    pub jpeg: ultra_hdr::Options,
    /// How pictures are made.
    pub picture: picture::Options,
}

impl Options {
    /// Whether `outputs` can be written like this.
    ///
    /// # Errors
    /// [`Error::Option`] for the option that is out of its range, that a format cannot follow, or that is for pictures where there is none.
    pub fn check(&self, outputs: &[Output]) -> Result<()> {
        self.jpeg.validate()?;
        self.picture.check(outputs, self.jpeg.gain_map)
    }
}

/// All of `plane` through `writer`.
///
/// # Errors
/// Those of the writer.
pub fn push_all<P>(mut writer: Box<dyn RowWriter<P> + '_>, plane: &Plane<P>) -> Result<Written> {
    writer.push(plane.as_slice())?;
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn picture_has_the_format_of_its_extension_unless_that_holds_radiance_alone() {
        let of = |name: &str| Format::of_picture(Path::new(name));
        assert_eq!(of("b.TIFF").unwrap(), Format::TiffPicture);
        assert_eq!([of("b.png").unwrap(), of("b.JPG").unwrap()], [Format::Png, Format::Jpeg]);
        for (name, said) in [("b.exr", "name it by -o"), ("b.hdr", ".tif"), ("b.bmp", ".png")] {
            let error = of(name).unwrap_err();
            assert!(error.is_usage() && error.to_string().contains(said), "{error}");
        }
    }

    #[test]
    fn the_extension_decides_in_any_case() {
        let of = |name: &str| Format::of(Path::new(name));
        assert_eq!(of("a/b.EXR").unwrap(), Format::Exr);
        assert_eq!(of("b.x.Pic").unwrap(), Format::Hdr);
        assert_eq!(of("b.TIFF").unwrap(), Format::Tiff);
        assert_eq!(of("b.png").unwrap(), Format::Png);
        assert_eq!(of("b.JPEG").unwrap(), Format::Jpeg);
        for unknown in ["b.gif", "b", ".png", "png", "b."] {
            let error = of(unknown).unwrap_err();
            assert!(error.is_usage() && error.to_string().contains(".tiff, .png, .jpg"), "{error}");
        }
    }

    #[test]
    fn the_camera_is_one_line_of_ascii() {
        let camera = |make: &str, model: &str| {
            let capture = Capture { make: Some(make.into()), model: Some(model.into()), ..Capture::default() };
            Metadata { capture, ..Metadata::default() }.camera()
        };
        assert_eq!(camera("FUJI\nEXPOSURE=9", "X\u{e9}").unwrap(), "FUJI EXPOSURE=9 X?");
        assert_eq!(camera("\n", "\t"), None);
    }
}
