//! Leftovers: temporary files of killed runs in the folders of the results, removed at the start.
//!
//! Jobs of a plan (`batch --run`) do not remove them: jobs may run on several machines, and on some file systems a lock
//! held by one machine is not seen by the others.

use hdralign::write;
use std::collections::BTreeSet;
use std::path::Path;

/// Removes the temporary files of killed runs from the folders of `targets`.
pub fn clear<P: AsRef<Path>>(targets: &[P]) {
    let folder = |target: &P| match target.as_ref().parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
        _ => Path::new(".").to_owned(),
    };
    targets.iter().map(folder).collect::<BTreeSet<_>>().iter().for_each(|folder| {
        write::sweep(folder);
    });
}
