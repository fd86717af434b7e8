//! Writes the sheets (drawings) and tables of an inspection into a folder. Either all files are written or none.
//!
//! In: an [`Inspection`] and a folder. Out: files named after the photographs, such as `NAME.keypoints.svg`, and
//! `tables.txt` and `tables.json`. Cost: drawing. The sheets of one frame are in memory at a time.

use super::tables::Tables;
use super::{Inspection, Sheet, SheetKind};
use crate::error::{Error, Result};
use crate::write::{self, CompleteFile, NewFolder, Target};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::{fs, io};
use strum::VariantArray;

/// The paths of files, each with the content that will be written.
type Named = Vec<(PathBuf, Vec<u8>)>;

const TEXT: &str = "tables.txt";
const JSON: &str = "tables.json";

/// Checks that the inspection of `images` can be written into `folder`, before any work is done.
///
/// The folder or its parent must exist, the photographs must have different names, and without `overwrite` none of the
/// files may exist.
///
/// # Errors
/// [`Error::Option`] if two photographs have the same name; [`Error::Write`] if the folder cannot be used;
/// [`Error::OutputExists`] if one of the files exists.
pub fn check(folder: &Path, images: &[PathBuf], overwrite: bool) -> Result<()> {
    let mut stems: Vec<String> = Vec::new();
    for image in images {
        let stem = stem(image);
        if stems.contains(&stem) {
            let reason = format!(
                "two photographs have the name {stem}, so their drawings would have the same names; rename one of them"
            );
            return Err(Error::Option { option: "--folder", reason });
        }
        stems.push(stem);
    }
    match fs::metadata(folder) {
        Ok(there) if !there.is_dir() => {
            let reason = "it is a file, not a folder; give a folder with -d";
            Err(write_error(folder, io::Error::new(io::ErrorKind::InvalidInput, reason)))
        }
        Ok(_) => {
            let every = |stem: &String| {
                let of = |kind: &SheetKind| {
                    kind.extensions().iter().map(|e| path(folder, stem, *kind, e)).collect::<Vec<_>>()
                };
                SheetKind::VARIANTS.iter().flat_map(of).collect::<Vec<_>>()
            };
            let mut files: Vec<PathBuf> = stems.iter().flat_map(every).collect();
            files.extend([TEXT, JSON].map(|name| folder.join(name)));
            write::check_targets(&Target::of("-d", &files), images, overwrite)
        }
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            // The folder does not exist yet. It is created when the files are written. Here only its parent is
            // checked.
            write::check_targets(&Target::of("-d", &[folder.to_owned()]), images, true)
        }
        Err(e) => Err(write_error(folder, e)),
    }
}

/// Draws all sheets, and writes them and the tables into `folder`. Creates the folder if it does not exist. Returns
/// the tables, which list the files in the order written. After an error, no new file or folder remains.
///
/// # Errors
/// [`Error::Write`]; [`Error::OutputExists`] if one of the files was created since [`check`] and `overwrite` is
/// false.
pub fn write(inspection: &Inspection, folder: &Path, overwrite: bool) -> Result<Tables> {
    // This variable is declared before the files, so it is dropped after them. On an error, the temporary files in
    // the folder are thus removed first, and then the empty folder.
    let made = NewFolder::create(folder)?;
    let mut files: Vec<CompleteFile> = Vec::new();
    for (i, frame) in inspection.bracket.frames().iter().enumerate() {
        let stem = stem(frame.path());
        let kinds = inspection.kinds(i);
        let drawn: Vec<Result<Named>> = kinds
            .par_iter()
            .map(|&kind| {
                let at = |extension| path(folder, &stem, kind, extension);
                let failed = |reason: String| write_error(&at("png"), io::Error::other(reason));
                match inspection.sheet(i, kind).map_err(failed)? {
                    None => Ok(Vec::new()),
                    Some(Sheet::Bitmap(png)) => Ok(vec![(at("png"), png)]),
                    Some(Sheet::Drawing(drawing)) => {
                        let png = drawing.to_png().map_err(failed)?;
                        Ok(vec![(at("svg"), drawing.to_svg().into_bytes()), (at("png"), png)])
                    }
                }
            })
            .collect();
        for some in drawn {
            for (path, bytes) in some? {
                files.push(write::complete(&path, &bytes)?);
            }
        }
    }
    let mut tables = inspection.tables().clone();
    let mut names: Vec<PathBuf> = files.iter().map(|f| f.target().to_owned()).collect();
    names.extend([TEXT, JSON].map(|name| folder.join(name)));
    tables.add_outputs(&names);
    files.push(write::complete(&folder.join(TEXT), tables.to_text().as_bytes())?);
    files.push(write::complete(&folder.join(JSON), tables.to_json().as_bytes())?);
    write::rename_all(files, overwrite)?;
    made.keep();
    Ok(tables)
}

fn stem(image: &Path) -> String {
    image.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn path(folder: &Path, stem: &str, kind: SheetKind, extension: &str) -> PathBuf {
    let kind: &str = kind.into();
    folder.join(format!("{stem}.{kind}.{extension}"))
}

fn write_error(path: &Path, source: io::Error) -> Error {
    Error::Write { path: path.to_owned(), source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_that_cannot_be_used_is_rejected_before_any_work() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let images = [at("a.jpg"), at("b.jpg")];
        let fails = |folder: &str, images: &[PathBuf], said: &str| {
            let message = check(&at(folder), images, false).unwrap_err().to_string();
            assert!(message.contains(said), "{message}");
        };
        check(&at("new"), &images, false).unwrap();
        assert!(!at("new").exists());
        fails("none/new", &images, "mkdir");
        fails("new", &[at("a.jpg"), at("sub/a.png")], "rename one");
        fs::write(at("file"), "x").unwrap();
        fails("file", &images, "not a folder; give a folder with -d");
        fs::create_dir(at("old")).unwrap();
        check(&at("old"), &images, false).unwrap();
        fs::write(at("old/b.xor.svg"), "x").unwrap();
        fails("old", &images, "--force");
        check(&at("old"), &images, true).unwrap();
    }
}
