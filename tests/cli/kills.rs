//! Runs are killed at random moments by SIGKILL: every file with its final name is complete, and all other files are
//! temporary files, which the next run removes.
//!
//! `HDRALIGN_KILLS` sets the number of kills (12 by default), `HDRALIGN_SEED` the seed of their moments, and
//! `HDRALIGN_BIN` the program. A third of the kills are during a `merge` to new files, a third during a `merge --force`
//! that replaces older files, and a third during a `batch` that is continued after each kill.

#![cfg(unix)]

use crate::support::card::Card;
use crate::support::{Folder, jpeg, program, shrink, window, without};
use hdralign::write;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const MERGE: &str =
    "merge w2.jpg w3.jpg w4.jpg -q -o r/a.exr -o r/a.png -o r/a.jpg -o r/a.tif -o r/a.hdr --save-response r/a.csv";
const OLDER: &str = "--response-model srgb --tmo drago";
const BATCH: &str = "batch in -d out -q --formats exr,png";

/// A generator of random numbers: SplitMix64 (Steele, Lea & Flood 2014).
struct Random(u64);

impl Random {
    /// Returns a number from 0 to 1.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn number(variable: &str) -> Option<u64> {
    std::env::var(variable).ok().and_then(|text| text.parse().ok())
}

/// Returns all files in `folder` and below it, with their contents.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else {
                all.insert(path.clone(), fs::read(&path).expect("a file"));
            }
        }
    }
    all
}

fn is_unnamed(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with(".hdralign-") && (name.ends_with(".part") || name.ends_with(".lock"))
}

/// Returns whether the process has created a temporary file in `folder`: one with a temporary name, or on Linux one
/// without a name.
fn is_writing(process: u32, folder: &Path) -> bool {
    let names = fs::read_dir(folder).into_iter().flatten().flatten();
    let open = fs::read_dir(format!("/proc/{process}/fd")).into_iter().flatten().flatten();
    let is_anonymous = |file: PathBuf| file.starts_with(folder) && file.to_string_lossy().ends_with(" (deleted)");
    names.into_iter().any(|entry| is_unnamed(&entry.path()))
        || open.filter_map(|entry| fs::read_link(entry.path()).ok()).any(is_anonymous)
}

/// Runs `line` to its end. Returns the time that it took.
fn run(folder: &Folder, line: &str) -> Duration {
    let began = Instant::now();
    folder.line(line).done();
    began.elapsed()
}

/// The moment of a kill.
enum When {
    /// The time after the start of the run.
    After(Duration),
    /// The time after the first temporary file appears in the folder: while the run writes or renames files.
    Writing(PathBuf, Duration),
}

impl When {
    /// Returns a random moment of a run that takes the time `whole` and writes to `folder`. In half of the cases it is
    /// any moment, in the others a moment after the first temporary file, within a fifth of `whole`.
    fn of(random: &mut Random, whole: Duration, folder: &Path) -> When {
        let (is_any, part) = (random.next() < 0.5, random.next());
        if is_any {
            When::After(whole.mul_f64(part))
        } else {
            When::Writing(folder.to_owned(), whole.mul_f64(part / 5.0))
        }
    }
}

/// Starts the program with the arguments `line`, by way of the command `before`, and kills it. Returns whether it was
/// still running.
fn kill(folder: &Folder, line: &str, before: &[String], when: When) -> bool {
    let program = program().to_string_lossy().into_owned();
    let words: Vec<&str> = before.iter().chain([&program]).map(String::as_str).chain(line.split_whitespace()).collect();
    let mut command = Command::new(words[0]);
    command.args(&words[1..]).current_dir(folder.path());
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts");
    match when {
        When::After(pause) => std::thread::sleep(pause),
        When::Writing(folder, pause) => {
            let folder = fs::canonicalize(&folder).unwrap_or(folder);
            while child.try_wait().expect("its state").is_none() && !is_writing(child.id(), &folder) {}
            std::thread::sleep(pause);
        }
    }
    child.kill().expect("an end");
    !child.wait().expect("its end").success()
}

/// Counts of kills and of files that were checked, for messages.
#[derive(Debug, Default)]
struct Tally {
    kills: usize,
    /// Number of kills before the end of the run.
    in_time: usize,
    /// Number of files with their final names that were checked.
    named: usize,
    /// Number of temporary files that killed runs left, and the next runs removed.
    unnamed: usize,
}

impl Tally {
    /// Checks that every file in `folder` with its final name is equal to the same file in one of `whole` or, if it is
    /// a report or summary, is complete JSON or CSV. All other files must be temporary files.
    fn check(&mut self, folder: &Path, whole: &[&BTreeMap<PathBuf, Vec<u8>>]) {
        for (path, bytes) in files(folder) {
            if is_unnamed(&path) {
                self.unnamed += 1;
                continue;
            }
            self.named += 1;
            // Reports and summaries contain times, so their bytes differ.
            let is_whole = match path.extension().and_then(|e| e.to_str()) {
                Some("json") => serde_json::from_slice::<serde_json::Value>(&bytes).is_ok(),
                Some("csv") if path.ends_with("batch.csv") => bytes.ends_with(b"\n"),
                _ => whole.iter().any(|whole| whole.get(&path) == Some(&bytes)),
            };
            assert!(is_whole, "{} is damaged: {} bytes; {self:?}", path.display(), bytes.len());
        }
    }
}

/// Returns whether `folder` contains exactly the results in `whole`, and no temporary files; reports are not compared.
fn is_complete(folder: &Path, whole: &BTreeMap<PathBuf, Vec<u8>>) -> bool {
    let is_result = |path: &Path| path.extension().is_some_and(|e| e != "json" && !path.ends_with("batch.csv"));
    let there: BTreeMap<_, _> = files(folder).into_iter().filter(|(path, _)| is_result(path)).collect();
    let wanted: BTreeMap<_, _> = whole.iter().filter(|(path, _)| is_result(path)).collect();
    there.iter().eq(wanted)
}

#[test]
fn killed_runs_leave_complete_files_and_temporary_ones_that_are_removed() {
    let folder = Folder::empty();
    for i in 2..=4 {
        let picture = image::open(window(i)).expect("a frame").to_rgb8();
        folder.put(&format!("w{i}.jpg"), &jpeg(&shrink(&picture, 8), Some(i)));
    }
    Card::new(100).brackets(4, 3, 2.0).write(&folder.at("in"));
    let (results, out) = (folder.at("r"), folder.at("out"));
    fs::create_dir(&results).expect("a folder");

    run(&folder, &format!("{MERGE} {OLDER}"));
    let older = files(&results);
    let mut merging = run(&folder, &format!("{MERGE} --force"));
    let newer = files(&results);
    assert!(newer.len() == 6 && newer.iter().all(|(path, bytes)| older[path] != *bytes), "the two differ");
    let batching = run(&folder, BATCH);
    let night = files(&out);

    let without = without("anonymous").map_or(Vec::new(), Vec::from);
    let mut random = Random(number("HDRALIGN_SEED").unwrap_or(1));
    let mut tally = Tally::default();
    let wanted = number("HDRALIGN_KILLS").unwrap_or(12) as usize;
    // A kill that comes after the end of the run, because the machine is less busy than before, is repeated.
    for i in 0.. {
        if tally.in_time >= wanted {
            break;
        }
        assert!(tally.kills < 4 * wanted, "too few came in time: {tally:?}");
        tally.kills += 1;
        // Every second run is as on a system without anonymous files.
        let before = if i % 2 == 1 { &without[..] } else { &[] };
        let mut when = |whole: Duration, folder: &Path| When::of(&mut random, whole, folder);
        match i % 3 {
            0 => {
                fs::remove_dir_all(&results).and_then(|()| fs::create_dir(&results)).expect("an empty folder");
                tally.in_time += usize::from(kill(&folder, MERGE, before, when(merging, &results)));
                tally.check(&results, &[&newer]);
                merging = run(&folder, &format!("{MERGE} --force"));
                assert!(is_complete(&results, &newer), "{tally:?}");
            }
            1 => {
                older.iter().for_each(|(path, bytes)| fs::write(path, bytes).expect("an older file"));
                tally.in_time +=
                    usize::from(kill(&folder, &format!("{MERGE} --force"), before, when(merging, &results)));
                tally.check(&results, &[&older, &newer]);
                assert!(newer.keys().all(|path| path.is_file()), "an older file was lost: {tally:?}");
                merging = run(&folder, &format!("{MERGE} --force"));
                assert!(is_complete(&results, &newer), "{tally:?}");
            }
            _ => {
                if i % 2 == 0 {
                    fs::remove_dir_all(&out).expect("the results of the night");
                }
                tally.in_time += usize::from(kill(&folder, BATCH, before, when(batching, &out)));
                tally.check(&out, &[&night]);
                // Every second batch is killed again while it continues after the first kill.
                if i % 2 == 1 {
                    tally.in_time += usize::from(kill(&folder, BATCH, before, when(batching, &out)));
                    tally.kills += 1;
                    tally.check(&out, &[&night]);
                }
                run(&folder, BATCH);
                assert!(is_complete(&out, &night), "{tally:?}");
            }
        }
    }
    println!("{tally:?}");
}

/// A run is killed while it writes, which its temporary files show; it runs as on a system without anonymous files.
#[test]
#[ignore = "filters system calls; .ci/run runs it where the system allows that"]
fn files_of_a_killed_process_are_removed_and_of_a_running_one_kept() {
    let [python, script, lacks] = without("anonymous").expect("a filter of system calls");
    let folder = Folder::with_bracket();
    // Files of the user that have names like those of temporary files.
    folder.put(".hdralign-notes.part", b"mine");
    folder.put(".hdralign-aaaaaaaaaaaa-0.part", b"mine");
    let unnamed = || files(folder.path()).keys().filter(|path| is_unnamed(path)).count();
    let users = unnamed();
    let inputs = folder.listing();
    let mut was_killed = false;
    // If the run ends before its temporary files are seen, it is repeated.
    for _ in 0..10 {
        let mut run = Command::new(&python)
            .args([script.as_str(), lacks.as_str()])
            .arg(program())
            .args(["merge", "w1.jpg", "w2.jpg", "w3.jpg", "-q", "--force", "-o", "a.exr", "-o", "a.png", "-o", "a.jpg"])
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .expect("the program starts");
        while unnamed() == users && run.try_wait().expect("its state").is_none() {}
        // On a busy machine, some time may pass between the creation and the lock of a file.
        std::thread::sleep(Duration::from_millis(10));
        assert_eq!(write::sweep(folder.path()), 0, "it lives");
        run.kill().expect("an end");
        was_killed = !run.wait().expect("its end").success();
        if was_killed && unnamed() > users {
            break;
        }
    }
    let left = unnamed() - users;
    assert!(was_killed && left > 0, "no run was caught writing");
    assert_eq!((write::sweep(folder.path()), unnamed()), (left, users));
    let names = |name: &&(String, u64)| !inputs.contains(name);
    assert!(folder.listing().iter().filter(names).all(|(name, _)| name.starts_with("a.")));
}
