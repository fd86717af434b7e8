//! Lists the photographs in folders, each file once, in an order that does not depend on the file system.
//!
//! In: folders. Out: the [`Candidate`]s (files that are photographs by their extension), and the files that are not
//! used. Cost: listing the folders.
//!
//! Symbolic links come after all other files, whatever the order of the directory entries. So if there is a file and
//! a link to it, the file is used.

use super::{LeftOver, Reason};
use crate::bracket::EXTENSIONS;
use crate::error::{Error, Result};
use crate::intake::identity;
use crate::pipeline::natural;
use std::collections::{HashMap, HashSet};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A file that is a photograph by its extension.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Candidate {
    pub(super) path: PathBuf,
    pub(super) place: Arc<Place>,
    pub(super) kind: Kind,
}

impl Candidate {
    /// Returns whether hdralign can read its header, which is possible only for JPEG, PNG and TIFF.
    pub(super) fn is_read(&self) -> bool {
        self.kind == Kind::Picture
    }
}

/// A folder that is searched.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Place {
    /// The folder that the user gave.
    pub(super) root: PathBuf,
    /// The path of this folder relative to `root`.
    pub(super) folder: PathBuf,
    /// The canonical path of this folder.
    pub(super) own: PathBuf,
}

impl Place {
    /// Returns the path by which the search reached this folder.
    fn path(&self) -> PathBuf {
        self.root.join(&self.folder)
    }

    /// Returns the subfolder `name` of this folder; `own` is the canonical path of the subfolder.
    fn below(&self, name: &Path, own: PathBuf) -> Place {
        Place { root: self.root.clone(), folder: self.folder.join(name), own }
    }
}

/// The kind of a file, by its extension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// JPEG, PNG, TIFF or DNG.
    Picture,
    /// A camera raw file other than DNG.
    Raw,
    /// A photograph in another format.
    Other(&'static str),
}

/// Extensions of raw files other than DNG: most of those that ExifTool lists, and `ari`, `bay` and `dcs`.
const RAW: [&str; 31] = [
    "3fr", "ari", "arw", "bay", "cr2", "cr3", "crw", "dcr", "dcs", "erf", "fff", "gpr", "iiq", "k25", "kdc", "mef",
    "mos", "mrw", "nef", "nrw", "orf", "ori", "pef", "raf", "raw", "rw2", "rwl", "sr2", "srf", "srw", "x3f",
];

impl Kind {
    /// Returns the kind of the file `path`, or `None` if its extension is not that of a photograph.
    pub(super) fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        Some(match extension.as_str() {
            picture if EXTENSIONS.contains(&picture) => Kind::Picture,
            "heic" | "heif" | "hif" => Kind::Other("HEIC"),
            "avif" => Kind::Other("AVIF"),
            "webp" => Kind::Other("WebP"),
            "jxl" => Kind::Other("JPEG XL"),
            raw if RAW.contains(&raw) => Kind::Raw,
            _ => return None,
        })
    }
}

/// The result of a walk through the folders.
#[derive(Debug, Default)]
pub(super) struct Walk {
    pub(super) candidates: Vec<Candidate>,
    pub(super) left_over: Vec<LeftOver>,
    pub(super) other_files: usize,
}

/// Lists the photographs in `roots` and all folders below them, except in the folders `skip`. A folder of `skip` that
/// is also in `roots` is searched nevertheless.
pub(super) fn walk(roots: &[PathBuf], skip: &[PathBuf]) -> Result<Walk> {
    let mut roots: Vec<&PathBuf> = roots.iter().collect();
    roots.sort_by(|a, b| natural(a, b));
    let mut open = Vec::new();
    for root in roots.into_iter().rev() {
        let unreadable = |source| Error::Read { path: root.clone(), source };
        if !fs::metadata(root).map_err(unreadable)?.is_dir() {
            let reason = "it is a file; name the folder that it is in";
            return Err(unreadable(io::Error::new(io::ErrorKind::InvalidInput, reason)));
        }
        // If a folder that the user gave cannot be listed, this is an error. A folder below it that cannot be listed
        // is only reported with the unused files.
        fs::read_dir(root).map_err(unreadable)?;
        let own = fs::canonicalize(root).map_err(unreadable)?;
        open.push(Place { root: root.clone(), folder: PathBuf::new(), own });
    }
    let is_root = |path: &PathBuf| open.iter().any(|place| place.own == *path);
    let skipped = skip.iter().filter_map(|path| fs::canonicalize(path).ok());
    let mut seen: HashSet<PathBuf> = skipped.filter(|path| !is_root(path)).collect();
    let mut walk = Walk::default();
    let (mut linked_files, mut linked_folders) = (Vec::new(), Vec::new());
    loop {
        let Some(place) = open.pop() else {
            // All folders that can be reached without a symbolic link have been searched. Now the folders follow that
            // can be reached only by a link.
            linked_folders.sort_by(|a: &Place, b: &Place| natural(&a.path(), &b.path()));
            linked_folders.reverse();
            if linked_folders.is_empty() {
                break;
            }
            open.append(&mut linked_folders);
            continue;
        };
        if !seen.insert(place.own.clone()) {
            continue;
        }
        let path = place.path();
        let unreadable = |path: PathBuf, e: io::Error| LeftOver {
            path,
            reason: Reason::Unreadable(format!("the folder cannot be read: {e}; check its permissions")),
        };
        let entries = match entries(&path) {
            Ok(entries) => entries,
            Err(e) => {
                walk.left_over.push(unreadable(path, e));
                continue;
            }
        };
        let place = Arc::new(place);
        let mut folders = Vec::new();
        for Entry { name, is_link, is_folder } in entries {
            match (is_folder, is_link) {
                // The canonical path is the canonical path of the parent plus the name. `fs::canonicalize` would read
                // all parent folders again.
                (true, false) => folders.push(place.below(&name, place.own.join(&name))),
                (true, true) => match fs::canonicalize(path.join(&name)) {
                    Ok(own) => linked_folders.push(place.below(&name, own)),
                    Err(e) => walk.left_over.push(unreadable(path.join(&name), e)),
                },
                (false, _) => match Kind::of(&name) {
                    None => walk.other_files += 1,
                    Some(kind) => {
                        let candidate = Candidate { path: path.join(name), place: place.clone(), kind };
                        if is_link { linked_files.push(candidate) } else { walk.candidates.push(candidate) }
                    }
                },
            }
        }
        open.extend(folders.into_iter().rev());
    }
    walk.add_once(linked_files);
    Ok(walk)
}

/// One entry of a folder.
struct Entry {
    name: PathBuf,
    is_link: bool,
    is_folder: bool,
}

/// Returns the entries of the folder `path`, sorted by name. It omits hidden files, the folders `__MACOSX` (from zip
/// files) and `@eaDir` (from file servers), and the folders that `hdralign inspect` writes
/// (whose names end with `.inspect`).
fn entries(path: &Path) -> io::Result<Vec<Entry>> {
    let mut entries = Vec::new();
    for entry in fs::read_dir(path)? {
        let entry = entry?;
        let name = PathBuf::from(entry.file_name());
        if name.to_string_lossy().starts_with('.') || name == Path::new("__MACOSX") || name == Path::new("@eaDir") {
            continue;
        }
        let kind = entry.file_type()?;
        let is_link = kind.is_symlink();
        // For a broken link `is_folder` is false. The link is reported when its header is read.
        let is_folder = if is_link { fs::metadata(entry.path()).is_ok_and(|m| m.is_dir()) } else { kind.is_dir() };
        if is_folder && name.extension().is_some_and(|e| e == "inspect") {
            continue;
        }
        entries.push(Entry { name, is_link, is_folder });
    }
    entries.sort_by(|a, b| natural(&a.name, &b.name));
    Ok(entries)
}

impl Walk {
    /// Adds the symbolic links `linked` to the candidates, and removes files that were found more than once. Of
    /// several hard links to one file, the first in each folder is kept; hard links in different folders are all
    /// kept, because they may be copies. A symbolic link is kept only if neither its target nor an earlier link to
    /// the same target is a candidate.
    #[allow(clippy::clone_on_copy)]
    fn add_once(&mut self, linked: Vec<Candidate>) {
        let mut in_folder = HashMap::new();
        let mut anywhere = HashMap::new();
        let mut once = Vec::with_capacity(self.candidates.len());
        for candidate in std::mem::take(&mut self.candidates) {
            let Some(identity) = identity(&candidate.path) else {
                once.push(candidate);
                continue;
            };
            let earlier =
                in_folder.entry((candidate.place.clone(), identity)).or_insert_with(|| candidate.path.clone());
            anywhere.entry(identity).or_insert_with(|| candidate.path.clone());
            if *earlier == candidate.path {
                once.push(candidate);
            } else {
                self.left_over.push(LeftOver { path: candidate.path, reason: Reason::SameFile(earlier.clone()) });
            }
        }
        for candidate in linked {
            let earlier = identity(&candidate.path)
                .map(|identity| anywhere.entry(identity).or_insert_with(|| candidate.path.clone()));
            match earlier {
                Some(earlier) if *earlier != candidate.path => {
                    self.left_over.push(LeftOver { path: candidate.path, reason: Reason::SameFile(earlier.clone()) });
                }
                _ => once.push(candidate),
            }
        }
        self.candidates = once;
    }
}
