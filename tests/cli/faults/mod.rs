//! Failures of the machine, tested with the program: a clear message, the right exit code, no incomplete file under a
//! final name, no temporary file left. docs/reference/faults.md lists the failures with these tests.

#![cfg(unix)]

mod disk;
mod inputs;
mod limits;
mod places;
mod signals;
mod streams;

use crate::support::{Folder, Run, jpeg, program, shrink, window};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::OnceLock;

/// Creates a folder with three frames of 150 x 100 pixels, `w2.jpg` to `w4.jpg`, so that every run takes a fraction of
/// a second.
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

/// The names of the frames of [`bracket`], for a command line.
const FRAMES: &str = "w2.jpg w3.jpg w4.jpg";

/// Runs `script` in `folder` with sh; `$H` is the program. If a signal ends the script, the code is that of a shell:
/// 128 plus the number of the signal.
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

/// Runs `script`, and checks the exit code, that the message contains all of `said`, that there was no panic, and that
/// no file was left or lost.
fn fails(folder: &Folder, script: &str, code: i32, said: &[&str]) {
    let before = folder.listing();
    let run = shell(folder, script);
    assert_eq!(run.code, code, "{script}\n{}", run.stderr);
    for part in said {
        assert!(run.stderr.contains(part), "{script}\n{}does not say {part:?}", run.stderr);
    }
    assert!(!run.stderr.contains("panicked"), "{script}\n{}", run.stderr);
    assert_eq!(folder.listing(), before, "{script}: something was left behind, or lost");
}

/// Returns the number of temporary files in `folder` and below it.
fn unnamed(folder: &Path) -> usize {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let count = |entry: std::fs::DirEntry| match entry.file_type() {
        Ok(kind) if kind.is_dir() => unnamed(&entry.path()),
        _ => usize::from(entry.file_name().to_string_lossy().starts_with(".hdralign-")),
    };
    entries.map(count).sum()
}
