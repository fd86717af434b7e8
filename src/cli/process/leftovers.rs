//! Removes temporary files of killed runs from the folders of the results, at the start of a run.
//!
//! Jobs of a plan (`batch --run`) do not remove such files. They may run on several machines at the same time, and on
//! some file systems a machine does not see the locks of other machines. So a job could remove files that are in use.

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
