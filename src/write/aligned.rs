//! Writes the aligned frames: each merged frame, resampled to the pixel grid of the reference frame, as TIFF with the
//! bit depth of the frame.
//!
//! In: a bracket and its alignment. Out: one file per frame, named `PREFIX` followed by the name of the frame. Pixels
//! that the frame does not show are black. Cost: one resampling of every frame, in bands.

use super::metadata::Metadata;
use super::row_writer::RowWriter;
use super::staging::{Pending, Written};
use super::tiff;
use crate::align::resampling::{OUTSIDE, resample_rows};
use crate::align::{Alignment, Motion, Rect};
use crate::bracket::{Bracket, Codes, Frame, Window};
use crate::error::{Error, Result};
use crate::plane::BAND_ROWS;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Returns the path of the file of `image`: `prefix`, the file name of `image` without its extension, and
/// `.tif`.
pub(super) fn name(prefix: &Path, image: &Path) -> PathBuf {
    let mut name = prefix.as_os_str().to_os_string();
    name.push(image.file_stem().unwrap_or_default());
    name.push(".tif");
    PathBuf::from(name)
}

/// Returns the paths of the files of `images` that `option` names.
///
/// # Errors
/// [`Error::Option`] if two frames would have the same path.
pub fn names(option: &'static str, prefix: &Path, images: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let names: Vec<PathBuf> = images.iter().map(|image| name(prefix, image)).collect();
    for (i, name) in names.iter().enumerate() {
        if names[..i].contains(name) {
            return Err(Error::Option {
                option,
                reason: format!("two photographs would be saved as {}; rename one of them", name.display()),
            });
        }
    }
    Ok(names)
}

/// Writes every merged frame of `bracket`, cut to `region` of the reference grid, with the `metadata` of the frame.
///
/// # Errors
/// [`Error::Write`], [`Error::Scratch`].
pub fn write(
    bracket: &Bracket,
    alignment: &Alignment,
    region: Rect,
    prefix: &Path,
    metadata: impl Fn(&Frame) -> Metadata,
) -> Result<Vec<Written>> {
    let mut files = Vec::new();
    for (_, frame, motion) in alignment.placed(bracket) {
        let path = name(prefix, frame.path());
        let size = (region.width(), region.height());
        let metadata = Metadata { profile: frame.profile.clone(), ..metadata(frame) };
        let file = Pending::create(&path)?;
        let whole = frame.whole()?;
        files.push(match whole.codes() {
            Codes::Eight(_) => {
                let writer = tiff::Writer::<u8>::new(file, size, &metadata)?;
                push(Box::new(writer), &whole, &motion, region, |code| (code + 0.5) as u8)?
            }
            Codes::Sixteen(_) => {
                let writer = tiff::Writer::<u16>::new(file, size, &metadata)?;
                push(Box::new(writer), &whole, &motion, region, |code| (code * 257.0 + 0.5) as u16)?
            }
        });
    }
    Ok(files)
}

/// Number of bands that are computed in parallel before they are written.
pub(super) const BANDS_AT_ONCE: usize = 8;

fn push<T: Copy + Send + Sync>(
    mut writer: Box<dyn RowWriter<[T; 3]> + '_>,
    window: &Window,
    motion: &Motion,
    region: Rect,
    round: impl Fn(f32) -> T + Sync,
) -> Result<Written> {
    let (width, height) = (region.width(), region.height());
    let black = round(0.0);
    let mut rows = vec![[black; 3]; width * height.min(BANDS_AT_ONCE * BAND_ROWS)];
    for first in (0..height).step_by(BANDS_AT_ONCE * BAND_ROWS) {
        let rows = &mut rows[..width * (height - first).min(BANDS_AT_ONCE * BAND_ROWS)];
        rows.par_chunks_mut(BAND_ROWS * width).enumerate().for_each_init(Vec::new, |codes, (band, to)| {
            let y = region.y0 + first + band * BAND_ROWS;
            codes.resize(to.len(), [0.0f32; 3]);
            resample_rows(window, motion, region.x0..region.x1, y..y + to.len() / width, codes);
            for (to, p) in to.iter_mut().zip(codes.iter()) {
                *to = if p[0] == OUTSIDE { [black; 3] } else { p.map(&round) };
            }
        });
        writer.push(rows)?;
    }
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_keep_their_names() {
        let images = [PathBuf::from("a/IMG_1.jpg"), PathBuf::from("b/IMG_2.x.png")];
        let expected = [PathBuf::from("out/al_IMG_1.tif"), PathBuf::from("out/al_IMG_2.x.tif")];
        assert_eq!(names("-x", Path::new("out/al_"), &images).unwrap(), expected);
        let twins = [PathBuf::from("a/1.jpg"), PathBuf::from("b/1.png")];
        assert!(names("-x", Path::new("out/"), &twins).unwrap_err().to_string().contains("out/1.tif"));
    }
}
