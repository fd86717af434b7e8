//! Names of a plan: the files of its steps, none of which two of them have, nor the summary.
//!
//! In: the names wanted. Out: those, or others with a number behind them. Cost: none to speak of.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The files of a step.
pub(super) struct StepFiles {
    pub(super) outputs: Vec<PathBuf>,
    pub(super) page: Option<PathBuf>,
    pub(super) report: PathBuf,
    pub(super) failure: PathBuf,
}

impl StepFiles {
    /// Named `base`, with an extension behind whatever dots it has.
    pub(super) fn new<'a>(base: &Path, extensions: impl IntoIterator<Item = &'a str>, has_page: bool) -> StepFiles {
        let with = |extension: &str| {
            let mut name = base.as_os_str().to_owned();
            name.push(".");
            name.push(extension);
            PathBuf::from(name)
        };
        StepFiles {
            outputs: extensions.into_iter().map(with).collect(),
            page: has_page.then(|| with("html")),
            report: with("json"),
            failure: with("failed.json"),
        }
    }

    /// All of them.
    pub(super) fn all(self) -> Vec<PathBuf> {
        self.outputs.into_iter().chain(self.page).chain([self.report, self.failure]).collect()
    }
}

/// Names that are taken. A second user of a name gets `-2` behind it.
#[derive(Default)]
pub(super) struct Unique {
    taken: BTreeSet<PathBuf>,
    /// The next number to try behind a name.
    next: BTreeMap<PathBuf, usize>,
}

impl Unique {
    /// Some file systems take names that differ in case for one.
    fn folded(path: &Path) -> PathBuf {
        path.to_string_lossy().to_lowercase().into()
    }

    /// Takes `names`.
    pub(super) fn reserve(&mut self, names: impl IntoIterator<Item = PathBuf>) {
        self.taken.extend(names.into_iter().map(|name| Unique::folded(&name)));
    }

    /// `wanted`, or with a number behind it: the first of which none of the files `named` after it is taken. They are from now on.
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

    /// `wanted`, or with a number behind it.
    pub(super) fn text(&mut self, wanted: String) -> String {
        self.path(wanted.into(), |name| vec![name.to_owned()]).to_string_lossy().into_owned()
    }
}
