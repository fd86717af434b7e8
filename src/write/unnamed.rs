//! Unnamed: files that are being written, or are whole but not yet named, and what becomes of them when a run ends too early.
//!
//! In: the target of a file. Out: an [`Unnamed`], hidden beside it as `.hdralign-*.part`, and locked for as long as its process lives. A process
//! that is told to end removes its own ([`abandon`]); of one that was killed another removes them ([`sweep`]): they are those that nobody
//! holds a lock on. Cost: a lock is one call of the system.

use crate::error::{Error, Result};
use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use tempfile::{NamedTempFile, TempPath};

const PREFIX: &str = ".hdralign-";
const SUFFIX: &str = ".part";

/// Files that are whole and kept open for their lock, at most: processes may have a few hundred open.
const HELD: usize = 100;

/// How often another file is begun in place of one that was swept before it was locked.
const TRIES: usize = 16;

/// The unnamed files of a process.
#[derive(Debug)]
pub(super) struct Registry(Mutex<State>);

#[derive(Debug)]
struct State {
    is_abandoned: bool,
    paths: BTreeSet<PathBuf>,
    /// Folders that were made for them.
    folders: BTreeSet<PathBuf>,
    /// How many whole files are kept open.
    held: usize,
}

/// Those of this process.
pub(super) static OF_PROCESS: Registry = Registry::new();

impl Registry {
    pub const fn new() -> Self {
        Registry(Mutex::new(State { is_abandoned: false, paths: BTreeSet::new(), folders: BTreeSet::new(), held: 0 }))
    }

    /// What it holds is sound after every statement: a thread that panicked leaves nothing half-done.
    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// See [`abandon`].
    pub fn abandon(&self) {
        let mut state = self.state();
        state.is_abandoned = true;
        for path in std::mem::take(&mut state.paths) {
            // It may be gone already, and there is nobody to tell.
            let _ = fs::remove_file(path);
        }
        for folder in std::mem::take(&mut state.folders) {
            // One that is not empty stays.
            let _ = fs::remove_dir(folder);
        }
    }

    /// `naming`, which gives files their names, as a whole before or after the registry is abandoned; not at all after it.
    ///
    /// # Errors
    /// [`Error::Abandoned`], with the name of `target`; those of `naming`.
    pub fn unless_abandoned<R>(&self, target: &Path, naming: impl FnOnce() -> Result<R>) -> Result<R> {
        let state = self.state();
        if state.is_abandoned {
            return Err(Error::Abandoned { path: target.to_owned() });
        }
        let named = naming();
        drop(state);
        named
    }
}

/// Gives up what this process writes: removes its files that have no name yet. From then on none is begun and none is named. A set of files that
/// is being named just now gets all its names first. Any thread may call it at any time, as when the user interrupts the program; a handler
/// that runs within a signal may not, for it waits for a lock.
pub fn abandon() {
    OF_PROCESS.abandon();
}

/// Removes the unnamed files that processes left in `folder` when they were killed, and tells how many. Those that a living process writes
/// are locked, and stay; where the file system knows no locks, all stay. Where locks do not reach other machines (Lustre's `localflock`),
/// it must not run beside another machine that writes there: that one would fail to name its files.
pub fn sweep(folder: &Path) -> usize {
    let Ok(entries) = fs::read_dir(folder) else { return 0 };
    let is_unnamed = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        name.starts_with(PREFIX) && name.ends_with(SUFFIX)
    };
    entries.flatten().map(|entry| entry.path()).filter(is_unnamed).filter(|path| sweep_one(path)).count()
}

/// Whether the file was nobody's, and is gone.
fn sweep_one(path: &Path) -> bool {
    // A lock on NFS needs a file that may be written; a link is none of ours.
    let is_file = fs::symlink_metadata(path).is_ok_and(|there| there.is_file());
    let file = if is_file { OpenOptions::new().write(true).open(path).ok() } else { None };
    file.is_some_and(|file| file.try_lock().is_ok() && fs::remove_file(path).is_ok())
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

/// A temporary file, open and locked; dropped, it is gone.
#[derive(Debug)]
pub(super) struct Unnamed {
    file: NamedTempFile,
    entry: Entry,
}

/// A file's place in the registry. It is dropped after the file is gone, or has its name.
#[derive(Debug)]
pub(super) struct Entry {
    registry: &'static Registry,
    path: PathBuf,
    is_held: bool,
}

impl Entry {
    pub fn registry(&self) -> &'static Registry {
        self.registry
    }
}

impl Drop for Entry {
    fn drop(&mut self) {
        let mut state = self.registry.state();
        state.paths.remove(&self.path);
        state.held -= usize::from(self.is_held);
    }
}

/// A file that is whole; dropped, it is gone.
#[derive(Debug)]
pub(super) struct Kept {
    pub path: TempPath,
    /// For its lock, where there are not too many.
    pub file: Option<File>,
    pub entry: Entry,
}

impl Unnamed {
    /// Begins one in `folder`, for `target`, with the permissions that a new file would have.
    ///
    /// # Errors
    /// [`Error::Write`], [`Error::Abandoned`].
    pub fn create(registry: &'static Registry, folder: &Path, target: &Path) -> Result<Self> {
        let mut state = registry.state();
        if state.is_abandoned {
            return Err(Error::Abandoned { path: target.to_owned() });
        }
        let file = locked_in(folder).map_err(|source| Error::Write { path: target.to_owned(), source })?;
        let path = file.path().to_owned();
        state.paths.insert(path.clone());
        Ok(Unnamed { file, entry: Entry { registry, path, is_held: false } })
    }

    pub fn file(&self) -> &File {
        self.file.as_file()
    }

    pub fn file_mut(&mut self) -> &mut File {
        self.file.as_file_mut()
    }

    /// The same, when it is whole.
    pub fn keep(self) -> Kept {
        let Unnamed { file, mut entry } = self;
        let (file, path) = file.into_parts();
        let mut state = entry.registry.state();
        entry.is_held = state.held < HELD;
        state.held += usize::from(entry.is_held);
        drop(state);
        Kept { path, file: entry.is_held.then_some(file), entry }
    }
}

/// A temporary file in `folder` that has its lock, where there are locks.
fn locked_in(folder: &Path) -> io::Result<NamedTempFile> {
    let open = |path: &Path| {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create_new(true);
        // Temporary files are private by default; asked for rw-rw-rw-, the system takes off the umask as for any new file.
        #[cfg(unix)]
        std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o666);
        options.open(path)
    };
    for _ in 0..TRIES {
        let file = tempfile::Builder::new().prefix(PREFIX).suffix(SUFFIX).make_in(folder, open)?;
        match file.as_file().try_lock() {
            Ok(()) if file.path().exists() => return Ok(file),
            // A sweep saw it before it was locked, and removes it, or has done so.
            Ok(()) | Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(_)) => return Ok(file),
        }
    }
    Err(io::Error::other("temporary files disappear from the folder as soon as they are made"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn registry() -> &'static Registry {
        Box::leak(Box::new(Registry::new()))
    }

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_sweep_takes_what_nobody_holds_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let others = [".hdralign-a.txt", "a.part", "hdralign-a.part"];
        for name in others.iter().chain(&[".hdralign-dead.part", ".hdralign-2.part"]) {
            fs::write(at(name), "x").unwrap();
        }
        fs::create_dir(at(".hdralign-folder.part")).unwrap();
        let target = at("a.exr");
        let written = Unnamed::create(registry(), dir.path(), &target).unwrap();
        let whole = Unnamed::create(registry(), dir.path(), &target).unwrap().keep();
        assert_eq!(names(dir.path()).len(), 8);
        assert_eq!(sweep(dir.path()), 2);
        assert!(written.file.path().exists() && whole.path.exists(), "they are being written");
        drop((written, whole));
        assert_eq!(names(dir.path()), [".hdralign-a.txt", ".hdralign-folder.part", "a.part", "hdralign-a.part"]);
        assert_eq!((sweep(dir.path()), sweep(&at("nowhere"))), (0, 0));
    }

    /// Sweeps that run all the time take no file from those who make them.
    #[test]
    fn files_that_are_begun_during_a_sweep_are_there() {
        let dir = tempfile::tempdir().unwrap();
        let (folder, registry) = (dir.path(), registry());
        std::thread::scope(|scope| {
            let begin = || (0..100).map(|_| Unnamed::create(registry, folder, folder)).collect::<Result<Vec<_>>>();
            let making = [scope.spawn(begin), scope.spawn(begin)];
            let mut swept = 0;
            while !making.iter().all(|thread| thread.is_finished()) {
                swept += sweep(folder);
            }
            let made: Vec<Unnamed> = making.into_iter().flat_map(|thread| thread.join().unwrap().unwrap()).collect();
            assert!(made.iter().all(|file| file.file.path().exists()), "{swept} swept");
            assert_eq!((made.len(), names(folder).len(), sweep(folder)), (200, 200, 0));
        });
        assert!(registry.state().paths.is_empty() && names(folder).is_empty());
    }

    #[test]
    fn a_folder_made_in_vain_goes_again() {
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
    fn few_whole_files_are_kept_open() {
        let dir = tempfile::tempdir().unwrap();
        let registry = registry();
        let create = || Unnamed::create(registry, dir.path(), dir.path()).unwrap().keep();
        let mut whole: Vec<Kept> = (0..HELD + 5).map(|_| create()).collect();
        assert_eq!(whole.iter().filter(|kept| kept.file.is_some()).count(), HELD);
        whole.truncate(HELD - 1);
        assert!(create().file.is_some(), "there is room again");
        drop(whole);
        assert_eq!(registry.state().held, 0);
    }

    #[test]
    fn nothing_is_begun_or_named_after_the_end() {
        let dir = tempfile::tempdir().unwrap();
        let registry = registry();
        let target = dir.path().join("a.exr");
        let kept = [Unnamed::create(registry, dir.path(), &target).unwrap()];
        registry.abandon();
        assert!(names(dir.path()).is_empty());
        for error in [
            Unnamed::create(registry, dir.path(), &target).map(|_| ()).unwrap_err(),
            registry.unless_abandoned(&target, || Ok(())).unwrap_err(),
        ] {
            assert!(matches!(&error, Error::Abandoned { path } if *path == target), "{error}");
        }
        drop(kept);
    }
}
