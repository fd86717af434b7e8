//! Checks, before any work is done, that all target files can be written.
//!
//! In: [`Target`]s, and the input files. Out: an error for the first target that cannot be written. Cost: a few
//! system calls for each file.
//!
//! Files and folders are compared by device and inode, so that links, mounts and different spellings of a path do not
//! matter.

use crate::error::{Error, Result};
use crate::intake::{Identity, identity};
use std::collections::{HashMap, HashSet};
use std::ffi::OsString;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A file to be written, and the option that names it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Target {
    /// The file.
    pub path: PathBuf,
    /// The option as typed, for example `--report`.
    pub option: &'static str,
}

impl AsRef<Path> for Target {
    fn as_ref(&self) -> &Path {
        &self.path
    }
}

impl Target {
    /// Returns the targets `paths` of `option`.
    pub fn of(option: &'static str, paths: &[PathBuf]) -> Vec<Target> {
        paths.iter().map(|path| Target { path: path.clone(), option }).collect()
    }

    fn usage(&self, reason: &str) -> Error {
        Error::Option { option: self.option, reason: format!("{} {reason}", self.path.display()) }
    }

    fn refused(&self, reason: String) -> Error {
        self.failed(io::Error::new(io::ErrorKind::InvalidInput, reason))
    }

    fn failed(&self, source: io::Error) -> Error {
        Error::Write { path: self.path.clone(), source }
    }
}

/// Checks that all `targets` can be written: their folders exist, no target is named twice, no target is one of the
/// `inputs`, and, unless `overwrite` is set, no target exists already.
///
/// # Errors
/// [`Error::Option`] for a file that is named twice or is an input, [`Error::Write`] for a folder that is missing or a
/// target that is a folder, [`Error::OutputExists`].
pub fn check_targets(targets: &[Target], inputs: &[PathBuf], overwrite: bool) -> Result<()> {
    let sources: HashSet<Identity> = inputs.iter().filter_map(|path| identity(path)).collect();
    let mut named: HashMap<(Identity, OsString), &Target> = HashMap::new();
    for target in targets {
        let folder = folder(target)?;
        if identity(&target.path).is_some_and(|file| sources.contains(&file)) {
            return Err(target.usage("is also an input file; choose another name for the result"));
        }
        let name = target.path.file_name().unwrap_or_default().to_owned();
        if let Some(other) = named.insert((folder, name), target) {
            let by = if other.option == target.option { String::new() } else { format!(", also by {}", other.option) };
            return Err(target.usage(&format!("is named twice{by}; choose different names")));
        }
        match fs::symlink_metadata(&target.path) {
            Ok(there) if there.is_dir() => return Err(target.refused("it is a folder; name a file in it".into())),
            Ok(_) if !overwrite => return Err(Error::OutputExists { path: target.path.clone() }),
            _ => {}
        }
    }
    Ok(())
}

/// Returns the identity of the folder of `target`; it is an error if the folder does not exist.
fn folder(target: &Target) -> Result<Identity> {
    let folder = folder_of(&target.path);
    let remedy = match fs::metadata(folder) {
        Ok(there) if there.is_dir() => None,
        Ok(_) => Some(format!("{} is not a folder; choose another", folder.display())),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Some(format!(
            "the folder {} does not exist; create it first, for example with `mkdir -p {}`",
            folder.display(),
            folder.display()
        )),
        Err(e) => Some(format!("the folder {} cannot be entered: {e}", folder.display())),
    };
    match (remedy, identity(folder)) {
        (Some(remedy), _) => Err(target.refused(remedy)),
        (None, Some(folder)) => Ok(folder),
        (None, None) => Err(target.failed(io::ErrorKind::NotFound.into())),
    }
}

/// Returns the folder that contains `path`: `.` for a bare name.
pub(super) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_are_checked_before_any_work() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        fs::write(at("in.png"), "x").unwrap();
        fs::create_dir(at("sub.exr")).unwrap();
        let check = |outputs: &[&str], overwrite| {
            let outputs: Vec<PathBuf> = outputs.iter().map(|o| at(o)).collect();
            let inputs = [at("in.png"), at("gone.jpg")];
            check_targets(&Target::of("--plot", &outputs), &inputs, overwrite).map_err(|e| e.to_string())
        };
        assert_eq!(check(&["a.exr", "b.png", "sub.exr/a.exr"], false), Ok(()));
        let fails = |outputs: &[&str], overwrite, said: &str| {
            let message = check(outputs, overwrite).unwrap_err();
            assert!(message.contains(said), "{message}");
        };
        fails(&["a.exr", "sub.exr/../a.exr"], true, "a.exr is named twice; ");
        fails(&["sub.exr/../in.png"], true, "also an input file");
        fails(&["none/a.exr"], true, "create it first");
        fails(&["in.png/a.exr"], true, "not a folder");
        fails(&["sub.exr"], true, "it is a folder");
        fs::write(at("old.exr"), "x").unwrap();
        fails(&["old.exr"], false, "--force");
        assert_eq!(check(&["old.exr"], true), Ok(()));
    }

    /// A hard link gives one file two names, as a case-insensitive file system does.
    #[cfg(unix)]
    #[test]
    fn input_under_another_name_is_refused_by_the_option_that_names_it() {
        let dir = tempfile::tempdir().unwrap();
        let (input, output) = (dir.path().join("IMG_1.JPG"), dir.path().join("IMG_1.jpg"));
        fs::write(&input, "x").unwrap();
        fs::hard_link(&input, &output).unwrap();
        let message =
            |targets: &[Target], inputs: &[PathBuf]| check_targets(targets, inputs, true).unwrap_err().to_string();
        let said = message(&Target::of("--report", std::slice::from_ref(&output)), &[input]);
        assert!(said.starts_with("--report: ") && said.contains("IMG_1.jpg is also an input file"), "{said}");
        let both = [Target { path: output.clone(), option: "-o" }, Target { path: output, option: "--transforms" }];
        let said = message(&both, &[]);
        assert!(said.starts_with("--transforms: ") && said.contains("is named twice, also by -o; "), "{said}");
    }
}
