//! Targets: from the name of an output to a whole file of that name, or none at all.
//!
//! In: paths. Out: [`check_targets`] says before any work whether they can be written; a [`Pending`] is the temporary file beside the
//! target; [`commit`] renames all of a run when all are whole. Cost: one fsync a file, begun when the file has its last byte.

use super::unnamed::{Kept, OF_PROCESS, Registry, Unnamed};
use crate::error::{Error, Result};
use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;
use tempfile::TempPath;

/// Whether all `outputs` can be written, before any work is done: folders that exist, no name twice, none of the
/// `inputs`, and nothing there already unless `overwrite`.
///
/// # Errors
/// [`Error::Option`] for a name given twice or an input, [`Error::Write`] for a folder that is missing or
/// a target that is one, [`Error::OutputExists`].
pub fn check_targets(outputs: &[PathBuf], inputs: &[PathBuf], overwrite: bool) -> Result<()> {
    let sources: Vec<PathBuf> = inputs.iter().filter_map(|p| fs::canonicalize(p).ok()).collect();
    let mut places: Vec<PathBuf> = Vec::new();
    for output in outputs {
        let place = place_of(output)?;
        let real = fs::canonicalize(output).unwrap_or_else(|_| place.clone());
        if sources.contains(&real) {
            return Err(usage(output, "is one of the files that are read; give the result another name"));
        }
        if places.contains(&place) {
            return Err(usage(output, "is named twice; give every output a name of its own"));
        }
        match fs::symlink_metadata(&place) {
            Ok(there) if there.is_dir() => return Err(refused(output, "it is a folder; name a file in it".into())),
            Ok(_) if !overwrite => return Err(Error::OutputExists { path: output.clone() }),
            _ => places.push(place),
        }
    }
    Ok(())
}

/// The target with its folder resolved, so that two ways to say one name are seen to be one.
fn place_of(output: &Path) -> Result<PathBuf> {
    let folder = folder_of(output);
    let remedy = match fs::metadata(folder) {
        Ok(there) if there.is_dir() => None,
        Ok(_) => Some(format!("{} is not a folder; name one that is", folder.display())),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Some(format!(
            "the folder {} does not exist; make it first, as in `mkdir -p {}`",
            folder.display(),
            folder.display()
        )),
        Err(e) => Some(format!("the folder {} cannot be entered: {e}", folder.display())),
    };
    if let Some(remedy) = remedy {
        return Err(refused(output, remedy));
    }
    let folder = fs::canonicalize(folder).map_err(|source| write_error(output, source))?;
    Ok(folder.join(output.file_name().unwrap_or_default()))
}

/// The folder that `path` is in: `.` for a bare name.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

fn usage(path: &Path, reason: &str) -> Error {
    Error::Option { option: "-o", reason: format!("{} {reason}", path.display()) }
}

fn refused(path: &Path, reason: String) -> Error {
    write_error(path, io::Error::new(io::ErrorKind::InvalidInput, reason))
}

fn write_error(path: &Path, source: io::Error) -> Error {
    Error::Write { path: path.to_owned(), source }
}

/// A file that is being written under a temporary name in the target's own folder; dropped, it is gone.
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
    /// Opens the temporary file, hidden and named `.hdralign-*.part`, with the permissions that a new file would have.
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
    pub(super) fn error(&self, source: io::Error) -> Error {
        write_error(&self.target, source)
    }

    /// Writes all of `bytes`.
    pub(super) fn put(&mut self, bytes: &[u8]) -> Result<()> {
        self.write_all(bytes).map_err(|source| write_error(&self.target, source))
    }

    /// Begins to bring to the disk what is written so far, and returns at once: [`complete`](Self::complete) waits for it.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub(super) fn sync_ahead(&mut self) -> Result<()> {
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

/// A file that is whole and on the disk, under its temporary name; dropped, it is gone. Of many only some are open.
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
        fs::File::open(&self.file.path)
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
        let file = synced.map_err(|source| write_error(&target, source))?.keep();
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
/// all. When a renaming fails, the files placed before it are removed again, but for those that replaced an older file, which cannot be
/// had back.
///
/// # Errors
/// [`Error::OutputExists`] where a target has appeared meanwhile and `overwrite` is off; [`Error::Write`]; [`Error::Abandoned`].
pub fn place(files: Vec<Whole>, overwrite: bool) -> Result<()> {
    let Some(first) = files.first() else { return Ok(()) };
    let (first, registry) = (first.target.clone(), first.file.entry.registry());
    // The locks and entries go when all have their names, and the registry is free again.
    let parts = |Whole { target, file: Kept { path, file, entry } }| ((target, path), (file, entry));
    let (unnamed, _held): (Vec<_>, Vec<_>) = files.into_iter().map(parts).unzip();
    registry.unless_abandoned(&first, || name(unnamed, overwrite))
}

/// The renaming.
fn name(files: Vec<(PathBuf, TempPath)>, overwrite: bool) -> Result<()> {
    let mut placed: Vec<PathBuf> = Vec::new();
    for (target, file) in files {
        let is_new = fs::symlink_metadata(&target).is_err();
        let outcome = if overwrite { file.persist(&target) } else { file.persist_noclobber(&target) };
        match outcome {
            Ok(_) if is_new => placed.push(target),
            Ok(_) => {}
            Err(e) => {
                for path in &placed {
                    // The first failure is the one to tell; a second while clearing up would only hide it.
                    let _ = fs::remove_file(path);
                }
                return Err(match e.error.kind() {
                    io::ErrorKind::AlreadyExists => Error::OutputExists { path: target },
                    _ => write_error(&target, e.error),
                });
            }
        }
    }
    Ok(())
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
        assert!(names(dir.path()).iter().all(|n| n.starts_with(".hdralign-")));
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

    #[test]
    fn targets_are_checked_before_any_work() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::write(at("in.png"), "x").unwrap();
        fs::create_dir(at("sub.exr")).unwrap();
        let check = |outputs: &[&str], overwrite| {
            let outputs: Vec<PathBuf> = outputs.iter().map(|o| at(o)).collect();
            check_targets(&outputs, &[at("in.png"), at("gone.jpg")], overwrite).map_err(|e| e.to_string())
        };
        assert_eq!(check(&["a.exr", "b.png", "sub.exr/a.exr"], false), Ok(()));
        let fails = |outputs: &[&str], overwrite, said: &str| {
            let message = check(outputs, overwrite).unwrap_err();
            assert!(message.contains(said), "{message}");
        };
        fails(&["a.exr", "sub.exr/../a.exr"], true, "named twice");
        fails(&["sub.exr/../in.png"], true, "one of the files that are read");
        fails(&["none/a.exr"], true, "make it first");
        fails(&["in.png/a.exr"], true, "not a folder");
        fails(&["sub.exr"], true, "it is a folder");
        fs::write(at("old.exr"), "x").unwrap();
        fails(&["old.exr"], false, "--force");
        assert_eq!(check(&["old.exr"], true), Ok(()));
    }
}
