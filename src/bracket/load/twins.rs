//! Shots that were given twice: as a camera raw file, and as the picture that the camera made of it.
//!
//! In: the paths of photographs. Out: which of them are read, and a warning about the others. Cost: none.

use crate::error::Warning;
use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Returns the indices of the `paths` that are read: all but those of pictures beside which there is a raw file of the
/// same name, as with IMG_1.JPG and IMG_1.DNG. The warning names the first of them.
pub(super) fn without_twins(paths: &[PathBuf]) -> (Vec<usize>, Option<Warning>) {
    let name = |path: &Path| -> (OsString, OsString) {
        let folder = path.parent().unwrap_or(Path::new("")).as_os_str().to_owned();
        (folder, path.file_stem().unwrap_or_default().to_ascii_lowercase())
    };
    let raw: HashMap<_, &PathBuf> = paths.iter().filter(|path| is_raw(path)).map(|path| (name(path), path)).collect();
    let twin = |path: &PathBuf| raw.get(&name(path)).filter(|_| !is_raw(path)).copied();
    let kept: Vec<usize> = (0..paths.len()).filter(|&i| twin(&paths[i]).is_none()).collect();
    let warning = paths.iter().find_map(|path| {
        let count = paths.len() - kept.len();
        Some(Warning::RawPreferred { path: path.clone(), raw: twin(path)?.clone(), count })
    });
    (kept, warning)
}

/// Whether the name of a file is that of a camera raw file that can be read.
fn is_raw(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("dng"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_beside_their_raw_files_are_not_read() {
        let paths = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        let (kept, warning) =
            without_twins(&paths(&["a/1.JPG", "a/1.dng", "a/2.DNG", "a/2.tif", "b/2.jpg", "a/3.jpg"]));
        assert_eq!(kept, [1, 2, 4, 5]);
        let words = warning.unwrap().to_string();
        assert!(words.contains("a/1.JPG") && words.contains("a/1.dng") && words.contains("1 other file,"), "{words}");
        let (kept, warning) = without_twins(&paths(&["1.jpg", "1.tif", "2.dng"]));
        assert_eq!((kept, warning.is_none()), (vec![0, 1, 2], true));
    }
}
