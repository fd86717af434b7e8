//! Renames complete files to their targets; existing files are replaced or are an error.
//!
//! In: complete files, anonymous or with temporary names. Out: files at the paths of their targets. Cost: a few
//! system calls for each file. Bytes are copied only if a file system supports anonymous files but cannot link them.

use super::anonymous;
use super::temporary::{Registry, Staged, State, TemporaryName};
use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Seek};
use std::path::{Path, PathBuf};
use tempfile::TempPath;

impl Staged {
    pub fn registry(&self) -> &'static Registry {
        match self {
            Staged::Anonymous(held, _) => held.registry,
            Staged::Named(name) => name.registry,
        }
    }

    /// Opens the file at its first byte, for one reader at a time.
    ///
    /// # Errors
    /// The error of the system.
    pub fn open(&self) -> io::Result<File> {
        match self {
            Staged::Anonymous(held, _) => {
                let mut file = held.file.try_clone()?;
                file.rewind()?;
                Ok(file)
            }
            Staged::Named(name) => File::open(&name.path),
        }
    }

    /// Sets the permission bits of the file to `mode(current bits)`.
    #[cfg(unix)]
    fn set_mode(&self, mode: impl Fn(u32) -> u32) -> io::Result<()> {
        use std::os::unix::fs::PermissionsExt;
        let file = self.open()?;
        let own = file.metadata()?.permissions().mode() & 0o777;
        let wanted = mode(own);
        // File systems without permissions refuse to set even the bits that are already set.
        if wanted == own { Ok(()) } else { file.set_permissions(fs::Permissions::from_mode(wanted)) }
    }

    /// Removes from this file the permissions that the file `source` does not have, on systems with permission bits.
    ///
    /// # Errors
    /// The error of the system.
    pub fn restrict(&self, source: &Path) -> io::Result<()> {
        #[cfg(unix)]
        {
            let there = fs::metadata(source)?;
            self.set_mode(|own| own & std::os::unix::fs::MetadataExt::mode(&there))?;
        }
        #[cfg(not(unix))]
        let _ = source;
        Ok(())
    }

    /// Gives the file a temporary name and, if the file `target` exists, the permissions of `target`. These steps may
    /// fail, so they are done for all files before the first [`rename_over`](Self::rename_over).
    ///
    /// # Errors
    /// The error of the system.
    pub fn prepare(&mut self, state: &mut State, target: &Path) -> io::Result<()> {
        self.temporary(state)?;
        #[cfg(unix)]
        if let Some(there) = fs::symlink_metadata(target).ok().filter(|there| there.is_file()) {
            self.set_mode(|_| std::os::unix::fs::MetadataExt::mode(&there) & 0o777)?;
        }
        #[cfg(not(unix))]
        let _ = target;
        Ok(())
    }

    /// Renames the file to `target`, replacing the file there.
    ///
    /// # Errors
    /// The error of the system.
    pub fn rename_over(&mut self, state: &mut State, target: &Path) -> io::Result<()> {
        self.prepare(state, target)?;
        fs::rename(self.temporary(state)?, target)
    }

    /// Renames the file to `target`, which must not exist.
    ///
    /// # Errors
    /// [`ErrorKind::AlreadyExists`], and other errors of the system.
    pub fn rename_new(&mut self, state: &mut State, target: &Path) -> io::Result<()> {
        if let Staged::Anonymous(held, None) = self {
            match anonymous::link(&held.file, target) {
                Err(error) if error.kind() != ErrorKind::AlreadyExists => {}
                linked => return linked,
            }
        }
        rename_new(self.temporary(state)?, target)
    }

    /// Returns the temporary name of the file; an anonymous file gets one.
    fn temporary(&mut self, state: &mut State) -> io::Result<&Path> {
        match self {
            Staged::Named(name) | Staged::Anonymous(_, Some(name)) => Ok(&name.path),
            Staged::Anonymous(held, name) => {
                let path = state.temporary_of(&held.folder, &held.file)?;
                Ok(&name.insert(TemporaryName { registry: held.registry, path }).path)
            }
        }
    }
}

/// Renames the file `from` to `to`, which must not exist.
fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    let Err(failed) = TempPath::try_from_path(from)?.persist_noclobber(to) else { return Ok(()) };
    // `TempPath` must not remove the file: the owner of the temporary name does that.
    let _: Result<PathBuf, _> = failed.path.keep();
    match failed.error.kind() {
        ErrorKind::AlreadyExists => Err(failed.error),
        _ => replace_reservation(from, to),
    }
}

/// Same as [`rename_new`], for file systems with neither rename-without-replacement nor hard links (some FUSE file
/// systems): creates an empty file at `to` and then replaces this file, so that no other process can create `to` in
/// between.
fn replace_reservation(from: &Path, to: &Path) -> io::Result<()> {
    OpenOptions::new().write(true).create_new(true).open(to)?;
    fs::rename(from, to).inspect_err(|_| {
        // An error is ignored here, because the failure of `rename` is reported.
        let _ = fs::remove_file(to);
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn replace_reservation_target_exists_or_source_missing_is_an_error() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::write(at("from"), "bytes").unwrap();
        fs::write(at("taken"), "old").unwrap();
        let error = replace_reservation(&at("from"), &at("taken")).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::AlreadyExists);
        assert_eq!(replace_reservation(&at("gone"), &at("new")).unwrap_err().kind(), ErrorKind::NotFound);
        assert!(!at("new").exists());
        replace_reservation(&at("from"), &at("new")).unwrap();
        let read = |name: &str| fs::read_to_string(at(name)).unwrap();
        assert_eq!((read("new"), read("taken"), at("from").exists()), ("bytes".into(), "old".into(), false));
    }

    /// Two failures are tested: the folder of the target does not exist, and the target exists.
    #[test]
    fn rename_new_failure_keeps_the_temporary_file() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::write(at("from"), "bytes").unwrap();
        let kind = |to: &str| rename_new(&at("from"), &at(to)).unwrap_err().kind();
        assert_eq!((kind("none/to"), kind("from")), (ErrorKind::NotFound, ErrorKind::AlreadyExists));
        assert!(at("from").exists());
        rename_new(&at("from"), &at("to")).unwrap();
        assert!(at("to").exists() && !at("from").exists());
    }
}
