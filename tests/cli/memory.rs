//! Memory: `--max-memory` is kept, however many threads there are, with the same bytes.

use crate::support::{Folder, jpeg, small};
use image::imageops::{FilterType, resize};
use std::fs;
use std::process::{Command, Stdio};
use std::time::Duration;

/// The most that was resident of a run of `line` in `folder`, in bytes: the kernel's own count of it, as often as it can be read.
fn peak(folder: &Folder, line: &str) -> u64 {
    let mut command = Command::new(crate::support::program());
    command.args(line.split_whitespace()).current_dir(folder.path()).stdin(Stdio::null()).stdout(Stdio::null());
    let mut child = command.spawn().expect("the program starts");
    let status = format!("/proc/{}/status", child.id());
    let mut most = 0;
    let code = loop {
        // It never falls, so that only what the last milliseconds add is not seen; there is nothing left to be encoded then.
        let text = fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let kilobytes = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok());
        most = most.max(1024 * kilobytes.unwrap_or(0));
        if let Some(status) = child.try_wait().expect("it can be waited for") {
            break status.code();
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    assert_eq!(code, Some(0), "{line}");
    most
}

/// Three frames of 6 MP: 54 MB of codes and 72 MB of radiance, beside the program and what every thread takes for itself.
#[cfg(target_os = "linux")]
#[test]
fn memory_allowed_is_kept_on_any_number_of_threads_with_the_same_bytes() {
    let folder = Folder::empty();
    for i in 2..=4 {
        folder.put(&format!("w{i}.jpg"), &jpeg(&resize(&small(i), 3000, 2000, FilterType::Triangle), Some(i)));
    }
    let line = "merge w2.jpg w3.jpg w4.jpg -q --force -o a.exr -o a.png";
    folder.line(&format!("{line} --threads 2")).done();
    let expected = [folder.bytes("a.exr"), folder.bytes("a.png")];
    for (options, allowed) in [("--threads 1", 110), ("--threads 4", 130), ("--threads 16", 130), ("--threads 64", 160)]
    {
        let most = peak(&folder, &format!("{line} {options} --max-memory {allowed}MB --scratch ."));
        assert!(most <= allowed * 1_000_000, "{options}: {} MB of {allowed}", most / 1_000_000);
        assert!(most > 20_000_000, "{options}: {most} bytes were seen");
        assert!([folder.bytes("a.exr"), folder.bytes("a.png")] == expected, "{options}");
    }
}
