//! What is left of a run that ends too early: nothing, or what the next one clears away. The first test ends the writing of this test program
//! for good: others here write nothing by themselves.

mod support;

use hdralign::error::Error;
use hdralign::write::{self, Pending};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;
use support::{Folder, without};

fn unnamed(folder: &Path) -> usize {
    let names = fs::read_dir(folder).expect("the folder").flatten().map(|e| e.file_name());
    names.filter(|name| name.to_string_lossy().starts_with(".hdralign-")).count()
}

#[test]
fn after_the_end_nothing_is_there_and_nothing_comes() {
    let folder = Folder::empty();
    let at = |name: &str| folder.at(name);
    let pending = write::text(&at("a.txt"), "a").unwrap().file;
    let whole = write::whole(&at("b.txt"), b"b").unwrap();
    let new = write::NewFolder::create(&at("new")).unwrap();
    let inside = write::whole(&at("new/c.txt"), b"c").unwrap();
    write::abandon();
    assert!(folder.listing().is_empty(), "at once");
    let is_abandoned = |error: Error, name: &str| {
        let text = error.to_string();
        assert!(matches!(error, Error::Abandoned { .. }) && text.contains(name) && !error.is_usage(), "{text}");
    };
    is_abandoned(write::commit(vec![pending], true).unwrap_err(), "a.txt");
    is_abandoned(write::place(vec![whole], true).unwrap_err(), "b.txt");
    is_abandoned(Pending::create(&at("c.txt")).unwrap_err(), "c.txt");
    is_abandoned(write::NewFolder::create(&at("d")).unwrap_err(), "d: is not written");
    drop((inside, new));
    assert!(folder.listing().is_empty());
}

/// A run that is killed while it writes, which is seen by its temporary files; the system has no anonymous ones.
#[test]
fn what_a_killed_process_left_is_swept_but_not_what_a_living_one_writes() {
    let Some([python, script, lacks]) = without("anonymous") else { return };
    let folder = Folder::with_bracket();
    // They have the names of temporary files, and are the user's.
    folder.put(".hdralign-notes.part", b"mine");
    folder.put(".hdralign-aaaaaaaaaaaa-0.part", b"mine");
    let users = unnamed(folder.path());
    let inputs = folder.listing();
    let mut was_killed = false;
    // A run that is quicker than the look at its folder is done again.
    for _ in 0..10 {
        let mut run = Command::new(&python)
            .args([&script, &lacks, env!("CARGO_BIN_EXE_hdralign")])
            .args(["merge", "w1.jpg", "w2.jpg", "w3.jpg", "-q", "--force", "-o", "a.exr", "-o", "a.png", "-o", "a.jpg"])
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .expect("the program starts");
        while unnamed(folder.path()) == users && run.try_wait().expect("its state").is_none() {}
        // Between a file's first moment and its lock, on a machine that has other things to do.
        std::thread::sleep(Duration::from_millis(10));
        assert_eq!(write::sweep(folder.path()), 0, "it lives");
        run.kill().expect("an end");
        was_killed = !run.wait().expect("its end").success();
        if was_killed && unnamed(folder.path()) > users {
            break;
        }
    }
    let left = unnamed(folder.path()) - users;
    assert!(was_killed && left > 0, "no run was caught writing");
    assert_eq!((write::sweep(folder.path()), unnamed(folder.path())), (left, users));
    let names = |name: &&(String, u64)| !inputs.contains(name);
    assert!(folder.listing().iter().filter(names).all(|(name, _)| name.starts_with("a.")));
}
