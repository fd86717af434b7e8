//! Leftovers: what runs that were killed left in the folders that this one writes to, taken away before it begins.
//!
//! Steps of a plan (`batch --run`) leave them alone: engines run them on many machines, and locks do not reach others everywhere.

use hdralign::write;
use std::collections::BTreeSet;
use std::path::Path;

/// Clears the folders of `targets`.
pub fn clear<P: AsRef<Path>>(targets: &[P]) {
    let folder = |target: &P| match target.as_ref().parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
        _ => Path::new(".").to_owned(),
    };
    targets.iter().map(folder).collect::<BTreeSet<_>>().iter().for_each(|folder| {
        write::sweep(folder);
    });
}
