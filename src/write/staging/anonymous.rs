//! Anonymous files: files without a name, which the system removes when their process ends, however it ends.
//!
//! In: a folder. Out: an open file, and later a link to it. Cost: the same as for any file. Linux supports anonymous
//! files (`O_TMPFILE`) on most of its file systems. Other systems have no anonymous files, so files with temporary
//! names are used there.

use std::fs::File;
use std::io;
use std::path::Path;

/// Creates an anonymous file in `folder` with the permissions of a new file; `None` where the system or the file system
/// does not support anonymous files.
#[cfg(target_os = "linux")]
pub(super) fn create(folder: &Path) -> Option<File> {
    use rustix::fs::{Mode, OFlags, open};
    // The system removes the bits of the umask from rw-rw-rw-.
    let mode = Mode::from_raw_mode(0o666);
    open(folder, OFlags::TMPFILE | OFlags::RDWR | OFlags::CLOEXEC, mode).ok().map(File::from)
}

/// Gives the anonymous `file` the name `path`, which must not exist.
///
/// # Errors
/// [`AlreadyExists`](io::ErrorKind::AlreadyExists), and other errors of the system.
#[cfg(target_os = "linux")]
pub(super) fn link(file: &File, path: &Path) -> io::Result<()> {
    use rustix::fs::{AtFlags, CWD, linkat};
    use rustix::io::Errno;
    use std::os::fd::AsRawFd;
    match linkat(file, "", CWD, path, AtFlags::EMPTY_PATH) {
        // Before Linux 6.10 only a privileged process may link an open file directly; other processes can link the
        // file through its entry in /proc.
        Err(e) if e != Errno::EXIST => {
            let entry = format!("/proc/self/fd/{}", file.as_raw_fd());
            Ok(linkat(CWD, entry, CWD, path, AtFlags::SYMLINK_FOLLOW)?)
        }
        linked => Ok(linked?),
    }
}

/// Maximum number of complete anonymous files that stay open: half of the files that the process may open.
#[cfg(target_os = "linux")]
pub(super) fn most() -> usize {
    use rustix::process::{Resource, getrlimit};
    getrlimit(Resource::Nofile).current.map_or(usize::MAX, |most| usize::try_from(most / 2).unwrap_or(usize::MAX))
}

/// Not supported.
#[cfg(not(target_os = "linux"))]
pub(super) fn create(_: &Path) -> Option<File> {
    None
}

/// Not supported.
///
/// # Errors
/// Always.
#[cfg(not(target_os = "linux"))]
pub(super) fn link(_: &File, _: &Path) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

/// Not supported.
#[cfg(not(target_os = "linux"))]
pub(super) fn most() -> usize {
    0
}
