//! The file format for an extension, and whether the format contains radiance or a picture.
//!
//! In: paths. Out: [`Output`]s. Cost: negligible.

use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// The output formats, by extension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// OpenEXR, `.exr`: radiance.
    Exr,
    /// The RGBE format of the program Radiance, `.hdr` or `.pic`: radiance.
    Hdr,
    /// TIFF with 32-bit floats or LogLuv, `.tif` or `.tiff`: radiance.
    Tiff,
    /// DNG, `.dng`: radiance for raw developers.
    Dng,
    /// PNG, `.png`: the display picture.
    Png,
    /// JPEG with a gain map, `.jpg` or `.jpeg`: the display picture, and the radiance for HDR displays.
    Jpeg,
    /// TIFF with integer code values: the display picture. Chosen for `.tif` and `.tiff` if a picture, not radiance, is
    /// requested.
    TiffPicture,
}

impl Format {
    /// The supported extensions, for error messages.
    pub const KNOWN: &str = ".exr, .hdr, .pic, .tif, .tiff, .dng, .png, .jpg, .jpeg";

    /// Returns the format for the extension of `path`, which may be in upper or lower case.
    ///
    /// # Errors
    /// [`Error::UnknownExtension`].
    pub fn of(path: &Path) -> Result<Format> {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        match extension.as_str() {
            "exr" => Ok(Format::Exr),
            "hdr" | "pic" => Ok(Format::Hdr),
            "tif" | "tiff" => Ok(Format::Tiff),
            "dng" => Ok(Format::Dng),
            "png" => Ok(Format::Png),
            "jpg" | "jpeg" => Ok(Format::Jpeg),
            _ => Err(Error::UnknownExtension { path: path.to_owned(), known: Format::KNOWN }),
        }
    }

    /// Returns the picture format for the extension of `path`.
    ///
    /// # Errors
    /// [`Error::UnknownExtension`]; [`Error::Option`] for a format that contains only radiance.
    pub fn of_picture(path: &Path) -> Result<Format> {
        const KNOWN: &str = ".png, .jpg, .jpeg, .tif, .tiff";
        match Format::of(path) {
            Ok(Format::Tiff) => Ok(Format::TiffPicture),
            Ok(format) if format.holds_radiance() => {
                let reason = format!(
                    "{} is a radiance format; use -o for it, or choose a picture format ({KNOWN})",
                    path.display()
                );
                Err(Error::Option { option: "--picture", reason })
            }
            Ok(format) => Ok(format),
            Err(_) => Err(Error::UnknownExtension { path: path.to_owned(), known: KNOWN }),
        }
    }

    /// Whether the format contains linear radiance; otherwise it contains the display picture.
    pub fn holds_radiance(self) -> bool {
        match self {
            Format::Exr | Format::Hdr | Format::Tiff | Format::Dng => true,
            Format::Png | Format::Jpeg | Format::TiffPicture => false,
        }
    }
}

/// A result file and its format.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Output {
    /// The file.
    pub path: PathBuf,
    /// Its format.
    pub format: Format,
}

impl Output {
    /// Returns the outputs for the `paths` of `-o`, each with the format of its extension.
    ///
    /// # Errors
    /// [`Error::UnknownExtension`].
    pub fn results(paths: &[PathBuf]) -> Result<Vec<Output>> {
        paths.iter().map(|path| Ok(Output { path: path.clone(), format: Format::of(path)? })).collect()
    }

    /// Returns the outputs for the `paths` of `--picture`, which always contain the display picture.
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
        for (name, said) in [("b.exr", "use -o"), ("b.hdr", ".tif"), ("b.bmp", ".png")] {
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
            assert!(error.is_usage() && error.to_string().contains(".tiff, .dng, .png, .jpg"), "{error}");
        }
    }
}
