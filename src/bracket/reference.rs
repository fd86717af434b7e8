//! Choice of the reference frame, which the others are aligned to.
//!
//! In: frames by rising exposure. Out: the index of one of them. Cost: one pass over every sixteenth pixel.

use super::{Frame, Samples};
use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// How the reference frame is chosen.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum ReferenceChoice {
    /// The best-exposed frame: the one with the most pixels in which every channel is between 1/16 and 15/16 of the
    /// range of pixel values. If several frames have at least 95 % of the largest number of such pixels, the one of
    /// them that is nearest the middle of the bracket.
    #[default]
    Auto,
    /// Same as [`Auto`](Self::Auto), but without these files.
    AutoExcept(Vec<PathBuf>),
    /// The file with this number, in the order given; the first file has number 1.
    Number(usize),
    /// The frame read from this file.
    File(PathBuf),
}

/// Returns the path that the user chose among `paths`, which are in the order given; `None` for the automatic choice.
pub(super) fn chosen(paths: &[&Path], choice: &ReferenceChoice) -> Result<Option<PathBuf>> {
    match choice {
        ReferenceChoice::Auto | ReferenceChoice::AutoExcept(_) => Ok(None),
        ReferenceChoice::Number(n) => {
            n.checked_sub(1).and_then(|i| paths.get(i)).map(|path| Some(path.to_path_buf())).ok_or_else(|| {
                Error::Option {
                    option: "--reference",
                    reason: format!("there is no photograph number {n}; give 1 to {}, or a file name", paths.len()),
                }
            })
        }
        ReferenceChoice::File(path) => {
            named(paths, path).map(|i| Some(paths[i].to_path_buf())).ok_or_else(|| Error::Option {
                option: "--reference",
                reason: format!("{} is not among the photographs; name one of them, or its number", path.display()),
            })
        }
    }
}

/// Returns the index in `paths` of `path`, or of another path to the same file. If there is none, and `path` is the
/// file name of exactly one of the `paths`, returns the index of that one.
pub(crate) fn named(paths: &[&Path], path: &Path) -> Option<usize> {
    let real = |p: &Path| std::fs::canonicalize(p).ok();
    let same_file = || real(path).and_then(|wanted| paths.iter().position(|p| real(p).as_deref() == Some(&wanted)));
    let same_name = || {
        let mut named = (0..paths.len()).filter(|&i| paths[i].file_name() == Some(path.as_os_str()));
        named.next().filter(|_| named.next().is_none())
    };
    paths.iter().position(|p| *p == path).or_else(same_file).or_else(same_name)
}

/// The paths of `frames`, in their order.
pub(super) fn paths(frames: &[Frame]) -> Vec<&Path> {
    frames.iter().map(Frame::path).collect()
}

/// Returns the index of the best-exposed frame: see [`ReferenceChoice::Auto`]. Frames must be sorted by rising
/// exposure. Excluded frames and those in `except` are chosen only if no other frame is left.
pub(super) fn best(frames: &[Frame], except: &[PathBuf]) -> usize {
    let paths = paths(frames);
    let mut excluded: Vec<usize> = except.iter().filter_map(|path| named(&paths, path)).collect();
    excluded.extend((0..frames.len()).filter(|&i| frames[i].excluded.is_some()));
    excluded.sort_unstable();
    excluded.dedup();
    let is_open = |i: usize| !excluded.contains(&i) || excluded.len() >= frames.len();
    best_of(frames, is_open).unwrap_or(frames.len() / 2)
}

/// Returns the index of the best-exposed frame for which `is_open` is true.
pub(super) fn best_of(frames: &[Frame], is_open: impl Fn(usize) -> bool) -> Option<usize> {
    let seen: Vec<u64> = frames.iter().enumerate().map(|(i, f)| if is_open(i) { f.well_exposed } else { 0 }).collect();
    let most = seen.iter().copied().max().unwrap_or(0);
    let centre = frames.len() as i64 - 1;
    (0..frames.len())
        .filter(|&i| is_open(i) && 20 * seen[i] >= 19 * most)
        .min_by_key(|&i| ((2 * i as i64 - centre).abs(), i))
}

/// Counts the pixels with all channels between 1/16 and 15/16 of the range. Only every fourth pixel of every fourth row
/// of the image, which is `width` pixels wide, is examined.
pub(super) fn well_exposed(samples: &Samples, width: usize) -> u64 {
    fn count<T: Copy + PartialOrd>(v: &[T], width: usize, low: T, high: T) -> u64 {
        // The test has no branches, because they would be hard to predict.
        let inside = |p: &[T]| p.iter().fold(true, |all, &c| all & (c >= low) & (c <= high));
        v.chunks_exact(3 * width)
            .step_by(4)
            .map(|row| row.chunks_exact(3).step_by(4).filter(|p| inside(p)).count() as u64)
            .sum()
    }
    match samples {
        Samples::Eight(v) => count(v, width, 16, 239),
        Samples::Sixteen(v) => count(v, width, 16 << 8, 239 << 8),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::exposure::Exposure;

    fn frame(name: &str, exposed: usize) -> Frame {
        let samples = (0..64 * 64).flat_map(|i| [if i / 64 < exposed { 128 } else { 255 }; 3]).collect();
        Frame::new(name.into(), 64, 64, Samples::Eight(samples), Exposure::given(0.0).unwrap())
    }

    #[test]
    fn the_frame_that_sees_the_most_wins_and_the_middle_breaks_ties() {
        assert_eq!(best(&[frame("a", 10), frame("b", 20), frame("c", 60)], &[]), 2);
        assert_eq!(best(&[frame("a", 64), frame("b", 62), frame("c", 64)], &[]), 1);
        assert_eq!(best(&[frame("a", 0), frame("b", 0), frame("c", 0)], &[]), 1);
    }

    #[test]
    fn the_users_choice_is_by_number_or_by_name() {
        let frames = [frame("a.png", 1), frame("b.png", 1)];
        let name = |choice| chosen(&paths(&frames), &choice).map(|p| p.unwrap());
        assert_eq!(name(ReferenceChoice::Number(2)).unwrap(), Path::new("b.png"));
        assert_eq!(name(ReferenceChoice::File("a.png".into())).unwrap(), Path::new("a.png"));
        for wrong in [ReferenceChoice::Number(0), ReferenceChoice::Number(3), ReferenceChoice::File("c.png".into())] {
            assert!(matches!(name(wrong), Err(Error::Option { option: "--reference", .. })));
        }
    }
}
