//! Unique names in a plan: no file belongs to two jobs, or to both a job and the summary.
//!
//! In: the requested names. Out: the same names, with a number appended where necessary. Cost: negligible.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The files of a job.
pub(super) struct JobFiles {
    pub(super) outputs: Vec<PathBuf>,
    pub(super) page: Option<PathBuf>,
    pub(super) report: PathBuf,
    pub(super) failure: PathBuf,
}

impl JobFiles {
    /// Returns the files of a job. Each name is `base` followed by a dot and an extension; dots in `base` are kept.
    pub(super) fn new<'a>(base: &Path, extensions: impl IntoIterator<Item = &'a str>, has_page: bool) -> JobFiles {
        let with = |extension: &str| {
            let mut name = base.as_os_str().to_owned();
            name.push(".");
            name.push(extension);
            PathBuf::from(name)
        };
        JobFiles {
            outputs: extensions.into_iter().map(with).collect(),
            page: has_page.then(|| with("html")),
            report: with("json"),
            failure: with("failed.json"),
        }
    }

    /// Returns all files of the job.
    pub(super) fn all(self) -> Vec<PathBuf> {
        self.outputs.into_iter().chain(self.page).chain([self.report, self.failure]).collect()
    }
}

/// The names that are already used. If a name is requested again, it gets `-2` appended, then `-3`.
#[derive(Default)]
pub(super) struct Unique {
    taken: BTreeSet<PathBuf>,
    /// For each name that was requested before, the number to append at the next request.
    next: BTreeMap<PathBuf, usize>,
}

impl Unique {
    /// Returns `path` in lower case, because some file systems do not distinguish names that differ only in case.
    fn folded(path: &Path) -> PathBuf {
        path.to_string_lossy().to_lowercase().into()
    }

    /// Marks `names` as used.
    pub(super) fn reserve(&mut self, names: impl IntoIterator<Item = PathBuf>) {
        self.taken.extend(names.into_iter().map(|name| Unique::folded(&name)));
    }

    /// Returns `wanted`, and marks its files as used. If one of its files is already used, a number is appended to
    /// `wanted`. `named` returns the files that belong to a name.
    pub(super) fn path(&mut self, wanted: PathBuf, named: impl Fn(&Path) -> Vec<PathBuf>) -> PathBuf {
        let key = Unique::folded(&wanted);
        let mut number = self.next.get(&key).copied().unwrap_or(1);
        loop {
            let mut name = wanted.clone().into_os_string();
            if number > 1 {
                name.push(format!("-{number}"));
            }
            let name = PathBuf::from(name);
            let files = named(&name);
            number += 1;
            if !files.iter().any(|file| self.taken.contains(&Unique::folded(file))) {
                self.reserve(files);
                self.next.insert(key, number);
                return name;
            }
        }
    }

    /// Returns `wanted`, with a number appended if it is already used. Marks the returned name as used.
    pub(super) fn text(&mut self, wanted: String) -> String {
        self.path(wanted.into(), |name| vec![name.to_owned()]).to_string_lossy().into_owned()
    }
}
