//! Aligned frames: each placed frame on the reference's grid, as TIFF of its own depth.
//!
//! In: a bracket and its alignment. Out: one file a frame, `PREFIX` and the frame's name; black where a frame does not reach. Cost:
//! one resampling of every frame, by bands.

use super::{Metadata, Pending, RowWriter, Written, tiff};
use crate::align::resample::{OUTSIDE, resample_rows};
use crate::align::warp::Warp;
use crate::align::{Alignment, Rect};
use crate::bracket::{Bracket, Codes, Window};
use crate::error::{Error, Result};
use crate::plane::{BAND_ROWS, band_count, band_rows};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// The name under which the frame of `image` is saved: `prefix`, its name without the extension, `.tif`.
fn name(prefix: &Path, image: &Path) -> PathBuf {
    let mut name = prefix.as_os_str().to_os_string();
    name.push(image.file_stem().unwrap_or_default());
    name.push(".tif");
    PathBuf::from(name)
}

/// The names under which the frames of `images` are saved.
///
/// # Errors
/// [`Error::Option`] where two would have the same name.
pub fn names(prefix: &Path, images: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let names: Vec<PathBuf> = images.iter().map(|image| name(prefix, image)).collect();
    for (i, name) in names.iter().enumerate() {
        if names[..i].contains(name) {
            return Err(Error::Option {
                option: "--save-aligned",
                reason: format!("two photographs would both be saved as {}; rename one of them", name.display()),
            });
        }
    }
    Ok(names)
}

/// Writes the part `region` of every placed frame of `bracket`.
///
/// # Errors
/// [`Error::Write`], [`Error::Scratch`].
pub fn write(
    bracket: &Bracket,
    alignment: &Alignment,
    region: Rect,
    prefix: &Path,
    metadata: &Metadata,
) -> Result<Vec<Written>> {
    let mut files = Vec::new();
    for (frame, verdict) in bracket.frames().iter().zip(&alignment.verdicts) {
        let Some(warp) = verdict.warp else { continue };
        let path = name(prefix, frame.path());
        let size = (region.width(), region.height());
        let metadata = Metadata { profile: frame.profile.clone(), ..metadata.clone() };
        let file = Pending::create(&path)?;
        let whole = frame.whole()?;
        files.push(match whole.codes() {
            Codes::Eight(_) => {
                let writer = tiff::Writer::<u8>::new(file, size, &metadata)?;
                push(Box::new(writer), &whole, &warp, region, |code| (code + 0.5) as u8)?
            }
            Codes::Sixteen(_) => {
                let writer = tiff::Writer::<u16>::new(file, size, &metadata)?;
                push(Box::new(writer), &whole, &warp, region, |code| (code * 257.0 + 0.5) as u16)?
            }
        });
    }
    Ok(files)
}

/// Bands that are resampled before they are written.
const BANDS_AT_ONCE: usize = 8;

fn push<T: Copy + Send + Sync>(
    mut writer: Box<dyn RowWriter<[T; 3]> + '_>,
    window: &Window,
    warp: &Warp,
    region: Rect,
    round: impl Fn(f32) -> T + Sync,
) -> Result<Written> {
    let bands: Vec<usize> = (0..band_count(region.height())).collect();
    for some in bands.chunks(BANDS_AT_ONCE) {
        let rows: Vec<Vec<[T; 3]>> = some
            .par_iter()
            .map(|&band| {
                let rows = band_rows(band, region.height());
                let mut codes = vec![[0.0f32; 3]; rows.len() * region.width()];
                let rows = region.y0 + rows.start..region.y0 + rows.end;
                resample_rows(window, warp, region.x0..region.x1, rows, &mut codes);
                codes.iter().map(|p| if p[0] == OUTSIDE { [round(0.0); 3] } else { p.map(&round) }).collect()
            })
            .collect();
        for band in rows {
            debug_assert!(band.len() <= BAND_ROWS * region.width());
            writer.push(&band)?;
        }
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
        assert_eq!(names(Path::new("out/al_"), &images).unwrap(), expected);
        let twins = [PathBuf::from("a/1.jpg"), PathBuf::from("b/1.png")];
        assert!(names(Path::new("out/"), &twins).unwrap_err().to_string().contains("out/1.tif"));
    }
}
