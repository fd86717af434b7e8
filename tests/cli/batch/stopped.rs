//! Stopped batches: by Ctrl-C, and by SIGKILL.

#![cfg(unix)]

use super::{card, counts, results};
use crate::child::{begin, send};
use crate::support::Folder;
use std::fs;
use std::process::Child;
use std::time::Duration;

const BRACKETS: usize = 12;

/// A batch that runs one job at a time.
const BATCH: &str = "batch in -d out --jobs 1 --threads 1";

/// Waits until `brackets` brackets are done, or the batch has ended.
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

fn hidden(folder: &Folder) -> usize {
    let parts = |name: &str| {
        let entries = fs::read_dir(folder.at(name)).into_iter().flatten().flatten();
        entries.filter(|e| e.file_name().to_string_lossy().starts_with('.')).count()
    };
    parts("out") + parts("out/a") + parts("out/b")
}

#[test]
fn ctrl_c_finishes_running_jobs_and_a_kill_keeps_complete_results() {
    let folder = Folder::empty();
    card(&folder, BRACKETS);
    folder.line("batch in -d out -q").done();
    let whole = results(&folder);

    // If the batch ends before the signal reaches it, it is started again.
    let code = (0..10).find_map(|_| {
        fs::remove_dir_all(folder.at("out")).unwrap();
        let mut child = begin(&folder, BATCH);
        wait_for(&folder, 2, &mut child);
        send("INT", &mut child);
        child.wait().unwrap().code().filter(|&code| code != 0)
    });
    assert_eq!(code, Some(3), "some are done");
    let [first, _, failed, open] = counts(&folder);
    assert!(first >= 2 && failed == 0 && open > 0 && first + open == BRACKETS as u64);
    assert_eq!((done(&folder) as u64, hidden(&folder)), (first, 0), "nothing is half done");

    let mut child = begin(&folder, BATCH);
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
    // The last picture that was counted may belong to a job that was killed while it renamed its files.
    assert!(did + unchanged == BRACKETS as u64 && unchanged + 1 >= had, "{unchanged} of {had} were left alone");
    assert!(results(&folder) == whole);
    assert_eq!(hidden(&folder), 0);
}
