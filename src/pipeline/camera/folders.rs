//! Folders of photographs as brackets: one bracket per folder.
//!
//! In: photographs and folders, as the user gave them. Out: the photographs of each bracket. Cost: reading the folders.

use crate::bracket::EXTENSIONS;
use crate::bracket::header::Header;
use crate::error::{Error, Result};
use crate::intake;
use crate::limits::Limits;
use crate::pipeline::files::names::natural;
use std::path::{Path, PathBuf};

/// A folder and the photographs in it.
struct Folder {
    path: PathBuf,
    /// Identity of the folder; `None` if it does not exist.
    identity: Option<intake::Identity>,
    bracket: Vec<PathBuf>,
}

/// Groups photographs by folder, in the order in which the folders first occur in `images`. A folder in `images` stands
/// for all photographs in it, sorted by name. Different spellings of a folder, such as `a` and `./a`, are one folder.
pub(super) fn brackets(images: &[PathBuf]) -> Result<Vec<Vec<PathBuf>>> {
    let mut found: Vec<Folder> = Vec::new();
    for image in images {
        let paths = if image.is_dir() { photographs(image)? } else { vec![image.clone()] };
        for path in paths {
            let folder = match path.parent() {
                Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
                _ => PathBuf::from("."),
            };
            let identity = intake::identity(&folder);
            let is_same = |f: &&mut Folder| f.path == folder || identity.is_some() && f.identity == identity;
            match found.iter_mut().find(is_same) {
                Some(known) => known.bracket.push(path),
                None => found.push(Folder { path: folder, identity, bracket: vec![path] }),
            }
        }
    }
    if let Some(Folder { path: folder, bracket, .. }) = found.iter().find(|folder| folder.bracket.len() < 2) {
        if found.len() == 1 && images.len() == 1 && !images[0].is_dir() {
            return Err(Error::TooFewFrames { given: bracket.len() });
        }
        let reason = format!(
            "only {} is given from the folder {:?}; the photographs in one folder are one bracket, which needs at least two",
            bracket[0].display(),
            folder.display().to_string()
        );
        return Err(Error::Option { option: "IMAGES", reason });
    }
    Ok(found.into_iter().map(|folder| folder.bracket).collect())
}

/// Returns the files in `folder` that have the extension of a photograph, sorted by name, without results of hdralign.
fn photographs(folder: &Path) -> Result<Vec<PathBuf>> {
    let unreadable = |source| Error::Read { path: folder.to_owned(), source };
    let entries = std::fs::read_dir(folder).map_err(unreadable)?;
    let mut paths = entries.map(|e| Ok(e?.path())).collect::<std::io::Result<Vec<_>>>().map_err(unreadable)?;
    let extension = |p: &Path| p.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    let is_hidden = |p: &Path| p.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
    paths.retain(|p| EXTENSIONS.contains(&extension(p).as_str()) && !is_hidden(p) && p.is_file());
    paths.retain(|p| !Header::read(p, &Limits::default()).is_ok_and(|header| header.is_ours()));
    paths.sort_by(|a, b| natural(a, b));
    if paths.len() < 2 {
        let found = paths.len();
        let reason = format!(
            "{} contains {found} photographs (JPEG, PNG, TIFF), and a bracket needs at least two",
            folder.display()
        );
        return Err(Error::Option { option: "IMAGES", reason });
    }
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photographs_of_a_folder_are_a_bracket() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for folder in ["a", "b", "empty"] {
            std::fs::create_dir(at(folder)).unwrap();
        }
        for name in ["a/10.JPG", "a/9.jpg", "a/notes.txt", "a/.10.jpg", "b/1.png", "b/2.tif", "a/8.jfif", "a/7.JPE"] {
            std::fs::write(at(name), "").unwrap();
        }
        let all = brackets(&[at("a"), at("b/2.tif"), at("b/1.png")]).unwrap();
        assert_eq!(
            all,
            [vec![at("a/7.JPE"), at("a/8.jfif"), at("a/9.jpg"), at("a/10.JPG")], vec![at("b/2.tif"), at("b/1.png")]]
        );
        let two_spellings = [at("b/2.tif"), at("a/../b/1.png")];
        assert_eq!(brackets(&two_spellings).unwrap(), [two_spellings.to_vec()]);
        assert!(brackets(&[at("empty")]).unwrap_err().to_string().contains("0 photographs"));
        assert!(brackets(&[at("a"), at("b/1.png")]).unwrap_err().to_string().contains("only"));
        assert!(matches!(brackets(&[at("b/1.png")]), Err(Error::TooFewFrames { given: 1 })));
    }
}
