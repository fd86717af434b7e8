//! Memory: every command respects `--max-memory` with any number of threads and writes the same bytes, or reports an
//! error.

use crate::support::{Folder, jpeg, small};
use image::imageops::{FilterType, resize};
use std::fs;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Returns the largest resident memory of a run of `line` in `folder`, in bytes: the kernel's peak (VmHWM), which is
/// read every 2 ms.
fn peak(folder: &Folder, line: &str) -> u64 {
    let mut command = Command::new(crate::support::program());
    command.args(line.split_whitespace()).current_dir(folder.path()).stdin(Stdio::null()).stdout(Stdio::null());
    let mut child = command.spawn().expect("the program starts");
    let status = format!("/proc/{}/status", child.id());
    let mut most = 0;
    let code = loop {
        // The peak never falls, so only an increase in the last milliseconds is missed, when all files are encoded
        // already.
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

/// Three frames of 6 MP have 54 MB of code values and 72 MB of radiance, in addition to the program and its threads.
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
    for (options, allowed) in [("--threads 1", 100), ("--threads 4", 100), ("--threads 16", 130), ("--threads 64", 250)]
    {
        let most = peak(&folder, &format!("{line} {options} --max-memory {allowed}MB --scratch ."));
        assert!(most <= allowed * 1_000_000, "{options}: {} MB of {allowed}", most / 1_000_000);
        assert!(most > 20_000_000, "{options}: {most} bytes were seen");
        assert!([folder.bytes("a.exr"), folder.bytes("a.png")] == expected, "{options}");
    }
}

/// Runs `line` with a memory limit that is too low, and returns the smallest sufficient limit that the error reports,
/// in MB.
#[cfg(target_os = "linux")]
fn least(folder: &Folder, line: &str) -> u64 {
    let before = folder.listing();
    let run = folder.line(&format!("{line} --max-memory 64MB"));
    assert_eq!((run.code, folder.listing()), (2, before), "{line}: {run:?}");
    let needed = run.stderr.split_once("take ").and_then(|(_, rest)| rest.split_once(" MB at least"));
    let needed = needed.and_then(|(megabytes, _)| megabytes.parse().ok());
    let needed = needed.unwrap_or_else(|| panic!("{line} does not say what it needs: {}", run.stderr));
    assert!(run.stderr.contains(&format!("--max-memory {needed}MB")), "{line}: {}", run.stderr);
    needed
}

/// A memory limit below the minimum is an error before any work; with the minimum every command works, also on many
/// threads.
#[cfg(target_os = "linux")]
#[test]
fn suggested_memory_limit_is_sufficient() {
    let folder = Folder::empty();
    for i in 2..=4 {
        let frame = resize(&small(i), 1500, 1000, FilterType::Triangle);
        folder.put(&format!("w{i}.jpg"), &jpeg(&frame, Some(i)));
    }
    let frames = "w2.jpg w3.jpg w4.jpg -q --force --scratch .";
    for command in [
        "merge FRAMES -o a.exr -o a.tif -o a.png",
        "merge FRAMES --tmo drago --deghost --flare -o a.hdr -o a.jpg --report a.html",
        "merge FRAMES --tmo mertens -o a.png",
        "merge FRAMES --picture a.tif --bit-depth 16 --resize 80%",
        "merge FRAMES --picture a.jpg --resize 1000 --report a.html",
        "align FRAMES --align sift --save-aligned on_",
        "align FRAMES --displacements by_",
        "inspect FRAMES -d look",
    ] {
        let line = command.replace("FRAMES", frames);
        let least = least(&folder, &line);
        for (threads, allowed) in [(16, least), (16, 2 * least)] {
            let most = peak(&folder, &format!("{line} --threads {threads} --max-memory {allowed}MB"));
            assert!(most <= allowed * 1_000_000, "{command}, {threads}: {} MB of {allowed}", most / 1_000_000);
        }
    }
}

/// `tonemap` and `compare`, which read files completely, reject files that do not fit into the limit.
#[cfg(target_os = "linux")]
#[test]
fn memory_limit_applies_to_files_read_completely() {
    let folder = Folder::empty();
    for i in 2..=3 {
        let frame = resize(&small(i), 3000, 2000, FilterType::Triangle);
        folder.put(&format!("w{i}.jpg"), &jpeg(&frame, Some(i)));
    }
    folder
        .line("merge w2.jpg w3.jpg -q --align none --deghost=off --response-model srgb -o a.exr -o a.tif -o a.png")
        .done();
    for (command, code) in [
        ("tonemap a.exr --threads 16 -o b.png -q --force", 1),
        ("tonemap a.tif -o b.png -q --force", 1),
        ("compare a.exr a.tif -q", 2),
        ("compare a.png a.png -q", 2),
    ] {
        let run = folder.line(&format!("{command} --max-memory 100MB"));
        assert!(run.code == code && run.stderr.contains("raise it with --max-memory"), "{command}: {run:?}");
        let needed = run.stderr.split_once(" pixels needs ").and_then(|(_, rest)| rest.split_once(" MB"));
        let needed: u64 = needed.and_then(|(megabytes, _)| megabytes.parse().ok()).expect("what it needs");
        // With enough memory to decode the file, there may still not be enough for the rest of the work.
        let run = folder.line(&format!("{command} --max-memory {}MB", needed + 10));
        assert!(run.code == code, "{command}: {run:?}");
        let allowed = 350;
        let most = peak(&folder, &format!("{command} --max-memory {allowed}MB"));
        assert!(most <= allowed * 1_000_000, "{command}: {} MB of {allowed}", most / 1_000_000);
    }
}

/// A batch divides its memory among brackets, which together stay within the limit.
#[cfg(target_os = "linux")]
#[test]
fn memory_of_a_batch_is_kept_by_all_its_brackets_together() {
    let folder = Folder::empty();
    for (i, set) in (2..=4).flat_map(|i| [1, 2, 3].map(|set| (i, set))) {
        let frame = resize(&small(i), 600 + 2 * set, 400, FilterType::Triangle);
        fs::create_dir_all(folder.at(format!("in/{set}"))).expect("a folder");
        folder.put(&format!("in/{set}/w{i}.jpg"), &jpeg(&frame, Some(i)));
    }
    for (jobs, allowed) in [(1, 100), (3, 100), (3, 250)] {
        let line = format!(
            "batch in -d out{jobs}-{allowed} -q --by-folder --jobs {jobs} --threads 4 --max-memory {allowed}MB"
        );
        let most = peak(&folder, &line);
        assert!(most <= allowed * 1_000_000, "{line}: {} MB", most / 1_000_000);
    }
}
