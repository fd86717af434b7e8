//! Writes masks as 8-bit grey PNG.
//!
//! In: a plane of bytes. Out: a PNG, for people and programs; the values are not light, so the PNG has no colour space.
//! Cost: about 10 ns per pixel. Source: PNG (3rd ed., W3C 2025), section 11.2.1 (colour type 0).

use crate::error::{Error, Result};
use crate::plane::Plane;
use crate::write::metadata::Metadata;
use crate::write::staging::{Pending, Written};
use std::io::{self, Write};
use std::path::Path;

/// Checks that `path`, if given, has the extension of a PNG, and that there is a mask (`is_one`).
///
/// # Errors
/// [`Error::UnknownExtension`]; [`Error::Option`] if motion is not detected, so that there is no mask.
pub fn check(path: Option<&Path>, is_one: bool) -> Result<()> {
    let Some(path) = path else { return Ok(()) };
    if !path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
        return Err(Error::UnknownExtension { path: path.to_owned(), known: ".png" });
    }
    if is_one {
        return Ok(());
    }
    let reason = "there is no mask without deghosting; remove --deghost=off".to_owned();
    Err(Error::Option { option: "--ghost-mask", reason })
}

/// Writes `mask` to a temporary file for `path`, to be committed by [`commit`](crate::write::commit).
///
/// # Errors
/// [`Error::Write`].
pub fn write(path: &Path, mask: &Plane<u8>) -> Result<Written> {
    let mut file = Pending::create(path)?;
    let bytes = encode(mask).map_err(|e| file.error(e))?;
    file.write_all(&bytes).map_err(|e| file.error(e))?;
    Written::ended(file, Vec::new())
}

fn encode(mask: &Plane<u8>) -> io::Result<Vec<u8>> {
    let side = |n: usize| {
        u32::try_from(n).map_err(|_| {
            io::Error::other("the picture is too large: each side of a PNG must have fewer than 2^32 pixels")
        })
    };
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, side(mask.width())?, side(mask.height())?);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    // Because of the name of the program in the file, hdralign does not read the mask as a photograph.
    encoder.add_text_chunk("Software".into(), Metadata::default().software)?;
    let mut writer = encoder.write_header()?;
    writer.write_image_data(mask.as_slice())?;
    writer.finish()?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_reads_back_as_it_was() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m.png");
        let mask = Plane::from_vec(7, 5, (0..35).map(|i| (i * 7) as u8).collect());
        crate::write::commit(vec![write(&path, &mask).unwrap().file], false).unwrap();
        let read = image::open(&path).unwrap();
        assert_eq!(read.color(), image::ColorType::L8);
        assert_eq!(read.to_luma8().into_raw(), mask.as_slice());
    }

    #[test]
    fn a_mask_is_a_png_of_something() {
        assert!(check(Some(Path::new("m.PNG")), true).is_ok() && check(None, false).is_ok());
        assert!(check(Some(Path::new("m.jpg")), true).unwrap_err().is_usage());
        assert!(check(Some(Path::new("m.png")), false).unwrap_err().is_usage());
    }
}
