//! One file of a bracket, read and decoded.
//!
//! In: a path. Out: a [`Picture`]: pixel values, brightness statistics, exposure tags, profile and capture data. Cost:
//! the decoder.

use crate::bracket::colour::{Found, Profile};
use crate::bracket::decode::{self, Decoded};
use crate::bracket::exposure::ExposureTags;
use crate::bracket::exposure::brightness::Brightness;
use crate::bracket::header::Header;
use crate::bracket::load::LoadOptions;
use crate::bracket::load::copies::Look;
use crate::bracket::metadata::capture;
use crate::bracket::window::Store;
use crate::bracket::{Capture, Raw, reference};
use crate::error::{Error, Result, Warning};
use crate::intake;
use crate::limits::Limits;
use crate::scratch::Scratch;
use exif::{Exif, In, Tag};
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// One decoded file and its metadata.
pub(super) struct Picture {
    pub path: PathBuf,
    pub width: usize,
    pub height: usize,
    pub store: Store,
    /// Memory in bytes needed to decode the file.
    pub decoding: u64,
    pub brightness: Brightness,
    pub well_exposed: u64,
    pub tags: ExposureTags,
    pub profile: Option<Profile>,
    /// What a camera raw file shows; none for other files.
    pub raw: Option<Raw>,
    pub capture: Capture,
    /// Why the file is excluded from the merge, if it is.
    pub excluded: Option<String>,
    pub warnings: Vec<Warning>,
}

impl Picture {
    /// Reads the file `path`. If `scratch` is given, the pixel values are moved to that scratch file.
    pub fn read(path: &Path, options: &LoadOptions, scratch: Option<&Arc<Scratch>>) -> Result<Self> {
        let limits = options.limits();
        let bytes = content(path, &limits)?;
        refuse_result(path, &bytes, &limits)?;
        let Decoded { width, height, samples, decoding, exif, icc, raw, mut notes, .. } =
            decode::decode(path, bytes, &limits)?;
        let tags = exif.as_ref().map(ExposureTags::read).unwrap_or_default();
        let capture = exif.as_ref().map(|exif| capture::read(exif, options.keep_gps)).unwrap_or_default();
        let profile = profile(icc, exif.as_ref(), &mut notes);
        let warnings = notes.into_iter().map(|detail| Warning::Metadata { path: path.into(), detail }).collect();
        // These are computed here because this function runs in parallel for several files.
        let (brightness, well_exposed) = (Brightness::of(&samples, width), reference::well_exposed(&samples, width));
        let mut store = Store::Held(samples);
        if let Some(scratch) = scratch {
            store.put_on(scratch)?;
        }
        Ok(Picture {
            path: path.into(),
            width,
            height,
            store,
            decoding,
            brightness,
            well_exposed,
            tags,
            profile,
            raw,
            capture,
            excluded: None,
            warnings,
        })
    }

    /// Width and height in pixels.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Returns the properties that the search for copies compares.
    pub fn look(&self) -> Look<'_> {
        let Picture { path, store, brightness, well_exposed, .. } = self;
        Look { path, size: self.size(), store, brightness, well_exposed: *well_exposed }
    }
}

/// Reads the bytes of the image file `path`, once, so that the header and the decoder see the same content.
pub(in crate::bracket) fn content(path: &Path, limits: &Limits) -> Result<Vec<u8>> {
    intake::whole_if(path, limits.most_bytes(), |begin| decode::check_format(path, begin))
}

/// Rejects results of hdralign: without this, a second `merge *.jpg` would merge the results of the first one. Damaged
/// files pass, because the decoder reports them.
fn refuse_result(path: &Path, bytes: &[u8], limits: &Limits) -> Result<()> {
    match Header::of(path, Cursor::new(bytes), limits) {
        Ok(header) if header.is_ours() => {
            let path = path.display();
            let reason = format!(
                "{path} is a result of hdralign, not a photograph; leave it out, or give the photographs it was made of"
            );
            Err(Error::Option { option: "IMAGES", reason })
        }
        _ => Ok(()),
    }
}

/// Returns the embedded colour profile of a file, or the one that its EXIF indicates.
pub(in crate::bracket) fn profile(
    icc: Option<Vec<u8>>,
    exif: Option<&Exif>,
    notes: &mut Vec<String>,
) -> Option<Profile> {
    let Some(icc) = icc else {
        // In DCF 2.0, the colour space "uncalibrated" with the interoperability index R03 means Adobe RGB.
        let exif = exif?;
        let uncalibrated = exif.get_field(Tag::ColorSpace, In::PRIMARY)?.value.get_uint(0) == Some(0xFFFF);
        let r03 = capture::ascii(exif, Tag::InteroperabilityIndex).as_deref() == Some("R03");
        return if uncalibrated && r03 { Profile::adobe_rgb() } else { None };
    };
    match Profile::parse(icc) {
        Found::Rgb(profile) => {
            if profile.primaries.is_none() {
                notes.push(format!(
                    "the primaries of its colour profile ({}) are unknown; sRGB is assumed",
                    profile.description
                ));
            }
            Some(profile)
        }
        Found::Other(kind) => {
            notes.push(format!("its {kind} colour profile was ignored; sRGB is assumed"));
            None
        }
        Found::Damaged => {
            notes.push("its colour profile is damaged and was ignored; sRGB is assumed".into());
            None
        }
    }
}
