//! Unnamed: files that are being written, or are complete but not yet named, and what becomes of them when a run ends too early.
//!
//! In: the target of a file. Out: an [`Unnamed`], later a [`Kept`], in the target's folder: an [anonymous] file where the
//! system has them, else one with a temporary name that a [claim](super::claim) protects. A process that is told to end removes its own
//! ([`abandon`]). Cost: that of the files; of complete ones none is open but anonymous ones, and of those no more than
//! [`most`](anonymous::most).

use super::anonymous;
use super::claim::Claim;
use crate::error::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Seek};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The unnamed files of a process.
#[derive(Debug)]
pub(super) struct Registry(Mutex<State>);

#[derive(Debug)]
pub(super) struct State {
    is_abandoned: bool,
    /// Temporary names by their folders; none is empty.
    claims: BTreeMap<PathBuf, Claim>,
    /// Folders that were made for them.
    folders: BTreeSet<PathBuf>,
    /// How many complete files are kept open.
    held: usize,
}

/// Those of this process.
pub(super) static OF_PROCESS: Registry = Registry::new();

impl Registry {
    pub const fn new() -> Self {
        Registry(Mutex::new(State { is_abandoned: false, claims: BTreeMap::new(), folders: BTreeSet::new(), held: 0 }))
    }

    /// What it holds is sound after every statement: a thread that panicked leaves nothing half-done.
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// See [`abandon`].
    pub fn abandon(&self) {
        let mut state = self.state();
        state.is_abandoned = true;
        state.claims.clear();
        for folder in std::mem::take(&mut state.folders) {
            // One that is not empty stays.
            let _ = fs::remove_dir(folder);
        }
    }

    /// `naming`, which gives files their names, as a whole before or after the registry is abandoned; not at all after it. It drops no file.
    ///
    /// # Errors
    /// [`Error::Abandoned`], with the name of `target`; those of `naming`.
    pub fn unless_abandoned<R>(&self, target: &Path, naming: impl FnOnce(&mut State) -> Result<R>) -> Result<R> {
        let mut state = self.state();
        if state.is_abandoned {
            return Err(Error::Abandoned { path: target.to_owned() });
        }
        naming(&mut state)
    }
}

impl State {
    /// A temporary name in `folder`, and what `make` makes of it.
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

    /// A temporary name in `folder` of the anonymous `file`; where it cannot have one, of a copy.
    pub fn temporary_of(&mut self, folder: &Path, file: &File) -> io::Result<PathBuf> {
        let make = |path: &Path| anonymous::link(file, path).or_else(|_| copy(file, path));
        Ok(self.temporary(folder, make)?.0)
    }

    /// Removes a temporary name, and its file if it is there; with the last one in a folder the claim goes.
    fn release(&mut self, path: &Path) {
        let folder = path.parent().unwrap_or(path);
        if self.claims.get_mut(folder).is_some_and(|claim| claim.remove(path)) {
            self.claims.remove(folder);
        }
    }
}

/// Gives up what this process writes: removes its files that have no name yet. From then on none is begun and none is named. A set of files that
/// is being named just now gets all its names first. Any thread may call it at any time, as when the user interrupts the program; a handler
/// that runs within a signal may not, for it waits for a lock.
pub fn abandon() {
    OF_PROCESS.abandon();
}

/// A folder for files that have no names yet. Dropped, it goes again if it was made here and is empty; so it does when the process gives up.
#[derive(Debug)]
pub struct NewFolder(Option<PathBuf>);

impl NewFolder {
    /// Makes `folder`, unless it is there.
    ///
    /// # Errors
    /// [`Error::Write`], [`Error::Abandoned`].
    pub fn create(folder: &Path) -> Result<Self> {
        let mut state = OF_PROCESS.state();
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

    /// It stays.
    pub fn keep(mut self) {
        if let Some(folder) = self.0.take() {
            OF_PROCESS.state().folders.remove(&folder);
        }
    }
}

impl Drop for NewFolder {
    fn drop(&mut self) {
        if let Some(folder) = self.0.take() {
            OF_PROCESS.state().folders.remove(&folder);
            // What went wrong before is what is told; a folder that is not empty stays.
            let _ = fs::remove_dir(folder);
        }
    }
}

/// A temporary name. Dropped, it is free again, and a file that still has it is gone.
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

/// A file that is being written; dropped, it is gone.
#[derive(Debug)]
pub(super) struct Unnamed {
    registry: &'static Registry,
    folder: PathBuf,
    file: File,
    /// None of an anonymous file.
    name: Option<TemporaryName>,
}

impl Unnamed {
    /// Begins one in `folder`, for `target`, with the permissions that a new file has.
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
            Ok(Unnamed { registry, folder: folder.to_owned(), file, name })
        })
    }

    pub fn file(&self) -> &File {
        &self.file
    }

    pub fn file_mut(&mut self) -> &mut File {
        &mut self.file
    }

    /// The same, when it is complete.
    ///
    /// # Errors
    /// What the system says where it must have a temporary name.
    pub fn keep(self) -> io::Result<Kept> {
        let Unnamed { registry, folder, file, name } = self;
        if let Some(name) = name {
            return Ok(Kept::Named(name));
        }
        let mut state = registry.state();
        // After the end there are no names any more.
        if state.held < anonymous::most() || state.is_abandoned {
            state.held += 1;
            drop(state);
            return Ok(Kept::Held(Held { registry, folder, file }, None));
        }
        let path = state.temporary_of(&folder, &file)?;
        drop(state);
        Ok(Kept::Named(TemporaryName { registry, path }))
    }
}

fn create_new(path: &Path) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).create_new(true).open(path)
}

/// Copies `file` to the new file `path`, up to the disk.
fn copy(mut file: &File, path: &Path) -> io::Result<()> {
    file.rewind()?;
    let mut copy = create_new(path)?;
    io::copy(&mut file, &mut copy)?;
    copy.sync_all()
}

/// An anonymous file that is complete; dropped, it is gone.
#[derive(Debug)]
pub(super) struct Held {
    pub registry: &'static Registry,
    pub folder: PathBuf,
    pub file: File,
}

impl Drop for Held {
    fn drop(&mut self) {
        self.registry.state().held -= 1;
    }
}

/// A file that is complete; dropped before it has its name, it is gone.
#[derive(Debug)]
pub(super) enum Kept {
    /// An anonymous file, and the temporary name that it has where it cannot get its own at once.
    Held(Held, Option<TemporaryName>),
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

    /// Two temporary names, as where there are no anonymous files.
    fn two(registry: &'static Registry, folder: &Path) -> [TemporaryName; 2] {
        [0, 1].map(|_| {
            let (path, _) = registry.state().temporary(folder, create_new).unwrap();
            TemporaryName { registry, path }
        })
    }

    #[test]
    fn folder_made_in_vain_is_removed() {
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
    fn claim_goes_with_the_last_temporary_name_of_its_folder() {
        let dir = tempfile::tempdir().unwrap();
        let registry = registry();
        let [a, b] = two(registry, dir.path());
        assert_eq!((count(dir.path()), super::super::sweep(dir.path())), (3, 0));
        drop(a);
        assert_eq!(count(dir.path()), 2);
        drop(b);
        assert_eq!((count(dir.path()), registry.state().claims.len()), (0, 0));
    }

    /// Of many complete files no more are open than the process may well have, and the others keep their claim.
    #[cfg(target_os = "linux")]
    #[test]
    fn complete_files_beyond_the_limit_are_closed_and_claimed() {
        let dir = tempfile::tempdir().unwrap();
        let registry = registry();
        // An unlinked file stands for an anonymous one, which not every file system has: it gets its name by a copy.
        let keep = || {
            let file = tempfile::tempfile_in(dir.path()).unwrap();
            Unnamed { registry, folder: dir.path().to_owned(), file, name: None }.keep().unwrap()
        };
        let held = keep();
        assert_eq!((count(dir.path()), registry.state().held), (0, 1));
        // As if so many more were open.
        registry.state().held += anonymous::most();
        let named = keep();
        assert_eq!((count(dir.path()), super::super::sweep(dir.path())), (2, 0));
        registry.state().held -= anonymous::most();
        drop((held, named));
        assert_eq!((count(dir.path()), registry.state().held), (0, 0));
    }

    #[test]
    fn nothing_is_begun_or_named_after_the_end() {
        let dir = tempfile::tempdir().unwrap();
        let registry = registry();
        let target = dir.path().join("a.exr");
        let begun = Unnamed::create(registry, dir.path(), &target).unwrap();
        let names = two(registry, dir.path());
        registry.abandon();
        assert_eq!(count(dir.path()), 0);
        for error in [
            Unnamed::create(registry, dir.path(), &target).map(|_| ()).unwrap_err(),
            registry.unless_abandoned(&target, |_| Ok(())).unwrap_err(),
        ] {
            assert!(matches!(&error, Error::Abandoned { path } if *path == target), "{error}");
        }
        drop((begun.keep().unwrap(), names));
        assert_eq!((count(dir.path()), registry.state().held), (0, 0));
    }
}
