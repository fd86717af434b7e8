//! Control groups: the memory that Linux still allows this process to use if its control groups have limits, as in a
//! container or under Slurm.
//!
//! In: `/proc/self/cgroup`, `/proc/self/mountinfo`, and files of the process's own group and of every group above it.
//! Out: bytes. Cost: reading some small files. Source: the kernel's `admin-guide/cgroup-v2.rst`,
//! `admin-guide/cgroup-v1/memory.rst` and `filesystems/proc.rst`.
//!
//! The usage that the kernel reports for a group includes the page cache of every file that was read or written in
//! the group. The kernel frees the page cache before it refuses memory. So the file pages that the kernel can reclaim
//! count as free here, as in `MemAvailable`.

use std::fs;
use std::path::{Component, Path, PathBuf};

/// The names of files and values in one version of the control group interface.
struct Version {
    /// The type of the control group file system in mountinfo.
    file_system: &'static str,
    /// The name of the memory controller, in `/proc/self/cgroup` and in the mount options. It is empty for version 2,
    /// in which all controllers have the same hierarchy.
    controller: &'static str,
    /// Names of the files with a limit. They contain a number of bytes. If there is no limit, they contain a word such
    /// as `max` in version 2, and a huge number in version 1.
    limits: &'static [&'static str],
    usage: &'static str,
    /// Keys in the file `memory.stat` for memory that the kernel can reclaim before it refuses memory.
    reclaimable: &'static [&'static str],
}

const VERSIONS: [Version; 2] = [
    Version {
        file_system: "cgroup2",
        controller: "",
        // `memory.high` counts as a limit: a process that exceeds it is slowed down until it gives memory back.
        limits: &["memory.max", "memory.high"],
        usage: "memory.current",
        reclaimable: &["inactive_file", "active_file", "slab_reclaimable"],
    },
    Version {
        file_system: "cgroup",
        controller: "memory",
        limits: &["memory.limit_in_bytes"],
        usage: "memory.usage_in_bytes",
        reclaimable: &["total_inactive_file", "total_active_file"],
    },
];

/// Returns the number of bytes that this process may use in addition to those in use. It is the smallest number that
/// [`Version::free`] returns for the groups of the process; `None` if it returns no number. `root` is the root of the
/// file system.
pub fn free(root: &Path) -> Option<u64> {
    let groups = fs::read_to_string(root.join("proc/self/cgroup")).ok()?;
    let mounts = fs::read_to_string(root.join("proc/self/mountinfo")).ok()?;
    let of_version = |version: &Version| {
        let group = version.group(&groups)?;
        let (mount, own) = version.folders(&mounts, group)?;
        let inside = |folder: &PathBuf| root.join(folder.strip_prefix("/").unwrap_or(folder));
        let levels = own.ancestors().take_while(|folder| folder.starts_with(&mount)).map(PathBuf::from);
        levels.filter_map(|folder| version.free(&inside(&folder), folder == own)).min()
    };
    VERSIONS.iter().filter_map(of_version).min()
}

impl Version {
    /// Returns the path of the process's group. `groups` is the text of `/proc/self/cgroup`, with lines of the form
    /// `hierarchy:controllers:path`.
    fn group<'a>(&self, groups: &'a str) -> Option<&'a Path> {
        groups.lines().find_map(|line| {
            let (controllers, path) = line.split_once(':')?.1.split_once(':')?;
            controllers.split(',').any(|controller| controller == self.controller).then(|| Path::new(path))
        })
    }

    /// Returns the mount point of the hierarchy, and the folder of `group` below it. If the group is not in the
    /// mounted part, as in a container that sees the paths of its host, the folder is the mount point itself.
    fn folders(&self, mounts: &str, group: &Path) -> Option<(PathBuf, PathBuf)> {
        let mounted = || mounts.lines().filter_map(|line| self.mount(line));
        let inside = mounted().find_map(|(top, mount)| {
            let below = group.strip_prefix(&top).ok()?;
            let is_plain = below.components().all(|part| matches!(part, Component::Normal(_)));
            is_plain.then(|| (mount.clone(), mount.join(below)))
        });
        inside.or_else(|| mounted().next().map(|(_, mount)| (mount.clone(), mount)))
    }

    /// Parses a `line` of mountinfo. Returns the group that is mounted, and its mount point. Returns `None` for other
    /// file systems, and in version 1 also for control groups without the memory controller.
    fn mount(&self, line: &str) -> Option<(PathBuf, PathBuf)> {
        let (place, what) = line.split_once(" - ")?;
        let mut what = what.split(' ');
        let is_type = what.next() == Some(self.file_system);
        let mut options = what.next_back()?.split(',');
        if !is_type || !(self.controller.is_empty() || options.any(|option| option == self.controller)) {
            return None;
        }
        let mut place = place.split(' ').skip(3).map(|path| PathBuf::from(unescaped(path)));
        Some((place.next()?, place.next()?))
    }

    /// Returns the bytes that the group in `folder` allows in addition to those in use. Returns `None` for a group of
    /// version 2 without a limit; for such a group of version 1, returns a huge number. `is_own` is true for the
    /// process's own group. In version 1, a group does not limit the groups below it if its file
    /// `memory.use_hierarchy` contains 0; this also returns `None`.
    fn free(&self, folder: &Path, is_own: bool) -> Option<u64> {
        let read = |name: &str| fs::read_to_string(folder.join(name)).ok();
        let number = |name: &str| read(name)?.trim().parse::<u64>().ok();
        if !is_own && number("memory.use_hierarchy") == Some(0) {
            return None;
        }
        let limit = self.limits.iter().filter_map(|name| number(name)).min()?;
        let stat = read("memory.stat").unwrap_or_default();
        let pages = stat.lines().filter_map(|line| line.split_once(' '));
        let pages = pages.filter(|(name, _)| self.reclaimable.contains(name));
        let reclaimable: u64 = pages.filter_map(|(_, bytes)| bytes.trim().parse::<u64>().ok()).sum();
        let used = number(self.usage).unwrap_or(0).saturating_sub(reclaimable);
        Some(limit.saturating_sub(used))
    }
}

/// Returns `path` without escape sequences: mountinfo writes white space and backslashes as a backslash and three
/// octal digits.
fn unescaped(path: &str) -> String {
    [("\\040", " "), ("\\011", "\t"), ("\\012", "\n"), ("\\134", "\\")]
        .iter()
        .fold(path.to_owned(), |path, (escaped, plain)| path.replace(escaped, plain))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Creates a temporary folder with `files`. It serves as the root of a file system.
    fn tree(files: &[(&str, &str)]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        for (path, content) in files {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, content).unwrap();
        }
        root
    }

    fn free_in(files: &[(&str, &str)]) -> Option<u64> {
        free(tree(files).path())
    }

    const TWO: (&str, &str) =
        ("proc/self/mountinfo", "30 23 0:26 / /sys/fs/cgroup rw,nosuid shared:4 - cgroup2 cgroup2 rw,nsdelegate\n");
    const ONE: (&str, &str) = (
        "proc/self/mountinfo",
        "31 23 0:28 / /sys/fs/cgroup rw - tmpfs tmpfs rw,mode=755\n\
         32 31 0:29 / /sys/fs/cgroup/cpu,cpuacct rw,relatime - cgroup cgroup rw,cpu,cpuacct\n\
         35 31 0:32 / /sys/fs/cgroup/memory rw,relatime - cgroup cgroup rw,memory\n\
         41 31 0:38 / /sys/fs/cgroup/unified rw,relatime - cgroup2 cgroup2 rw\n",
    );

    #[test]
    fn page_cache_of_a_warm_container_is_free() {
        let files = [
            TWO,
            ("proc/self/cgroup", "0::/\n"),
            ("sys/fs/cgroup/memory.max", "2000000000\n"),
            ("sys/fs/cgroup/memory.high", "max\n"),
            ("sys/fs/cgroup/memory.current", "1999000000\n"),
            (
                "sys/fs/cgroup/memory.stat",
                "anon 99000000\nfile 1850000000\nshmem 50000000\ninactive_file 1500000000\nactive_file 300000000\n\
                 slab_reclaimable 40000000\nslab_unreclaimable 10000000\n",
            ),
        ];
        assert_eq!(free_in(&files), Some(2_000_000_000 - 159_000_000));
        // Without memory.stat it is not known how much memory can be reclaimed, so none of the used bytes count as
        // free.
        assert_eq!(free_in(&files[..5]), Some(1_000_000));
    }

    #[test]
    fn every_group_above_the_process_counts_and_the_least_decides() {
        let own = "sys/fs/cgroup/machine/job/memory.max";
        let mut files = vec![
            TWO,
            ("proc/self/cgroup", "0::/machine/job/step\n"),
            ("sys/fs/cgroup/machine/memory.max", "900\n"),
            ("sys/fs/cgroup/machine/memory.current", "600\n"),
            (own, "500\n"),
            ("sys/fs/cgroup/machine/job/memory.current", "150\n"),
            ("sys/fs/cgroup/machine/job/step/memory.max", "max\n"),
            ("sys/fs/cgroup/other/memory.max", "1\n"),
        ];
        assert_eq!(free_in(&files), Some(300));
        files.push(("sys/fs/cgroup/machine/job/memory.high", "200\n"));
        assert_eq!(free_in(&files), Some(50));
        files.push(("sys/fs/cgroup/machine/job/memory.current", "201\n"));
        assert_eq!(free_in(&files), Some(0), "more is used than allowed");
    }

    #[test]
    fn groups_of_version_1_are_read_from_the_hierarchy_of_memory() {
        let mut files = vec![
            ONE,
            ("proc/self/cgroup", "9:name=systemd:/x\n4:cpuset,memory:/docker/ab\n1:cpu,cpuacct:/\n0::/\n"),
            ("sys/fs/cgroup/memory/memory.limit_in_bytes", "9223372036854771712\n"),
            ("sys/fs/cgroup/memory/memory.usage_in_bytes", "8000\n"),
            ("sys/fs/cgroup/memory/docker/memory.limit_in_bytes", "100\n"),
            ("sys/fs/cgroup/memory/docker/memory.use_hierarchy", "0\n"),
            ("sys/fs/cgroup/memory/docker/ab/memory.limit_in_bytes", "3000\n"),
            ("sys/fs/cgroup/memory/docker/ab/memory.usage_in_bytes", "2900\n"),
            (
                "sys/fs/cgroup/memory/docker/ab/memory.stat",
                "inactive_file 1\ntotal_inactive_file 2000\ntotal_active_file 400\ntotal_rss 500\n",
            ),
        ];
        assert_eq!(free_in(&files), Some(2500), "the group above counts for itself alone");
        files.push(("sys/fs/cgroup/memory/docker/memory.use_hierarchy", "1\n"));
        assert_eq!(free_in(&files), Some(100));
    }

    #[test]
    fn cgroup_of_a_container_is_found_with_paths_of_the_host() {
        let group = "4:memory:/docker/ab\n";
        let limit = ("sys/fs/cgroup/memory/memory.limit_in_bytes", "700\n");
        let mount = |top: &str| format!("35 31 0:32 {top} /sys/fs/cgroup/memory ro - cgroup cgroup rw,memory\n");
        for top in ["/docker/ab", "/docker/cd"] {
            let files = [("proc/self/mountinfo", &*mount(top)), ("proc/self/cgroup", group), limit];
            assert_eq!(free_in(&files), Some(700), "{top}");
        }
        let files = [TWO, ("proc/self/cgroup", "0::/../beside\n"), ("sys/fs/cgroup/memory.max", "70\n")];
        assert_eq!(free_in(&files), Some(70));
    }

    #[test]
    fn missing_cgroups_are_no_limit() {
        assert_eq!(free_in(&[]), None);
        assert_eq!(free_in(&[TWO, ("proc/self/cgroup", "0::/a\n"), ("sys/fs/cgroup/a/memory.max", "max\n")]), None);
        assert_eq!(free_in(&[ONE, ("proc/self/cgroup", "3:cpuset:/\nnonsense\n")]), None);
        assert_eq!(unescaped("/mnt/my\\040disk"), "/mnt/my disk");
    }
}
