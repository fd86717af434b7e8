//! Formats: which one an extension asks for, and whether it holds radiance or a picture.
//!
//! In: paths. Out: [`Output`]s. Cost: none.

use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// The formats that are written, chosen by the extension.
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
}
