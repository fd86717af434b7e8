//! Targets: from the name of an output to a whole file of that name, or none at all.
//!
//! In: paths. Out: a [`Pending`] is the temporary file in the target's folder; [`commit`] names all of a run when all are whole.
//! Cost: one fsync a file, begun when the file has its last byte.

use super::targets::folder_of;
use super::temporary::{Kept, OF_PROCESS, Registry, State, Unnamed};
use crate::error::{Error, Result};
use crate::intake::{Identity, identity};
use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

fn write_error(path: &Path, source: io::Error) -> Error {
    Error::Write { path: path.to_owned(), source }
}

/// A file that is being written in the target's own folder, without its name; dropped, it is gone.
#[derive(Debug)]
pub struct Pending {
    target: PathBuf,
    file: BufWriter<Open>,
    /// A thread that brings to the disk what was written until it began.
    syncing: Option<JoinHandle<io::Result<()>>>,
}

/// What the buffer writes to.
#[derive(Debug)]
struct Open(Unnamed);

impl Write for Open {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.file_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.file_mut().flush()
    }
}

impl Seek for Open {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.file_mut().seek(to)
    }
}

impl Pending {
    /// Opens the temporary file, with the permissions that a new file has: without any name where the system has such files, else hidden and named
    /// `.hdralign-*.part`.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Abandoned`] after [`abandon`](super::abandon).
    pub fn create(target: &Path) -> Result<Self> {
        Self::create_by(&OF_PROCESS, target)
    }

    fn create_by(registry: &'static Registry, target: &Path) -> Result<Self> {
        let file = Open(Unnamed::create(registry, folder_of(target), target)?);
        Ok(Pending { target: target.to_owned(), file: BufWriter::with_capacity(1 << 18, file), syncing: None })
    }

    /// The name it will have.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// What the system said, as this file's error.
    pub(crate) fn error(&self, source: io::Error) -> Error {
        write_error(&self.target, source)
    }

    /// Writes all of `bytes`.
    pub(crate) fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.write_all(bytes).map_err(|source| write_error(&self.target, source))
    }

    /// Begins to bring to the disk what is written so far, and returns at once: [`complete`](Self::complete) waits for it.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub(crate) fn sync_ahead(&mut self) -> Result<()> {
        self.file.flush().map_err(|source| write_error(&self.target, source))?;
        // The thread sleeps in the system, and so takes no core from those that encode. Without one, complete() does its work.
        let thread =
            |file: File| std::thread::Builder::new().name("hdralign sync".into()).spawn(move || file.sync_all());
        self.syncing = self.file.get_ref().0.file().try_clone().and_then(thread).ok();
        Ok(())
    }
}

impl Write for Pending {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.syncing = None;
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Pending {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// A file that is complete and on the disk, without its name; dropped, it is gone. Of many only some are open.
#[derive(Debug)]
pub struct Whole {
    target: PathBuf,
    file: Kept,
}

impl Whole {
    /// The name it will have.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Its bytes, to be read.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(&self) -> io::Result<fs::File> {
        self.file.open()
    }

    /// Takes the permissions away that the file `source` does not have.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn restrict(&self, source: &Path) -> Result<()> {
        self.file.restrict(source).map_err(|source| write_error(&self.target, source))
    }
}

impl Pending {
    /// Ends the file: everything is brought to the disk, and it is closed.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn complete(self) -> Result<Whole> {
        let Pending { target, file, syncing } = self;
        let synced = file.into_inner().map_err(|e| e.into_error()).and_then(|Open(file)| {
            match syncing {
                Some(thread) => {
                    thread.join().map_err(|_| io::Error::other("the thread that waits for the disk died"))??
                }
                None => file.file().sync_all()?,
            }
            Ok(file)
        });
        let kept = synced.and_then(Unnamed::keep);
        let file = kept.map_err(|source| write_error(&target, source))?;
        Ok(Whole { target, file })
    }
}

/// Gives all `files` their names: first every one is brought to the disk, then all are renamed, as [`place`] does.
///
/// # Errors
/// [`Error::OutputExists`] where a target has appeared meanwhile and `overwrite` is off; [`Error::Write`].
pub fn commit(files: Vec<Pending>, overwrite: bool) -> Result<()> {
    place(files.into_iter().map(Pending::complete).collect::<Result<_>>()?, overwrite)
}

/// Gives all `files` their names, in their order: of a process that is killed meanwhile the first ones have theirs, so that the last may vouch for
/// all. A file that replaces another has its permissions. When a renaming fails, the files placed before it are removed again, but for those
/// that replaced an older file, which cannot be had back.
///
/// # Errors
/// [`Error::OutputExists`] where a target has appeared meanwhile and `overwrite` is off; [`Error::Write`]; [`Error::Abandoned`].
pub fn place(mut files: Vec<Whole>, overwrite: bool) -> Result<()> {
    let Some(first) = files.first() else { return Ok(()) };
    let (target, registry) = (first.target.clone(), first.file.registry());
    registry.unless_abandoned(&target, |state| name(state, &mut files, overwrite))
}

/// The naming.
fn name(state: &mut State, files: &mut [Whole], overwrite: bool) -> Result<()> {
    let is_there = |target: &Path| fs::symlink_metadata(target).is_ok();
    // All that may fail before the first older file is replaced is done before.
    for Whole { target, file } in files.iter_mut().filter(|file| overwrite && is_there(&file.target)) {
        file.prepare(state, target).map_err(|source| write_error(target, source))?;
    }
    let mut placed = Placed::default();
    files.iter_mut().try_for_each(|file| placed.place(state, file, overwrite)).inspect_err(|_| placed.withdraw())
}

/// Files that have their names.
#[derive(Default)]
struct Placed<'a> {
    /// Those whose names were free.
    new: Vec<&'a Path>,
    all: HashMap<Identity, &'a Path>,
}

impl<'a> Placed<'a> {
    /// Gives `file` its name.
    fn place(&mut self, state: &mut State, Whole { target, file }: &'a mut Whole, overwrite: bool) -> Result<()> {
        let failed = |source: io::Error| match source.kind() {
            io::ErrorKind::AlreadyExists => Error::OutputExists { path: target.clone() },
            _ => write_error(target, source),
        };
        match file.name(state, target) {
            Ok(()) => self.new.push(target),
            Err(error) if overwrite && error.kind() == io::ErrorKind::AlreadyExists => {
                // As where a file system does not tell cases apart.
                if let Some(other) = identity(target).and_then(|file| self.all.get(&file)) {
                    let reason = format!("{} is the same file there; give it another name", other.display());
                    return Err(write_error(target, io::Error::new(io::ErrorKind::InvalidInput, reason)));
                }
                file.replace(state, target).map_err(failed)?;
            }
            Err(error) => return Err(failed(error)),
        }
        self.all.extend(identity(target).map(|file| (file, target.as_path())));
        Ok(())
    }

    /// Removes the new ones.
    fn withdraw(&self) {
        for path in &self.new {
            // The first failure is the one to report; a second while clearing up would only hide it.
            let _ = fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    fn pending(target: &Path, text: &str) -> Pending {
        let mut file = Pending::create(target).unwrap();
        file.write_all(text.as_bytes()).unwrap();
        file
    }

    #[test]
    fn names_appear_together_and_drops_leave_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let (a, b) = (dir.path().join("a.exr"), dir.path().join("b.png"));
        let files = vec![pending(&a, "A"), pending(&b, "B")];
        assert!(!a.exists() && !b.exists());
        drop(pending(&a, "never"));
        commit(files, false).unwrap();
        assert_eq!(names(dir.path()), ["a.exr", "b.png"]);
        assert_eq!(fs::read_to_string(&b).unwrap(), "B");
    }

    #[test]
    fn a_target_that_appears_meanwhile_is_kept_and_the_rest_withdrawn() {
        let dir = tempfile::tempdir().unwrap();
        let (a, b) = (dir.path().join("a.exr"), dir.path().join("b.exr"));
        let files = vec![pending(&a, "new"), pending(&b, "new")];
        fs::write(&b, "old").unwrap();
        let error = commit(files, false).unwrap_err();
        assert!(matches!(error, Error::OutputExists { path } if path == b));
        assert_eq!(names(dir.path()), ["b.exr"]);
        assert_eq!(fs::read_to_string(&b).unwrap(), "old");
    }

    #[test]
    fn force_replaces_but_never_withdraws_what_was_there() {
        let dir = tempfile::tempdir().unwrap();
        let (a, b, c) = (dir.path().join("a.exr"), dir.path().join("b.exr"), dir.path().join("c.exr"));
        fs::write(&a, "old").unwrap();
        // A folder at the third name makes its renaming fail after two have succeeded.
        fs::create_dir(&c).unwrap();
        let files = vec![pending(&a, "new"), pending(&b, "new"), pending(&c, "new")];
        assert!(matches!(commit(files, true).unwrap_err(), Error::Write { path, .. } if path == c));
        assert_eq!(names(dir.path()), ["a.exr", "c.exr"]);
        assert_eq!(fs::read_to_string(&a).unwrap(), "new");
    }

    /// As two names of one file where cases are not told apart.
    #[cfg(unix)]
    #[test]
    fn two_targets_that_are_one_file_are_refused_when_they_are_named() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("folder");
        fs::create_dir(&folder).unwrap();
        std::os::unix::fs::symlink(&folder, dir.path().join("alias")).unwrap();
        let (a, b) = (folder.join("a.exr"), dir.path().join("alias/a.exr"));
        let error = commit(vec![pending(&a, "one"), pending(&b, "two")], true).unwrap_err().to_string();
        assert!(error.contains("alias/a.exr") && error.contains("folder/a.exr is the same file there"), "{error}");
        assert_eq!(names(&folder).len(), 0);
    }

    #[cfg(unix)]
    #[test]
    fn replacement_keeps_the_permissions_of_the_file_replaced() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let a = dir.path().join("a.exr");
        for mode in [0o600, 0o444, 0o666] {
            fs::write(&a, "old").unwrap();
            fs::set_permissions(&a, fs::Permissions::from_mode(mode)).unwrap();
            commit(vec![pending(&a, "new")], true).unwrap();
            assert_eq!(fs::metadata(&a).unwrap().permissions().mode() & 0o777, mode);
            assert_eq!(fs::read_to_string(&a).unwrap(), "new");
            fs::remove_file(&a).unwrap();
        }
    }

    /// While pairs are written and named by several threads, the end comes: each pair is there as a whole or not at all.
    #[test]
    fn the_end_leaves_no_half_of_a_run() {
        let dir = tempfile::tempdir().unwrap();
        let registry: &'static Registry = Box::leak(Box::new(Registry::new()));
        let at = |k: usize, i: usize, half: &str| dir.path().join(format!("{k}-{i}.{half}"));
        let work = |k: usize| -> usize {
            let mut named = 0;
            for i in 0.. {
                let pair = ["exr", "png"].map(|half| {
                    let mut file = Pending::create_by(registry, &at(k, i, half))?;
                    file.put(half.as_bytes()).map(|()| file)
                });
                let pair = pair.into_iter().collect::<Result<Vec<_>>>();
                match pair.and_then(|pair| commit(pair, false)) {
                    Ok(()) => named += 1,
                    Err(Error::Abandoned { .. }) => return named,
                    // Nothing else may go wrong.
                    Err(error) => panic!("{error}"),
                }
            }
            named
        };
        let named: Vec<usize> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..3).map(|k| scope.spawn(move || work(k))).collect();
            while !at(0, 3, "png").exists() {
                std::thread::yield_now();
            }
            registry.abandon();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        let mut expected = Vec::new();
        for (k, &count) in named.iter().enumerate() {
            expected.extend((0..count).flat_map(|i| [format!("{k}-{i}.exr"), format!("{k}-{i}.png")]));
        }
        expected.sort();
        assert!(named[0] > 3 && names(dir.path()) == expected, "{named:?}");
        assert!((0..named[0]).all(|i| fs::read_to_string(at(0, i, "png")).unwrap() == "png"));
    }

    #[test]
    fn an_error_names_the_target_and_not_the_temporary_file() {
        let dir = tempfile::tempdir().unwrap();
        let error = Pending::create(&dir.path().join("gone/a.exr")).unwrap_err().to_string();
        assert!(error.contains("gone/a.exr") && !error.contains(".hdralign-"), "{error}");
        // The folder goes while the file is written, as when a disk is taken away.
        let folder = dir.path().join("sub");
        fs::create_dir(&folder).unwrap();
        let file = pending(&folder.join("a.exr"), "A");
        fs::remove_dir_all(&folder).unwrap();
        let error = commit(vec![file], true).unwrap_err().to_string();
        assert!(error.contains("sub/a.exr: cannot be written") && !error.contains(".hdralign-"), "{error}");
    }

    /// What is written after the disk was sent the rest is in the file as well.
    #[test]
    fn syncing_ahead_may_be_early() {
        let dir = tempfile::tempdir().unwrap();
        let a = dir.path().join("a.exr");
        let mut file = pending(&a, "one");
        file.sync_ahead().unwrap();
        assert!(file.syncing.is_some());
        file.put(b" two").unwrap();
        assert!(file.syncing.is_none(), "the end is not on the disk");
        file.sync_ahead().unwrap();
        commit(vec![file], false).unwrap();
        assert_eq!(fs::read_to_string(&a).unwrap(), "one two");
    }

    #[cfg(unix)]
    #[test]
    fn permissions_are_those_of_any_new_file() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let (ours, plain) = (dir.path().join("a.exr"), dir.path().join("plain"));
        commit(vec![pending(&ours, "A")], false).unwrap();
        fs::write(&plain, "B").unwrap();
        let mode = |p: &Path| fs::metadata(p).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&plain));
    }
}
