//! Kept: files that are complete, and how they get their names.
//!
//! In: files with temporary names, or anonymous ones. Out: files under their targets' names, which were free, or whose files are replaced.
//! Cost: a few calls of the system for each file. Bytes are copied only where a file system has anonymous files and does not name them.

use super::anonymous;
use super::temporary::{Kept, Registry, State, TemporaryName};
use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Seek};
use std::path::{Path, PathBuf};
use tempfile::TempPath;

impl Kept {
    pub fn registry(&self) -> &'static Registry {
        match self {
            Kept::Held(held, _) => held.registry,
            Kept::Named(name) => name.registry,
        }
    }

    /// Its bytes from the first on, for one reader at a time.
    ///
    /// # Errors
    /// What the system says.
    pub fn open(&self) -> io::Result<File> {
        match self {
            Kept::Held(held, _) => {
                let mut file = held.file.try_clone()?;
                file.rewind()?;
                Ok(file)
            }
            Kept::Named(name) => File::open(&name.path),
        }
    }

    /// Makes `mode` of the bits of its permissions.
    #[cfg(unix)]
    fn set_mode(&self, mode: impl Fn(u32) -> u32) -> io::Result<()> {
        use std::os::unix::fs::PermissionsExt;
        let file = self.open()?;
        let own = file.metadata()?.permissions().mode() & 0o777;
        let wanted = mode(own);
        // File systems without permissions refuse even to set those that are there.
        if wanted == own { Ok(()) } else { file.set_permissions(fs::Permissions::from_mode(wanted)) }
    }

    /// Takes the permissions away that `source` does not have, where there are such.
    ///
    /// # Errors
    /// What the system says.
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

    /// Gives it a temporary name, unless it has one, and the permissions of the file `target`, so that nothing but [`replace`](Self::replace) is
    /// left to be done.
    ///
    /// # Errors
    /// What the system says.
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

    /// Gives it the name `target`, in place of the file that has it.
    ///
    /// # Errors
    /// What the system says.
    pub fn replace(&mut self, state: &mut State, target: &Path) -> io::Result<()> {
        self.prepare(state, target)?;
        fs::rename(self.temporary(state)?, target)
    }

    /// Gives it the name `target`, which must be free.
    ///
    /// # Errors
    /// [`ErrorKind::AlreadyExists`], and what else the system says.
    pub fn name(&mut self, state: &mut State, target: &Path) -> io::Result<()> {
        if let Kept::Held(held, None) = self {
            match anonymous::link(&held.file, target) {
                Err(error) if error.kind() != ErrorKind::AlreadyExists => {}
                linked => return linked,
            }
        }
        rename_new(self.temporary(state)?, target)
    }

    /// Its temporary name.
    fn temporary(&mut self, state: &mut State) -> io::Result<&Path> {
        match self {
            Kept::Named(name) | Kept::Held(_, Some(name)) => Ok(&name.path),
            Kept::Held(held, name) => {
                let path = state.temporary_of(&held.folder, &held.file)?;
                Ok(&name.insert(TemporaryName { registry: held.registry, path }).path)
            }
        }
    }
}

/// Renames the file `from` to `to`, which must be free.
fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    let Err(failed) = TempPath::try_from_path(from)?.persist_noclobber(to) else { return Ok(()) };
    // The temporary name is removed by whoever owns it.
    let _: Result<PathBuf, _> = failed.path.keep();
    match failed.error.kind() {
        ErrorKind::AlreadyExists => Err(failed.error),
        _ => replace_reservation(from, to),
    }
}

/// The same where a file system knows neither renaming without replacement nor hard links, as some by FUSE: an empty file takes the name, and is
/// replaced. Nobody else can take it meanwhile.
fn replace_reservation(from: &Path, to: &Path) -> io::Result<()> {
    OpenOptions::new().write(true).create_new(true).open(to)?;
    fs::rename(from, to).inspect_err(|_| {
        // What went wrong first is reported.
        let _ = fs::remove_file(to);
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reservation_takes_a_free_name_only_and_leaves_none_in_vain() {
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

    /// As from a folder that is gone.
    #[test]
    fn rename_that_fails_says_why_and_keeps_the_temporary_file() {
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
