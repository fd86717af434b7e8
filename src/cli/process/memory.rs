//! Memory: the free memory of the system, and sizes on the command line.

use crate::cli::process::cgroup;
use std::fs;
use std::path::Path;

/// Returns the bytes of memory that this process can still use, on Linux; `None` on other systems.
pub fn free() -> Option<u64> {
    let of_machine = available(&fs::read_to_string("/proc/meminfo").ok()?)?;
    let of_groups = cgroup::free(Path::new("/"));
    let of_process = fs::read_to_string("/proc/self/limits").ok().and_then(|limits| address_space(&limits));
    let taken = || fs::read_to_string("/proc/self/status").ok().and_then(|status| in_kilobytes(&status, "VmSize:"));
    // Only half of the remaining address space counts, because allocators and thread stacks reserve more addresses
    // than they use.
    let of_process = of_process.map(|most| most.saturating_sub(taken().unwrap_or(0)) / 2);
    [of_groups, of_process].into_iter().flatten().chain([of_machine]).min()
}

/// Returns the limit of the address space (`ulimit -v`) in bytes from the text of /proc/self/limits, if there is one.
fn address_space(limits: &str) -> Option<u64> {
    let line = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    line.split_whitespace().next()?.parse().ok()
}

/// Returns `MemAvailable` in bytes from the text of /proc/meminfo.
fn available(meminfo: &str) -> Option<u64> {
    in_kilobytes(meminfo, "MemAvailable:")
}

/// Returns the value of the line `name` in a file of /proc, in bytes. These files give values in units of 1024 bytes
/// (`kB`).
fn in_kilobytes(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    Some(1024 * line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?)
}

/// Smallest memory limit that is accepted, in bytes. The program itself takes about 25 MB of it.
const LEAST: u64 = 64_000_000;

/// Parses a number of bytes, such as `300000000`, `256MB`, `256MiB` or `1.5GB`.
pub fn size(text: &str) -> Result<u64, String> {
    let wrong =
        || format!("{text:?} is not a size; give bytes, or a number and kB, MB, GB, KiB, MiB or GiB, as in `500MB`");
    let end = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    let factor = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kb" => 1e3,
        "m" | "mb" => 1e6,
        "g" | "gb" => 1e9,
        "kib" => 1024.0,
        "mib" => 1024.0 * 1024.0,
        "gib" => 1024.0 * 1024.0 * 1024.0,
        _ => return Err(wrong()),
    };
    let bytes = number.parse::<f64>().map_err(|_| wrong())? * factor;
    if bytes < 1.0 {
        return Err(wrong());
    }
    if (bytes as u64) < LEAST {
        return Err(format!("a memory limit must be at least {} MB", LEAST / 1_000_000));
    }
    Ok(bytes as u64)
}

/// Parses a number of pixels, such as `500000000`, `500M`, `500MP` or `2G`.
pub fn count(text: &str) -> Result<u64, String> {
    let wrong = || format!("{text:?} is not a number of pixels; give it as `500M`, `1.5G` or `500000000`");
    let end = text.find(|c: char| !(c.is_ascii_digit() || c == '.')).unwrap_or(text.len());
    let (number, unit) = text.split_at(end);
    let unit = unit.trim().to_ascii_lowercase();
    let factor = match unit.strip_suffix("px").or(unit.strip_suffix('p')).unwrap_or(&unit).trim() {
        "" => 1.0,
        "k" => 1e3,
        "m" => 1e6,
        "g" => 1e9,
        _ => return Err(wrong()),
    };
    let count = number.parse::<f64>().map_err(|_| wrong())? * factor;
    if count < 1.0 { Err(wrong()) } else { Ok(count as u64) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_are_counted_as_people_do() {
        let all = ["500M", "1.5g", "24 MP", "300000", "12k", "7px"].map(|t| count(t).unwrap());
        assert_eq!(all, [500_000_000, 1_500_000_000, 24_000_000, 300_000, 12_000, 7]);
        for wrong in ["", "M", "0", "-5M", "1.2.3G", "5 lights", "many"] {
            assert!(count(wrong).unwrap_err().contains("as `500M`"), "{wrong}");
        }
    }

    #[test]
    fn a_limit_of_the_process_is_read_as_linux_writes_it() {
        let limits = "Limit                     Soft Limit           Hard Limit           Units     \n\
            Max cpu time              unlimited            unlimited            seconds   \n\
            Max address space         629145600            unlimited            bytes     \n";
        assert_eq!(address_space(limits), Some(629_145_600));
        assert_eq!(address_space(&limits.replace("629145600", "unlimited")), None);
    }

    #[test]
    fn free_memory_is_read_from_proc_meminfo() {
        let text =
            "MemTotal:       24000000 kB\nMemFree:          500000 kB\nMemAvailable:   20000000 kB\nBuffers: 1 kB\n";
        assert_eq!(available(text), Some(20_480_000_000));
        assert_eq!(available("MemTotal: 3 kB"), None);
        assert!(!cfg!(target_os = "linux") || free().is_some_and(|bytes| bytes > 1 << 20));
    }

    #[test]
    fn sizes_are_as_people_write_them() {
        let all = ["256MB", "256 mb", "1.5GiB", "300000000", "64000k"].map(|t| size(t).unwrap());
        assert_eq!(all, [256_000_000, 256_000_000, 1_610_612_736, 300_000_000, 64_000_000]);
        for wrong in ["", "MB", "0", "-5MB", "1.2.3GB", "5 lights"] {
            assert!(size(wrong).unwrap_err().contains("500MB"), "{wrong}");
        }
        for little in ["1MB", "2k", "63.9MB", "5"] {
            assert!(size(little).unwrap_err().contains("at least 64 MB"), "{little}");
        }
    }
}
