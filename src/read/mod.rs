//! Reading of radiance maps, written by hdralign or other programs.
//!
//! In: an `.exr`, `.hdr` or floating-point `.tif`, recognised by content, not by name. Out: a [`RadianceMap`] as
//! stored, and its [`Metadata`]; [`read_within`] also lists what else the file contains. Cost: see each format.
//!
//! [`read`] returns values as stored, except for the scale in a header: the values of `.hdr` are divided by its
//! EXPOSURE, and those of LogLuv are multiplied by its StoNits. Other programs write 0, negative numbers, infinities
//! and NaN; [`repair()`] replaces them by values that the later stages accept, and counts them.

pub(crate) mod exr;
pub(crate) mod hdr;
mod orientation;
mod repair;
pub(crate) mod tiff;

use crate::bracket::colour::Primaries;
use crate::error::{Error, Result, Warning};
use crate::intake;
use crate::limits::Limits;
use crate::merge::RadianceMap;
use crate::merge::radiance::calibration::Factor;
use crate::plane::Plane;
use crate::write::Metadata;
use rayon::prelude::*;
use std::io::Read;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

#[doc(hidden)]
pub use repair::{Repaired, repair};

/// Reads the radiance map in the file `path`, and its metadata. Values may be any floats.
///
/// # Errors
/// Those of [`read_within`], with the default limits.
pub fn read(path: &Path) -> Result<(RadianceMap, Metadata)> {
    read_within(path, &Limits::default()).map(|Contents { map, metadata, .. }| (map, metadata))
}

/// The content of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Contents {
    /// The radiance.
    pub map: RadianceMap,
    /// The metadata in the headers of the file.
    pub metadata: Metadata,
    /// Names of what the file contains in addition and is not read: `alpha`, `channel Z`, `layer left`.
    pub unread: Vec<String>,
    /// Faults in the headers and how they were handled, as text for users.
    pub notes: Vec<String>,
}

impl Contents {
    /// Combines the radiance `pixels` and the `metadata` of the headers, including the primaries. Primaries that span
    /// no colour space are replaced, with a note.
    fn new(pixels: Plane<[f32; 3]>, mut metadata: Metadata) -> Self {
        let mut notes = Vec::new();
        if metadata.primaries.to_xyz().is_none() {
            metadata.primaries = Primaries::SRGB;
            notes.push("its chromaticities define no colour space; BT.709 is assumed".to_owned());
        }
        let map = RadianceMap { pixels, primaries: metadata.primaries };
        Contents { map, metadata, unread: Vec::new(), notes }
    }

    /// Sets the unit of radiance to `luminance` in cd/m2, from the header `name`; if it is not a valid [`Factor`],
    /// radiance stays relative, with a note.
    fn set_unit(&mut self, name: &str, luminance: Option<f64>) {
        self.metadata.cd_m2_per_unit = luminance.and_then(Factor::new);
        if let (Some(luminance), None) = (luminance, self.metadata.cd_m2_per_unit) {
            self.notes.push(format!(
                "its radiance is treated as relative, because its {name} is {luminance}, which is not between 1e-20 and 1e20"
            ));
        }
    }

    /// Returns the notes as warnings about the file `path`.
    pub fn warnings(&self, path: &Path) -> Vec<Warning> {
        let warning = |detail: &String| Warning::Metadata { path: path.to_owned(), detail: detail.clone() };
        self.notes.iter().map(warning).collect()
    }
}

/// Reads the content of the file `path`, within `limits`.
///
/// # Errors
/// [`Error::Read`], [`Error::Changed`]; [`Error::NotRadiance`] if the content is none of the formats;
/// [`Error::Decode`] if it is damaged, truncated, of an unsupported kind, or exceeds the limits.
pub fn read_within(path: &Path, limits: &Limits) -> Result<Contents> {
    let kind = Kind::of(path)?;
    let bytes = intake::whole(path, limits.most_bytes())?;
    // The decoders are crates. A panic in one of them on a damaged file is reported for this file, and does not end
    // the run.
    let parsed = catch_unwind(AssertUnwindSafe(|| match kind {
        Kind::Exr => exr::parse(&bytes, limits),
        Kind::Hdr => hdr::parse(&bytes, limits),
        Kind::Tiff => tiff::parse(bytes, limits),
    }));
    let parsed = parsed
        .unwrap_or_else(|_| Err("it is damaged in a way that the decoder does not recognise; copy it again".into()));
    let mut contents = parsed.map_err(|reason| Error::Decode { path: path.to_owned(), format: kind.name(), reason })?;
    let scale = std::mem::replace(&mut contents.metadata.exposure_scale, Factor::ONE);
    if scale != Factor::ONE {
        let factor = (1.0 / scale.get()) as f32;
        contents.map.pixels.as_mut_slice().par_iter_mut().for_each(|p| *p = p.map(|v| v * factor));
    }
    Ok(contents)
}

/// Checks that the file `path` begins with the first bytes of a radiance map.
///
/// # Errors
/// [`Error::Read`], [`Error::NotRadiance`].
pub fn check(path: &Path) -> Result<()> {
    Kind::of(path).map(|_| ())
}

/// Whether the file `path` is a radiance map, by its content; a TIFF, which is read within `limits`, is a radiance map
/// if it has floats or LogLuv.
///
/// # Errors
/// [`Error::Read`]; [`Error::Decode`] for a TIFF with a damaged directory.
pub fn holds_radiance(path: &Path, limits: &Limits) -> Result<bool> {
    match Kind::of(path) {
        Ok(Kind::Exr | Kind::Hdr) => Ok(true),
        Ok(Kind::Tiff) => tiff::holds_radiance(path, limits),
        Err(Error::NotRadiance { .. }) => Ok(false),
        Err(error) => Err(error),
    }
}

/// The formats that are supported.
enum Kind {
    Exr,
    Hdr,
    Tiff,
}

impl Kind {
    /// Returns the name for messages.
    fn name(&self) -> &'static str {
        match self {
            Kind::Exr => "OpenEXR",
            Kind::Hdr => "Radiance HDR",
            Kind::Tiff => "TIFF",
        }
    }

    /// Recognises the format by the first bytes.
    fn of(path: &Path) -> Result<Self> {
        let unreadable = |source| Error::Read { path: path.to_owned(), source };
        let mut start = Vec::new();
        intake::open_regular(path)?.take(16).read_to_end(&mut start).map_err(unreadable)?;
        let found = match start.as_slice() {
            [0x76, 0x2f, 0x31, 0x01, ..] => return Ok(Kind::Exr),
            [b'#', b'?', ..] => return Ok(Kind::Hdr),
            [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => return Ok(Kind::Tiff),
            [] => "an empty file",
            [0xff, 0xd8, 0xff, ..] => "a JPEG picture",
            [0x89, b'P', b'N', b'G', ..] => "a PNG picture",
            [b'P', b'F' | b'f', b'\n', ..] => "a PFM picture",
            [_, _, _, _, b'f', b't', b'y', b'p', ..] => "a HEIF, AVIF or MP4 file",
            _ => "of an unknown format",
        };
        Err(Error::NotRadiance { path: path.to_owned(), found })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn format_is_detected_by_content_and_pictures_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.exr");
        for (bytes, named) in [
            (&b"\xff\xd8\xff\xe0 and so on"[..], "JPEG"),
            (b"\x89PNG\r\n\x1a\n", "PNG"),
            (b"", "empty"),
            (b"PF\n2 2\n-1.0\n", "PFM"),
            (b"whatever it is", "unknown"),
        ] {
            std::fs::write(&path, bytes).unwrap();
            let error = read(&path).unwrap_err();
            assert!(matches!(error, Error::NotRadiance { .. }) && error.to_string().contains(named), "{error}");
        }
        for cut in [&b"\x76\x2f\x31\x01\x02\0"[..], b"#?RADIANCE\n", b"II\x2a\0\x08\0\0\0", b"MM\0\x2a\0\0\0\x08"] {
            std::fs::write(&path, cut).unwrap();
            let error = read(&path).unwrap_err();
            assert!(matches!(error, Error::Decode { .. } | Error::Read { .. }), "{error}");
        }
        assert!(matches!(read(dir.path()), Err(Error::Read { .. })));
        std::fs::write(&path, b"\x89PNG\r\n\x1a\n").unwrap();
        assert!(!holds_radiance(&path, &Limits::default()).unwrap());
        std::fs::write(&path, b"#?RADIANCE\n").unwrap();
        assert!(holds_radiance(&path, &Limits::default()).unwrap());
        assert!(matches!(read(&dir.path().join("gone.exr")), Err(Error::Read { .. })));
    }
}
