//! Claims: a claim is a lock file that marks temporary names in a folder as those of a running process.
//!
//! In: a folder. Out: names `.hdralign-ID-N.part` in the folder, and beside them the file `.hdralign-ID.lock`, which
//! contains [`SIGNATURE`] and is locked while the process runs. [`sweep`] removes the files of claims that no process
//! has locked. A file without a claim belongs to the user, whatever its name. Cost: one open file for each folder; a
//! lock is one system call, the signature one fsync.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

const PREFIX: &str = ".hdralign-";
const PART: &str = ".part";
const LOCK: &str = ".lock";

/// Number of characters of an ID. Each is one of 62 letters and digits, so there are 62^12 IDs.
const ID_LENGTH: usize = 12;

/// Content of a lock file. Lock files of older versions contain the same text and must be recognised, so the text
/// must not change, not even the path in it.
const SIGNATURE: &[u8] = b"hdralign: temporary files are written here; see docs/faults.md\n";

/// Maximum number of attempts to create a lock file; an attempt fails if a sweep finds the file before it is locked.
const TRIES: usize = 16;

/// Temporary names in a folder. When dropped, their files are removed.
#[derive(Debug)]
pub(super) struct Claim {
    _lock: NamedTempFile,
    folder: PathBuf,
    id: String,
    /// Number of names created.
    made: u64,
    paths: BTreeSet<PathBuf>,
}

impl Claim {
    /// Creates a claim on `folder`, without names.
    ///
    /// # Errors
    /// The error of the system.
    pub fn new(folder: &Path) -> io::Result<Claim> {
        let mut lock = locked_in(folder)?;
        lock.write_all(SIGNATURE)?;
        // If the signature were not on the disk, the temporary files could not be recognised after a power failure.
        lock.as_file().sync_all()?;
        let name = lock.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
        let id = id_of(&name).unwrap_or_default().to_owned();
        Ok(Claim { _lock: lock, folder: folder.to_owned(), id, made: 0, paths: BTreeSet::new() })
    }

    /// Returns a new name; its file does not exist yet.
    pub fn name(&mut self) -> PathBuf {
        let path = self.folder.join(format!("{PREFIX}{}-{}{PART}", self.id, self.made));
        self.made += 1;
        self.paths.insert(path.clone());
        path
    }

    /// Removes the file `path`, if it exists, and its name. Returns whether it was the last name of the claim.
    pub fn remove(&mut self, path: &Path) -> bool {
        // An error is ignored here: usually the file has already been renamed to its target.
        let _ = fs::remove_file(path);
        self.paths.remove(path);
        self.paths.is_empty()
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        // The lock file is removed after these files, when the field `_lock` is dropped.
        for path in &self.paths {
            let _ = fs::remove_file(path);
        }
    }
}

/// Creates a lock file in `folder`, locked if the file system supports locks.
fn locked_in(folder: &Path) -> io::Result<NamedTempFile> {
    let open = |path: &Path| OpenOptions::new().read(true).write(true).create_new(true).open(path);
    for _ in 0..TRIES {
        let lock = tempfile::Builder::new().prefix(PREFIX).suffix(LOCK).rand_bytes(ID_LENGTH).make_in(folder, open)?;
        match lock.as_file().try_lock() {
            Ok(()) if lock.path().exists() => return Ok(lock),
            // A sweep has found the lock file before it was locked, and has removed it or is about to do so: try
            // again.
            Ok(()) | Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(_)) => return Ok(lock),
        }
    }
    Err(io::Error::other("another program deletes temporary files in this folder as soon as they are made"))
}

/// Returns the ID in the name of a lock file; `None` for other names.
fn id_of(name: &str) -> Option<&str> {
    name.strip_prefix(PREFIX)?.strip_suffix(LOCK).filter(|id| id.len() == ID_LENGTH)
}

/// Removes the temporary files that killed processes left in `folder`, and returns the number of removed files. The
/// temporary files of a running process are protected by its locked lock file. If the file system does not support
/// locks, nothing is removed. If other machines do not see the locks (Lustre's `localflock`), do not call this
/// function while another machine writes to the folder, because the temporary files of that machine would be removed.
pub fn sweep(folder: &Path) -> usize {
    names(folder).iter().filter_map(|name| id_of(name)).map(|id| sweep_one(folder, id)).sum()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().into_string().ok()).collect()
}

/// Removes the files of the claim `id`, unless a process has locked it, and returns the number of removed files.
fn sweep_one(folder: &Path, id: &str) -> usize {
    let lock = folder.join(format!("{PREFIX}{id}{LOCK}"));
    let Some(abandoned) = Abandoned::at(&lock) else { return 0 };
    let is_part = |name: &&String| {
        let number =
            name.strip_prefix(PREFIX).and_then(|rest| rest.strip_prefix(id)?.strip_prefix('-')?.strip_suffix(PART));
        number.is_some_and(|n| !n.is_empty() && n.bytes().all(|digit| digit.is_ascii_digit()))
    };
    let names = if abandoned.is_signed { names(folder) } else { Vec::new() };
    let parts = names.iter().filter(is_part).map(|name| folder.join(name));
    parts.chain([lock]).filter(|path| fs::remove_file(path).is_ok()).count()
}

/// A lock file whose process has ended, locked by this process.
struct Abandoned {
    _locked: File,
    /// False if the process was killed before it had written the signature, and so before it created names.
    is_signed: bool,
}

impl Abandoned {
    /// Opens `path` and locks it, if it is a lock file of hdralign that no process has locked.
    fn at(path: &Path) -> Option<Abandoned> {
        // A symbolic link is not a lock file of hdralign. On NFS, only a file that is open for writing can be locked.
        fs::symlink_metadata(path).ok().filter(|there| there.is_file())?;
        let file = OpenOptions::new().read(true).write(true).open(path).ok()?;
        file.try_lock().ok()?;
        let mut content = Vec::new();
        (&file).take(SIGNATURE.len() as u64 + 1).read_to_end(&mut content).ok()?;
        let is_ours = content.is_empty() || content == SIGNATURE;
        is_ours.then_some(Abandoned { _locked: file, is_signed: !content.is_empty() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signature_is_that_of_the_tests_through_the_binary() {
        assert_eq!(SIGNATURE, include_bytes!("../../../tests/support/claim.txt"));
    }

    #[test]
    fn sweep_removes_only_files_of_ended_processes() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let there = || {
            let mut names = names(dir.path());
            names.sort();
            names
        };
        // These files belong to the user: the name does not fit, or there is no lock file with the signature.
        let users = [
            ".hdralign-notes.part",
            ".hdralign-aaaaaaaaaaaa-0.part",
            ".hdralign-bbbbbbbbbbbb.lock",
            ".hdralign-bbbbbbbbbbbb-0.part",
            ".hdralign-cccccccccccc-x.part",
            ".hdralign-cccccccccccc-.part",
            ".hdralign-short.lock",
        ];
        users.iter().for_each(|name| fs::write(at(name), "mine").unwrap());
        fs::write(at(".hdralign-cccccccccccc.lock"), SIGNATURE).unwrap();
        fs::write(at(".hdralign-cccccccccccc-0.part"), "half").unwrap();
        fs::write(at(".hdralign-cccccccccccc-17.part"), "").unwrap();
        fs::write(at(".hdralign-dddddddddddd.lock"), "").unwrap();
        fs::write(at(".hdralign-dddddddddddd-0.part"), "mine").unwrap();
        let mut living = Claim::new(dir.path()).unwrap();
        let path = living.name();
        fs::write(&path, "half").unwrap();
        assert_eq!(sweep(dir.path()), 4);
        assert!(path.exists(), "it is being written");
        drop(living);
        let mut left: Vec<&str> = users.into_iter().chain([".hdralign-dddddddddddd-0.part"]).collect();
        left.sort_unstable();
        assert_eq!(there(), left);
        assert_eq!((sweep(dir.path()), sweep(&at("nowhere"))), (0, 0));
    }

    /// While sweeps are repeated continuously, other threads create claims. The sweeps must not remove the files of
    /// these claims.
    #[test]
    fn claims_made_during_a_sweep_are_kept() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path();
        std::thread::scope(|scope| {
            let make = || (0..50).map(|_| Claim::new(folder)).collect::<io::Result<Vec<_>>>();
            let making = [scope.spawn(make), scope.spawn(make)];
            let mut swept = 0;
            while !making.iter().all(|thread| thread.is_finished()) {
                swept += sweep(folder);
            }
            let made: Vec<Claim> = making.into_iter().flat_map(|thread| thread.join().unwrap().unwrap()).collect();
            assert!(made.iter().all(|claim| claim._lock.path().exists()), "{swept} swept");
            assert_eq!((made.len(), names(folder).len(), sweep(folder)), (100, 100, 0));
        });
        assert!(names(folder).is_empty());
    }
}
