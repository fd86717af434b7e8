//! Commit: all files of a run are completed and then renamed to their targets, or none of them is renamed.
//!
//! In: the paths of outputs, and bytes. Out: files at these paths. A [`Pending`] is a temporary file in the folder of
//! its target; [`commit`] completes and renames all files of a run. Cost: one fsync for each file, started when its
//! last byte is written.

use super::targets::folder_of;
use super::temporary::{PROCESS_REGISTRY, Registry, Staged, State, TemporaryFile};
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

/// A file that is being written to a temporary file in the folder of its target. When dropped, it is removed.
#[derive(Debug)]
pub struct Pending {
    target: PathBuf,
    file: BufWriter<Open>,
    /// The thread that syncs all data that were written before the thread was started.
    syncing: Option<JoinHandle<io::Result<()>>>,
}

/// The temporary file to which the buffer of [`Pending`] writes.
#[derive(Debug)]
struct Open(TemporaryFile);

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
    /// Creates the temporary file with the permissions of a new file: anonymous where the system supports it, otherwise
    /// hidden and named `.hdralign-*.part`.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Abandoned`] after [`abandon`](super::abandon).
    pub fn create(target: &Path) -> Result<Self> {
        Self::create_in(&PROCESS_REGISTRY, target)
    }

    fn create_in(registry: &'static Registry, target: &Path) -> Result<Self> {
        let file = Open(TemporaryFile::create(registry, folder_of(target), target)?);
        Ok(Pending { target: target.to_owned(), file: BufWriter::with_capacity(1 << 18, file), syncing: None })
    }

    /// Returns the path that the file will be renamed to.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Returns `source` as an error of this file.
    pub(crate) fn error(&self, source: io::Error) -> Error {
        write_error(&self.target, source)
    }

    /// Writes all of `bytes`.
    pub(crate) fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.write_all(bytes).map_err(|source| write_error(&self.target, source))
    }

    /// Starts to sync what is written so far and returns at once; [`complete`](Self::complete) waits for the sync.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub(crate) fn sync_ahead(&mut self) -> Result<()> {
        self.file.flush().map_err(|source| write_error(&self.target, source))?;
        // The thread sleeps in a system call and takes no core from the encoders. If no thread can be started,
        // `complete` syncs.
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

/// A complete, synced file that waits to be renamed to its target. When dropped, it is removed. If there are many
/// such files, only some of them stay open.
#[derive(Debug)]
pub struct CompleteFile {
    target: PathBuf,
    file: Staged,
}

impl CompleteFile {
    /// Returns the path that the file will be renamed to.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Opens the file for reading.
    ///
    /// # Errors
    /// The error of the system.
    pub fn open(&self) -> io::Result<fs::File> {
        self.file.open()
    }

    /// Removes from this file the permissions that the file `source` does not have.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn restrict(&self, source: &Path) -> Result<()> {
        self.file.restrict(source).map_err(|source| write_error(&self.target, source))
    }
}

impl Pending {
    /// Completes the file: waits until it is synced. The file is closed if it has a temporary name; an anonymous file
    /// stays open.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn complete(self) -> Result<CompleteFile> {
        let Pending { target, file, syncing } = self;
        let synced = file.into_inner().map_err(|e| e.into_error()).and_then(|Open(file)| {
            match syncing {
                Some(thread) => thread
                    .join()
                    .map_err(|_| io::Error::other("the thread that writes to the disk ended unexpectedly"))??,
                None => file.file().sync_all()?,
            }
            Ok(file)
        });
        let staged = synced.and_then(TemporaryFile::stage);
        let file = staged.map_err(|source| write_error(&target, source))?;
        Ok(CompleteFile { target, file })
    }
}

/// Commits `files`: completes every one, then renames all, as [`rename_all`] does.
///
/// # Errors
/// [`Error::OutputExists`] if a target exists now and `overwrite` is off; [`Error::Write`].
pub fn commit(files: Vec<Pending>, overwrite: bool) -> Result<()> {
    rename_all(files.into_iter().map(Pending::complete).collect::<Result<_>>()?, overwrite)
}

/// Renames `files` to their targets, in order. If the process is killed meanwhile, only the first files have been
/// renamed; so if none of the targets existed before and the last one exists, all exist. A file that replaces an older
/// file gets the permissions of the older file. If a rename fails, the files that were already renamed are removed
/// again. Exceptions are files that have replaced an older file, because the older file cannot be restored.
///
/// # Errors
/// [`Error::OutputExists`] if a target exists now and `overwrite` is off; [`Error::Write`]; [`Error::Abandoned`].
pub fn rename_all(mut files: Vec<CompleteFile>, overwrite: bool) -> Result<()> {
    let Some(first) = files.first() else { return Ok(()) };
    let (target, registry) = (first.target.clone(), first.file.registry());
    registry.unless_abandoned(&target, |state| rename_files(state, &mut files, overwrite))
}

/// Renames `files` under the lock of the registry.
fn rename_files(state: &mut State, files: &mut [CompleteFile], overwrite: bool) -> Result<()> {
    let is_there = |target: &Path| fs::symlink_metadata(target).is_ok();
    // Temporary names and permissions, which may fail, are set before the first older file is replaced.
    for CompleteFile { target, file } in files.iter_mut().filter(|file| overwrite && is_there(&file.target)) {
        file.prepare(state, target).map_err(|source| write_error(target, source))?;
    }
    let mut renamed = Renamed::default();
    files.iter_mut().try_for_each(|file| renamed.rename(state, file, overwrite)).inspect_err(|_| renamed.remove_new())
}

/// Files that have been renamed.
#[derive(Default)]
struct Renamed<'a> {
    /// Targets that did not exist before.
    new: Vec<&'a Path>,
    all: HashMap<Identity, &'a Path>,
}

impl<'a> Renamed<'a> {
    /// Renames `file` to its target.
    fn rename(
        &mut self,
        state: &mut State,
        CompleteFile { target, file }: &'a mut CompleteFile,
        overwrite: bool,
    ) -> Result<()> {
        let failed = |source: io::Error| match source.kind() {
            io::ErrorKind::AlreadyExists => Error::OutputExists { path: target.clone() },
            _ => write_error(target, source),
        };
        match file.rename_new(state, target) {
            Ok(()) => self.new.push(target),
            Err(error) if overwrite && error.kind() == io::ErrorKind::AlreadyExists => {
                // Two targets may be the same file, as on a case-insensitive file system.
                if let Some(other) = identity(target).and_then(|file| self.all.get(&file)) {
                    let reason = format!(
                        "it is the same file as {}, another result (perhaps their names differ only in upper and lower \
                         case, or one is a link to the other); choose another name",
                        other.display()
                    );
                    return Err(write_error(target, io::Error::new(io::ErrorKind::InvalidInput, reason)));
                }
                file.rename_over(state, target).map_err(failed)?;
            }
            Err(error) => return Err(failed(error)),
        }
        self.all.extend(identity(target).map(|file| (file, target.as_path())));
        Ok(())
    }

    /// Removes the files whose targets did not exist before.
    fn remove_new(&self) {
        for path in &self.new {
            // An error is ignored here, because it would hide the failure that is reported.
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
    fn commit_renames_all_files_and_drop_removes_them() {
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
    fn commit_target_exists_meanwhile_removes_the_other_files() {
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
    fn commit_overwrite_failure_keeps_replaced_files() {
        let dir = tempfile::tempdir().unwrap();
        let (a, b, c) = (dir.path().join("a.exr"), dir.path().join("b.exr"), dir.path().join("c.exr"));
        fs::write(&a, "old").unwrap();
        // There is a folder at the third name, so the third renaming fails after two have succeeded.
        fs::create_dir(&c).unwrap();
        let files = vec![pending(&a, "new"), pending(&b, "new"), pending(&c, "new")];
        assert!(matches!(commit(files, true).unwrap_err(), Error::Write { path, .. } if path == c));
        assert_eq!(names(dir.path()), ["a.exr", "c.exr"]);
        assert_eq!(fs::read_to_string(&a).unwrap(), "new");
    }

    /// A symbolic link gives one file two names, as a case-insensitive file system does.
    #[cfg(unix)]
    #[test]
    fn commit_two_targets_one_file_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("folder");
        fs::create_dir(&folder).unwrap();
        std::os::unix::fs::symlink(&folder, dir.path().join("alias")).unwrap();
        let (a, b) = (folder.join("a.exr"), dir.path().join("alias/a.exr"));
        let error = commit(vec![pending(&a, "one"), pending(&b, "two")], true).unwrap_err().to_string();
        assert!(error.contains("alias/a.exr") && error.contains("folder/a.exr, another result"), "{error}");
        assert_eq!(names(&folder).len(), 0);
    }

    #[cfg(unix)]
    #[test]
    fn commit_overwrite_keeps_the_permissions_of_the_replaced_file() {
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

    /// Several threads commit pairs of files when `abandon` is called: both files of a pair exist, or none.
    #[test]
    fn abandon_during_commits_leaves_complete_sets_only() {
        let dir = tempfile::tempdir().unwrap();
        let registry: &'static Registry = Box::leak(Box::new(Registry::new()));
        let at = |k: usize, i: usize, half: &str| dir.path().join(format!("{k}-{i}.{half}"));
        let work = |k: usize| -> usize {
            let mut named = 0;
            for i in 0.. {
                let pair = ["exr", "png"].map(|half| {
                    let mut file = Pending::create_in(registry, &at(k, i, half))?;
                    file.put(half.as_bytes()).map(|()| file)
                });
                let pair = pair.into_iter().collect::<Result<Vec<_>>>();
                match pair.and_then(|pair| commit(pair, false)) {
                    Ok(()) => named += 1,
                    Err(Error::Abandoned { .. }) => return named,
                    // No other error may occur.
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
    fn error_names_the_target_and_not_the_temporary_file() {
        let dir = tempfile::tempdir().unwrap();
        let error = Pending::create(&dir.path().join("gone/a.exr")).unwrap_err().to_string();
        assert!(error.contains("gone/a.exr") && !error.contains(".hdralign-"), "{error}");
        // The folder is removed while the file is written, as if a disk were removed.
        let folder = dir.path().join("sub");
        fs::create_dir(&folder).unwrap();
        let file = pending(&folder.join("a.exr"), "A");
        fs::remove_dir_all(&folder).unwrap();
        let error = commit(vec![file], true).unwrap_err().to_string();
        assert!(error.contains("sub/a.exr: cannot be written") && !error.contains(".hdralign-"), "{error}");
    }

    /// Data written after the sync was started are also in the file.
    #[test]
    fn sync_ahead_before_the_last_byte_keeps_all_bytes() {
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
    fn commit_new_file_has_default_permissions() {
        use std::os::unix::fs::PermissionsExt;
        let dir = tempfile::tempdir().unwrap();
        let (ours, plain) = (dir.path().join("a.exr"), dir.path().join("plain"));
        commit(vec![pending(&ours, "A")], false).unwrap();
        fs::write(&plain, "B").unwrap();
        let mode = |p: &Path| fs::metadata(p).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&plain));
    }
}
