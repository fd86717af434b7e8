//! Memory: how much there is, and how much the user allows.

use std::fs;

/// Bytes of memory that are free for this process, as far as Linux tells; none elsewhere.
pub fn free() -> Option<u64> {
    let of_machine = available(&fs::read_to_string("/proc/meminfo").ok()?)?;
    // Where the process is confined, as in a container, less.
    let read = |name: &str| fs::read_to_string(format!("/sys/fs/cgroup/{name}")).ok()?.trim().parse::<u64>().ok();
    let of_group = read("memory.max").map(|most| most.saturating_sub(read("memory.current").unwrap_or(0)));
    Some(of_group.map_or(of_machine, |group| group.min(of_machine)))
}

/// `MemAvailable` of /proc/meminfo, in bytes.
fn available(meminfo: &str) -> Option<u64> {
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    Some(1024 * line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?)
}

/// What the program takes before it has a photograph, in bytes: it cannot be allowed less.
const LEAST: u64 = 64_000_000;

/// Bytes, as `300000000`, `256MB`, `256MiB` or `1.5GB`.
pub fn size(text: &str) -> Result<u64, String> {
    let wrong =
        || format!("{text:?} is no size; give bytes, or a number and kB, MB, GB, KiB, MiB or GiB, as in `500MB`");
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
        return Err(format!("the program itself takes about {} MB; give that or more", LEAST / 1_000_000));
    }
    Ok(bytes as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_free_is_read_as_linux_writes_it() {
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
            assert!(size(little).unwrap_err().contains("takes about 64 MB"), "{little}");
        }
    }
}
