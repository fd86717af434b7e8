//! Faults of the machine, one after the other, through the binary: a clear message, the right exit code, nothing half under a final name,
//! no temporary file left. docs/faults.md is the table of them, and names these tests.

#![cfg(unix)]

#[path = "../support/mod.rs"]
mod support;

mod disk;
mod inputs;
mod limits;
mod places;
mod signals;
mod streams;

use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use support::{Folder, Run, jpeg, program, shrink, window};

/// Three frames of 150 x 100 pixels, `w2.jpg` to `w4.jpg`: every run is a fraction of a second.
fn bracket() -> Folder {
    static FILES: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    let tiny = |i: usize| jpeg(&shrink(&image::open(window(i)).expect("a frame").to_rgb8(), 8), Some(i));
    let files = FILES.get_or_init(|| (2..=4).map(tiny).collect());
    let folder = Folder::empty();
    for (i, file) in files.iter().enumerate() {
        folder.put(&format!("w{}.jpg", i + 2), file);
    }
    folder
}

/// Their names, for a command line.
const FRAMES: &str = "w2.jpg w3.jpg w4.jpg";

/// Runs `script` in `folder`, by sh; `$H` is the program. A signal that ends it is told as a shell does, by 128 and its number.
fn shell(folder: &Folder, script: &str) -> Run {
    let output = Command::new("sh")
        .args(["-c", script])
        .env("H", program())
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .output()
        .expect("a shell");
    let code = output.status.code().or_else(|| output.status.signal().map(|n| 128 + n)).expect("an end");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Run { code, stdout: text(&output.stdout), stderr: text(&output.stderr) }
}

/// As [`shell`], and again where Rust's own runtime ended itself: a thread that was given its stack, and then no room for the small one that
/// the runtime puts beside it, says so and aborts before any of the program runs.
fn settled(folder: &Folder, script: &str) -> Run {
    let is_settled = |run: &Run| !run.stderr.contains("failed to allocate an alternative stack");
    let mut tries = std::iter::repeat_with(|| shell(folder, script)).take(8);
    tries.find(is_settled).unwrap_or_else(|| shell(folder, script))
}

/// Runs `script`, and holds what every failure has in common: the exit code, a message with all of `said`, no panic, and nothing left behind or lost.
fn fails(folder: &Folder, script: &str, code: i32, said: &[&str]) {
    let before = folder.listing();
    let run = settled(folder, script);
    assert_eq!(run.code, code, "{script}\n{}", run.stderr);
    for part in said {
        assert!(run.stderr.contains(part), "{script}\n{}does not say {part:?}", run.stderr);
    }
    assert!(!run.stderr.contains("panicked"), "{script}\n{}", run.stderr);
    assert_eq!(folder.listing(), before, "{script}: something was left behind, or lost");
}

/// Temporary files below `folder`.
fn unnamed(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let count = |entry: std::fs::DirEntry| match entry.file_type() {
        Ok(kind) if kind.is_dir() => unnamed(&entry.path()),
        _ => usize::from(entry.file_name().to_string_lossy().starts_with(".hdralign-")),
    };
    entries.map(count).sum()
}

/// Whether this machine lets us `script`; where it does not, a test says so and holds nothing.
fn can(what: &str, script: &str) -> bool {
    let done = Command::new("sh").args(["-c", script]).stdout(Stdio::null()).stderr(Stdio::null()).status();
    let can = done.is_ok_and(|status| status.success());
    if !can {
        eprintln!("NOT TESTED: this machine does not let us {what}");
    }
    can
}
