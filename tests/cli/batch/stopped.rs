//! A batch that is stopped: by Ctrl-C, and by a kill that nothing can hear.

#![cfg(unix)]

use super::{card_of, counts, results};
use crate::support::Folder;
use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

const BRACKETS: usize = 12;

/// A batch of one job that goes on.
fn begin(folder: &Folder) -> Child {
    Command::new(env!("CARGO_BIN_EXE_hdralign"))
        .args(["batch", "in", "-d", "out", "--jobs", "1", "--threads", "1"])
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the program starts")
}

/// Waits until so many brackets are done, or the batch has ended.
fn wait_for(folder: &Folder, brackets: usize, child: &mut Child) {
    while done(folder) < brackets && child.try_wait().expect("its state").is_none() {
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn done(folder: &Folder) -> usize {
    let pictures = |name: &str| {
        let entries = fs::read_dir(folder.at(name)).into_iter().flatten().flatten();
        entries.filter(|e| e.path().extension().is_some_and(|x| x == "png")).count()
    };
    pictures("out/a") + pictures("out/b")
}

/// Sends `signal` to `child`, unless it has ended.
fn send(signal: &str, child: &mut Child) {
    if child.try_wait().expect("its state").is_none() {
        let sent = Command::new("kill").args([signal, &child.id().to_string()]).status().expect("kill");
        assert!(sent.success());
    }
}

fn hidden(folder: &Folder) -> usize {
    let parts = |name: &str| {
        let entries = fs::read_dir(folder.at(name)).into_iter().flatten().flatten();
        entries.filter(|e| e.file_name().to_string_lossy().starts_with('.')).count()
    };
    parts("out") + parts("out/a") + parts("out/b")
}

/// A folder with a batch that was interrupted when some of its brackets were done, and what all of them give. Where the machine is so busy that a batch is
/// quicker than the look at its folder, photographs of four times the pixels are tried.
fn interrupted() -> (Folder, Vec<(PathBuf, Vec<u8>)>) {
    for width in [150, 300, 600, 1200] {
        let folder = Folder::empty();
        card_of(&folder, BRACKETS, width);
        folder.line("batch in -d out -q").done();
        let whole = results(&folder);
        fs::remove_dir_all(folder.at("out")).unwrap();
        let mut child = begin(&folder);
        wait_for(&folder, 2, &mut child);
        send("-INT", &mut child);
        let code = child.wait().unwrap().code();
        if code != Some(0) {
            assert_eq!(code, Some(3), "some are done");
            return (folder, whole);
        }
    }
    panic!("every batch was quicker than the look at its folder");
}

#[test]
fn ctrl_c_ends_what_has_begun_and_a_kill_loses_nothing_that_was_whole() {
    let (folder, whole) = interrupted();
    let [first, _, failed, open] = counts(&folder);
    assert!(first >= 2 && failed == 0 && open > 0 && first + open == BRACKETS as u64);
    assert_eq!((done(&folder) as u64, hidden(&folder)), (first, 0), "nothing is half done");

    let mut child = begin(&folder);
    wait_for(&folder, first as usize + 2, &mut child);
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(
        results(&folder).iter().filter(|(path, _)| !path.ends_with(".part")).all(|result| {
            let is_part = result.0.extension().is_some_and(|e| e == "part");
            is_part || whole.contains(result)
        }),
        "a name that exists is a file that is whole"
    );
    let had = done(&folder) as u64;

    folder.line("batch in -d out -q").done();
    let [did, unchanged, ..] = counts(&folder);
    // The step that was being named when it was killed may have been whole but for one name.
    assert!(did + unchanged == BRACKETS as u64 && unchanged + 1 >= had, "{unchanged} of {had} were left alone");
    assert!(results(&folder) == whole);
    assert_eq!(hidden(&folder), 0);
}
