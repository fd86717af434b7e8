//! Temporary files, and the registry that removes them when a run ends early.
//!
//! In: the target of a file. Out: a [`TemporaryFile`] in the target's folder, which becomes a [`Staged`] file when it
//! is complete. The temporary file is an [anonymous] file if the system supports that, otherwise a file with a
//! temporary name that a [claim](super::claim) protects. [`abandon`] removes all temporary files of the process. Cost:
//! the same as for any file. At most [`most`](anonymous::most) complete anonymous files stay open.

use super::anonymous;
use super::claim::Claim;
use crate::error::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Seek};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The temporary files of a process.
#[derive(Debug)]
pub(super) struct Registry(Mutex<State>);

#[derive(Debug)]
pub(super) struct State {
    is_abandoned: bool,
    /// For each folder with temporary names, the claim (lock file) that protects the names. Every claim has at least
    /// one name.
    claims: BTreeMap<PathBuf, Claim>,
    /// Folders that were created for output files.
    folders: BTreeSet<PathBuf>,
    /// Number of complete anonymous files, which stay open.
    open_anonymous: usize,
}

/// The registry of this process.
pub(super) static PROCESS_REGISTRY: Registry = Registry::new();

impl Registry {
    pub const fn new() -> Self {
        Registry(Mutex::new(State {
            is_abandoned: false,
            claims: BTreeMap::new(),
            folders: BTreeSet::new(),
            open_anonymous: 0,
        }))
    }

    /// Locks the state, also after a panic in another thread: the state is consistent after every statement.
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// See [`abandon`].
    pub fn abandon(&self) {
        let mut state = self.state();
        state.is_abandoned = true;
        state.claims.clear();
        for folder in std::mem::take(&mut state.folders) {
            // A folder that is not empty stays.
            let _ = fs::remove_dir(folder);
        }
    }

    /// Runs `rename`, which renames files, unless the registry is abandoned. The registry stays locked meanwhile, so
    /// that it cannot be abandoned before `rename` returns. `rename` must not drop a temporary file, because dropping
    /// takes the same lock.
    ///
    /// # Errors
    /// [`Error::Abandoned`] with the path of `target`; those of `rename`.
    pub fn unless_abandoned<R>(&self, target: &Path, rename: impl FnOnce(&mut State) -> Result<R>) -> Result<R> {
        let mut state = self.state();
        if state.is_abandoned {
            return Err(Error::Abandoned { path: target.to_owned() });
        }
        rename(&mut state)
    }
}

impl State {
    /// Reserves a temporary name in `folder` and creates its file with `make`.
    fn temporary<R>(&mut self, folder: &Path, make: impl FnOnce(&Path) -> io::Result<R>) -> io::Result<(PathBuf, R)> {
        if !self.claims.contains_key(folder) {
            self.claims.insert(folder.to_owned(), Claim::new(folder)?);
        }
        let path = self.claims.get_mut(folder).map(Claim::name).unwrap_or_default();
        match make(&path) {
            Ok(made) => Ok((path, made)),
            Err(error) => {
                self.release(&path);
                Err(error)
            }
        }
    }

    /// Links the anonymous `file` to a temporary name in `folder`, or copies it there where it cannot be linked.
    pub fn temporary_of(&mut self, folder: &Path, file: &File) -> io::Result<PathBuf> {
        let make = |path: &Path| anonymous::link(file, path).or_else(|_| copy(file, path));
        Ok(self.temporary(folder, make)?.0)
    }

    /// Removes a temporary name and its file, if the file exists. The claim on a folder is removed with its last
    /// name.
    fn release(&mut self, path: &Path) {
        let folder = path.parent().unwrap_or(path);
        if self.claims.get_mut(folder).is_some_and(|claim| claim.remove(path)) {
            self.claims.remove(folder);
        }
    }
}

/// Removes all temporary files of this process. From then on no file can be created or renamed. A set of files that
/// is being renamed is renamed completely first. Any thread may call this function at any time, for example when the
/// user interrupts the program. A signal handler must not call it, because it waits for a lock.
pub fn abandon() {
    PROCESS_REGISTRY.abandon();
}

/// A folder for output files. When dropped, the folder is removed if [`create`](Self::create) has created it and it
/// is empty. [`abandon`] does the same.
#[derive(Debug)]
pub struct NewFolder(Option<PathBuf>);

impl NewFolder {
    /// Creates `folder`, unless it exists.
    ///
    /// # Errors
    /// [`Error::Write`], [`Error::Abandoned`].
    pub fn create(folder: &Path) -> Result<Self> {
        let mut state = PROCESS_REGISTRY.state();
        if state.is_abandoned {
            return Err(Error::Abandoned { path: folder.to_owned() });
        }
        match fs::create_dir(folder) {
            Ok(()) => {
                state.folders.insert(folder.to_owned());
                Ok(NewFolder(Some(folder.to_owned())))
            }
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => Ok(NewFolder(None)),
            Err(source) => Err(Error::Write { path: folder.to_owned(), source }),
        }
    }

    /// Makes the folder permanent.
    pub fn keep(mut self) {
        if let Some(folder) = self.0.take() {
            PROCESS_REGISTRY.state().folders.remove(&folder);
        }
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        if let Some(folder) = self.0.take() {
            PROCESS_REGISTRY.state().folders.remove(&folder);
            // An error is ignored here: a folder that is not empty stays.
            let _ = fs::remove_dir(folder);
        }
    }
}

/// A temporary name. When dropped, the name is released and a file that still has it is removed.
#[derive(Debug)]
pub(super) struct TemporaryName {
    pub registry: &'static Registry,
    pub path: PathBuf,
}

impl Drop for TemporaryName {
    fn drop(&mut self) {
        self.registry.state().release(&self.path);
    }
}

/// A temporary file that is being written. When dropped, it is removed.
#[derive(Debug)]
pub(super) struct TemporaryFile {
    registry: &'static Registry,
    folder: PathBuf,
    file: File,
    /// `None` for an anonymous file.
    name: Option<TemporaryName>,
}

impl TemporaryFile {
    /// Creates a temporary file in `folder` for `target`, with the permissions of a new file.
    ///
    /// # Errors
    /// [`Error::Write`], [`Error::Abandoned`].
    pub fn create(registry: &'static Registry, folder: &Path, target: &Path) -> Result<Self> {
        registry.unless_abandoned(target, |state| {
            let made = match anonymous::create(folder) {
                Some(file) => Ok((file, None)),
                None => state.temporary(folder, create_new).map(|(path, file)| (file, Some(path))),
            };
            let (file, path) = made.map_err(|source| Error::Write { path: target.to_owned(), source })?;
            let name = path.map(|path| TemporaryName { registry, path });
            Ok(TemporaryFile { registry, folder: folder.to_owned(), file, name })
        })
    }

    pub fn file(&self) -> &File {
        &self.file
    }

    pub fn file_mut(&mut self) -> &mut File {
        &mut self.file
    }

    /// Turns the file into a complete file. An anonymous file gets a temporary name if too many anonymous files are
    /// open.
    ///
    /// # Errors
    /// The error of the system if a temporary name is needed and cannot be created.
    pub fn stage(self) -> io::Result<Staged> {
        let TemporaryFile { registry, folder, file, name } = self;
        if let Some(name) = name {
            return Ok(Staged::Named(name));
        }
        let mut state = registry.state();
        // An abandoned registry must not give new names, so the file stays anonymous.
        if state.open_anonymous < anonymous::most() || state.is_abandoned {
            state.open_anonymous += 1;
            drop(state);
            return Ok(Staged::Anonymous(AnonymousFile { registry, folder, file }, None));
        }
        let path = state.temporary_of(&folder, &file)?;
        drop(state);
        Ok(Staged::Named(TemporaryName { registry, path }))
    }
}

fn create_new(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).create_new(true).open(path)
}

/// Copies `file` to the new file `path` and syncs it.
fn copy(mut file: &File, path: &Path) -> io::Result<()> {
    file.rewind()?;
    let mut copy = create_new(path)?;
    io::copy(&mut file, &mut copy)?;
    copy.sync_all()
}

/// A complete anonymous file. When dropped, it is removed.
#[derive(Debug)]
pub(super) struct AnonymousFile {
    pub registry: &'static Registry,
    pub folder: PathBuf,
    pub file: File,
}

impl Drop for AnonymousFile {
    fn drop(&mut self) {
        self.registry.state().open_anonymous -= 1;
    }
}

/// A complete file that waits to be renamed. When dropped before that, it is removed.
#[derive(Debug)]
pub(super) enum Staged {
    /// An anonymous file. It gets a temporary name only if it cannot be linked to its target directly.
    Anonymous(AnonymousFile, Option<TemporaryName>),
    /// A file with a temporary name.
    Named(TemporaryName),
}

#[cfg(test)]
mod tests {
    use super::*;

    fn registry() -> &'static Registry {
        Box::leak(Box::new(Registry::new()))
    }

    fn count(folder: &Path) -> usize {
        fs::read_dir(folder).unwrap().count()
    }

    /// Creates two temporary names, as on a system without anonymous files.
    fn two(registry: &'static Registry, folder: &Path) -> [TemporaryName; 2] {
        [0, 1].map(|_| {
            let (path, _) = registry.state().temporary(folder, create_new).unwrap();
            TemporaryName { registry, path }
        })
    }

    #[test]
    fn new_folder_dropped_empty_is_removed() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("new");
        drop(NewFolder::create(&folder).unwrap());
        assert!(!folder.exists());
        NewFolder::create(&folder).unwrap().keep();
        drop(NewFolder::create(&folder).unwrap());
        assert!(folder.exists());
        let error = NewFolder::create(&dir.path().join("none/new")).unwrap_err().to_string();
        assert!(error.contains("none/new: cannot be written"), "{error}");
    }

    #[test]
    fn claim_last_temporary_name_dropped_is_removed() {
        let dir = tempfile::tempdir().unwrap();
        let registry = registry();
        let [a, b] = two(registry, dir.path());
        assert_eq!((count(dir.path()), super::super::sweep(dir.path())), (3, 0));
        drop(a);
        assert_eq!(count(dir.path()), 2);
        drop(b);
        assert_eq!((count(dir.path()), registry.state().claims.len()), (0, 0));
    }

    /// The number of complete files that stay open is limited; further complete files get temporary names under a
    /// claim.
    #[cfg(target_os = "linux")]
    #[test]
    fn complete_files_above_limit_are_closed_and_claimed() {
        let dir = tempfile::tempdir().unwrap();
        let registry = registry();
        // `tempfile_in` creates a file without a name (O_TMPFILE). If the file system cannot do this, `tempfile_in`
        // creates a file and deletes its name. Such a file cannot get a name again, so its content is copied to a new
        // file.
        let keep = || {
            let file = tempfile::tempfile_in(dir.path()).unwrap();
            TemporaryFile { registry, folder: dir.path().to_owned(), file, name: None }.stage().unwrap()
        };
        let held = keep();
        assert_eq!((count(dir.path()), registry.state().open_anonymous), (0, 1));
        // Pretend that the number of open files has reached the limit.
        registry.state().open_anonymous += anonymous::most();
        let named = keep();
        assert_eq!((count(dir.path()), super::super::sweep(dir.path())), (2, 0));
        registry.state().open_anonymous -= anonymous::most();
        drop((held, named));
        assert_eq!((count(dir.path()), registry.state().open_anonymous), (0, 0));
    }

    #[test]
    fn registry_abandoned_refuses_new_files_and_renames() {
        let dir = tempfile::tempdir().unwrap();
        let registry = registry();
        let target = dir.path().join("a.exr");
        let started = TemporaryFile::create(registry, dir.path(), &target).unwrap();
        let names = two(registry, dir.path());
        registry.abandon();
        assert_eq!(count(dir.path()), 0);
        for error in [
            TemporaryFile::create(registry, dir.path(), &target).map(|_| ()).unwrap_err(),
            registry.unless_abandoned(&target, |_| Ok(())).unwrap_err(),
        ] {
            assert!(matches!(&error, Error::Abandoned { path } if *path == target), "{error}");
        }
        drop((started.stage().unwrap(), names));
        assert_eq!((count(dir.path()), registry.state().open_anonymous), (0, 0));
    }
}
