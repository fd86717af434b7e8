//! Full disks: files that exceed `ulimit -f`, and small disks in memory.

use super::{FRAMES, bracket, fails, shell, unnamed};
use crate::support::card::Card;
use crate::support::{Folder, Run};
use serde_json::Value;
use std::fs;

/// Runs `script` while the folder `full` is a disk in memory of `size` bytes; the disk is removed afterwards.
fn on_disk(folder: &Folder, size: &str, script: &str) -> Run {
    fs::create_dir_all(folder.at("full")).expect("a folder");
    let script = format!("mount -t tmpfs -o size={size} none full && {script}");
    let run = shell(folder, &format!("unshare -rm sh -c '{script}'"));
    assert!(!run.stderr.contains("unshare:") && !run.stderr.contains("mount:"), "no disk of memory: {run:?}");
    run
}

#[test]
fn file_size_limit_names_the_file_and_leaves_no_files() {
    let folder = bracket();
    folder.line(&format!("merge {FRAMES} -q -o a.exr -o b.exr -o a.png")).done();
    // The limits, in blocks of 512 bytes, are smaller than each of the files.
    for (blocks, line, name) in [
        (8, "merge FRAMES -q -o c.exr", "c.exr"),
        (8, "merge FRAMES -q -o c.hdr", "c.hdr"),
        (8, "merge FRAMES -q -o c.tif", "c.tif"),
        (8, "merge FRAMES -q -o c.png", "c.png"),
        (8, "merge FRAMES -q -o c.jpg", "c.jpg"),
        (8, "merge FRAMES -q -o c.jpg --gain-map none", "c.jpg"),
        (8, "merge FRAMES -q -o c.exr --force -o a.exr", "c.exr"),
        (1, "align FRAMES -q --report r.json", "r.json"),
        (8, "align FRAMES -q --report r.html", "r.html"),
        (1, "align FRAMES -q --transforms t.json", "t.json"),
        (8, "align FRAMES -q --save-aligned on_", "on_w"),
        (8, "response FRAMES -q -o r.json", "r.json"),
        (8, "response FRAMES -q", ".json"),
        (8, "response FRAMES -q -o r.csv", "r.csv"),
        (8, "response FRAMES -q -o r.json --plot r.png", "r."),
        (8, "inspect FRAMES -q -d look", "look/"),
        (8, "tonemap a.exr -q -o c.png", "c.png"),
        (1, "man pages", "pages/hdralign"),
    ] {
        let line = line.replace("FRAMES", FRAMES);
        if line.starts_with("man") {
            fs::create_dir_all(folder.at("pages")).expect("a folder");
        }
        fails(
            &folder,
            &format!("ulimit -f {blocks}; $H {line}"),
            1,
            &[name, "cannot be written", "File too large", "ulimit -f"],
        );
    }
    // An error of `compare` has exit code 2, because 1 means that the files differ.
    let grown = ["d.png", "cannot be written", "ulimit -f"];
    fails(&folder, "ulimit -f 1; $H compare a.exr b.exr -q --diff d.png", 2, &grown);
    fails(&folder, "ulimit -f 8; $H compare e.exr a.exr -q --bless", 2, &["e.exr", "ulimit -f"]);
    let scratch =
        "ulimit -f 8; $H merge FRAMES -q --threads 16 --max-memory 64MB --scratch . -o c.exr".replace("FRAMES", FRAMES);
    fails(&folder, &scratch, 1, &["File too large", "--scratch", "--max-memory"]);
}

#[test]
fn full_disk_names_no_file_of_a_run_and_keeps_older_ones() {
    let folder = bracket();
    let files = "-o a.png -o a.jpg -o a.hdr -o a.tif -o a.exr --report a.json";
    folder.line(&format!("merge {FRAMES} -q {files} --response-model srgb")).done();
    let sizes: Vec<(String, u64)> = folder.listing().into_iter().filter(|(name, _)| name.starts_with("a.")).collect();
    let before: Vec<Vec<u8>> = sizes.iter().map(|(name, _)| folder.bytes(name)).collect();
    let mut by_size = sizes.clone();
    by_size.sort_by_key(|(_, size)| std::cmp::Reverse(*size));
    let [(largest, size), (_, second), ..] = &by_size[..] else { panic!("six files: {sizes:?}") };
    // The limit, in units of 512 bytes, is large enough for all files except the largest, also with another response.
    let script = format!("ulimit -f {}; $H merge {FRAMES} -q --force {files}", (size + second) / 2 / 512);
    fails(&folder, &script, 1, &[largest, "File too large"]);
    assert!(sizes.iter().zip(&before).all(|((name, _), bytes)| folder.bytes(name) == *bytes), "an older one was lost");
    for (name, _) in &sizes {
        fs::remove_file(folder.at(name)).expect("a file");
    }
    fails(&folder, &script, 1, &[largest]);
}

#[test]
#[ignore = "mounts a disk of memory; .ci/run runs it where the system allows that"]
fn full_disk_names_the_file_and_the_remedy() {
    let folder = bracket();
    for (size, line) in [
        ("40k", "merge FRAMES -q -o full/c.exr"),
        ("20k", "merge FRAMES -q -o full/c.png"),
        ("20k", "merge FRAMES -q -o full/c.jpg"),
        ("100k", "merge FRAMES -q -o full/c.hdr -o full/c.tif -o full/c.exr"),
        ("20k", "align FRAMES -q --save-aligned full/on_"),
        ("20k", "align FRAMES -q --report full/r.html"),
        ("4k", "response FRAMES -q -o full/r.json"),
        ("60k", "inspect FRAMES -q -d full/look"),
        ("16k", "man full"),
    ] {
        let line = line.replace("FRAMES", FRAMES);
        let run = on_disk(&folder, size, &format!("{{ $H {line}; echo $?; ls -A full; }}"));
        assert_eq!(run.stdout, "1\n", "{line}: {run:?}");
        let is_reported =
            run.stderr.contains("full/") && run.stderr.contains("delete some files there, or write to another disk");
        assert!(is_reported && run.stderr.lines().count() == 1, "{line}: {}", run.stderr);
    }
    let line =
        format!("$H merge {FRAMES} -q --threads 16 --max-memory 64MB --scratch full -o c.exr; echo $?; ls -A full");
    let run = on_disk(&folder, "40k", &line);
    assert_eq!(run.stdout, "1\n", "{run:?}");
    assert!(run.stderr.contains("full: ") && run.stderr.contains("name another folder with --scratch"), "{run:?}");
    assert!(!folder.at("c.exr").exists());
}

#[test]
#[ignore = "mounts a disk of memory; .ci/run runs it where the system allows that"]
fn a_disk_that_is_read_only_is_named() {
    let folder = bracket();
    let line = format!("mount -o remount,ro full && {{ $H merge {FRAMES} -q -o full/c.exr; echo $?; ls -A full; }}");
    let run = on_disk(&folder, "1m", &line);
    assert_eq!(run.stdout, "1\n", "{run:?}");
    assert!(run.stderr.contains("full/c.exr") && run.stderr.contains("mount this one for writing"), "{run:?}");
}

/// The full disk is reported once, and no further bracket is started; with more space, the next run merges only the
/// missing brackets.
#[test]
#[ignore = "mounts a disk of memory; .ci/run runs it where the system allows that"]
fn a_batch_on_a_full_disk_stops_and_is_taken_up_again() {
    let folder = Folder::empty();
    Card::new(150).brackets(8, 3, 2.0).write(&folder.at("in"));
    folder.line("batch in -d whole -q --formats exr,png").done();
    let batch = "$H batch in -d full -q --formats exr,png --jobs 1 --threads 1";
    let script = format!(
        "{batch} 2>first; echo $?; ls -A full | grep -c part; ls full | grep -c exr; \
         mount -o remount,size=16m full; {batch} --json >second; echo $?; cp -r full kept"
    );
    // The results of each bracket take about 110 kB.
    let run = on_disk(&folder, "400k", &script);
    let reported: Vec<&str> = run.stdout.split_whitespace().filter(|word| word.parse::<u32>().is_ok()).collect();
    let first = String::from_utf8_lossy(&folder.bytes("first")).into_owned();
    let done: usize = reported[2].parse().expect("a number");
    assert!((reported[0], reported[1], reported[3]) == ("3", "0", "0") && (1..8).contains(&done), "{run:?} {first}");
    assert_eq!(first.matches("the quota is used up, so no further bracket is started").count(), 1, "{first}");
    // No bracket is started after the first failure, but brackets that were computed before it may fail too.
    assert!((1..=3).contains(&first.matches("failed: ").count()), "{first}");
    let summary: Value = serde_json::from_slice(&folder.bytes("second")).expect("JSON");
    let counts = ["done", "unchanged", "failed", "not_done"].map(|key| summary["counts"][key].as_u64());
    assert_eq!(counts, [Some(8 - done as u64), Some(done as u64), Some(0), Some(0)], "{first}");
    for entry in fs::read_dir(folder.at("whole")).expect("a folder").flatten() {
        let path = entry.path();
        if path.extension().is_some_and(|e| e == "exr" || e == "png") {
            let kept = folder.at("kept").join(entry.file_name());
            assert!(fs::read(&path).expect("a result") == fs::read(&kept).expect("the same"), "{path:?}");
        }
    }
    assert_eq!(unnamed(folder.path()), 0);
}

/// Results are kept although there is no space for the summary.
#[test]
fn unwritable_summary_does_not_affect_results() {
    let folder = Folder::empty();
    Card::new(64).brackets(2, 3, 2.0).write(&folder.at("in"));
    // A folder with the name of the summary is reported before any work.
    fs::create_dir_all(folder.at("out/batch.json")).expect("a folder in its place");
    fails(&folder, "$H batch in -d out --formats png", 1, &["out/batch.json", "it is a folder"]);
    assert_eq!(fs::read_dir(folder.at("out")).expect("the folder").count(), 1);
    fs::remove_dir(folder.at("out/batch.json")).expect("the folder");
    // Only the summary is longer than the limit, because it has an entry for each raw file.
    (0..1000).for_each(|i| folder.put(&format!("in/{i}.cr2"), b""));
    let run = shell(&folder, "ulimit -f 100; $H batch in -d out --formats png");
    assert_eq!(run.code, 3, "{run:?}");
    assert!(run.stderr.contains("batch.json: cannot be written: File too large"), "{run:?}");
    assert!(run.stderr.contains("brackets   2 done"), "{run:?}");
    assert_eq!((run.stdout.lines().count(), unnamed(folder.path())), (2, 0));
}
