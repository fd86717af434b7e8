//! Signals at many moments of every command leave all results or none, and never a temporary file.
//!
//! `HDRALIGN_MOMENTS` is the number of moments for each command; 12 by default.

use super::{FRAMES, bracket, shell, unnamed};
use crate::child::{begin, send};
use crate::support::Folder;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::time::{Duration, Instant};

fn moments() -> u32 {
    std::env::var("HDRALIGN_MOMENTS").ok().and_then(|text| text.parse().ok()).unwrap_or(12)
}

/// Sends a signal at moments from the start to the end of `line`, which writes the files `outputs`.
fn interrupted(folder: &Folder, line: &str, outputs: &[&str]) {
    let before = folder.listing();
    let clear = || {
        for name in outputs {
            let _ = fs::remove_file(folder.at(name));
            if let Some(parent) = folder.at(name).parent().filter(|parent| *parent != folder.path()) {
                let _ = fs::remove_dir_all(parent);
            }
        }
        assert_eq!(folder.listing(), before, "{line}");
    };
    let began = Instant::now();
    assert!(begin(folder, line).wait().expect("its end").success(), "{line}");
    let whole = began.elapsed();
    assert!(outputs.iter().all(|name| folder.at(name).is_file()), "{line}");
    clear();
    let mut stopped = 0;
    for i in 0..moments() {
        let (signal, number) = [("INT", 2), ("TERM", 15), ("HUP", 1), ("XCPU", 24)][i as usize % 4];
        let mut child = begin(folder, line);
        std::thread::sleep(whole * i / moments() + Duration::from_millis(2));
        send(signal, &mut child);
        let end = child.wait().expect("its end");
        let there = outputs.iter().filter(|name| folder.at(name).exists()).count();
        let said = format!("{line}: {signal} at moment {i}: {end}, {there} files");
        // A signal has its default effect until the program has installed its handlers.
        let is_stopped = end.code() == Some(128 + number) || end.signal() == Some(number);
        assert!(is_stopped || end.success(), "{said}");
        // A signal after the work is done affects only the exit code.
        assert!(there == outputs.len() || is_stopped && there == 0, "{said}");
        assert_eq!(unnamed(folder.path()), 0, "{said}");
        stopped += u32::from(there == 0);
        clear();
    }
    assert!(stopped > 0, "{line}: no moment was early enough");
}

#[test]
fn interrupted_merge_leaves_all_files_or_none() {
    let line =
        format!("merge {FRAMES} -o a.exr -o a.png -o a.jpg -o a.tif -o a.hdr --report a.html --save-response a.rsp");
    interrupted(&bracket(), &line, &["a.exr", "a.png", "a.jpg", "a.tif", "a.hdr", "a.html", "a.rsp"]);
}

#[test]
fn interrupted_align_leaves_all_files_or_none() {
    let line =
        format!("align {FRAMES} --save-aligned on_ --transforms t.json --threads 16 --max-memory 64MB --scratch .");
    interrupted(&bracket(), &line, &["on_w2.tif", "on_w3.tif", "on_w4.tif", "t.json"]);
}

#[test]
fn interrupted_tonemap_and_response_leave_all_files_or_none() {
    let folder = bracket();
    folder.line(&format!("merge {FRAMES} -q -o map.exr")).done();
    interrupted(&folder, "tonemap map.exr --tmo mantiuk06 -o b.png -o b.jpg", &["b.png", "b.jpg"]);
    interrupted(&folder, &format!("response {FRAMES} -o r.json -o r.csv --plot r.png"), &["r.json", "r.csv", "r.png"]);
}

#[test]
fn interrupted_inspect_leaves_the_complete_folder_or_none() {
    interrupted(&bracket(), &format!("inspect {FRAMES} -d look"), &["look/tables.txt", "look/w2.threshold.png"]);
}

/// The program is started with an ignored signal, as by `nohup`, or by a shell in the background.
#[test]
fn ignored_signals_stay_ignored() {
    let folder = bracket();
    for (i, signal) in ["HUP", "INT"].into_iter().enumerate() {
        let script = format!(
            "trap '' {signal}; $H merge {FRAMES} -q -o a{i}.exr & \
             for k in 1 2 3 4 5 6 7 8; do kill -{signal} $! 2>/dev/null; sleep 0.02; done; wait $!"
        );
        let run = shell(&folder, &script);
        assert_eq!((run.code, run.stderr.as_str(), run.stdout), (0, "", format!("a{i}.exr\n")), "{signal}");
    }
    assert!(folder.bytes("a0.exr") == folder.bytes("a1.exr"));
}

/// Without /proc, as on systems that do not list ignored signals (macOS, BSD).
#[test]
#[ignore = "mounts over /proc; .ci/run runs it where the system allows that"]
fn ignored_signals_are_found_without_a_list_of_them() {
    let folder = bracket();
    // The program waits for a photograph from a pipe, so that no signal is too late. Processes that a shell runs in the
    // background ignore INT; with `trap "" HUP`, as with nohup, also HUP.
    for (ignore, signal, code) in [("trap \"\" HUP", "HUP", 0), (":", "HUP", 129), (":", "INT", 0)] {
        let script = format!(
            "rm -f p.jpg; mkfifo p.jpg; unshare -rm env --default-signal=HUP sh -c 'mount -t tmpfs none /proc; {ignore}; \
             $H merge w2.jpg w3.jpg p.jpg --force -q -o a.exr & sleep 0.1; \
             for k in 1 2 3 4; do kill -{signal} $! 2>/dev/null; sleep 0.02; done; exec 3<>p.jpg; cat w4.jpg >&3; exec 3>&-; wait $!'"
        );
        let run = shell(&folder, &script);
        assert_eq!(run.code, code, "{signal} {ignore} {run:?}");
        assert_eq!(unnamed(folder.path()), 0);
    }
}

/// Stopping and continuing the program, and SIGPIPE, do not change the result.
#[test]
fn pause_and_sigpipe_do_not_change_the_result() {
    let folder = bracket();
    folder.line(&format!("merge {FRAMES} -q -o a.exr")).done();
    let mut child = begin(&folder, &format!("merge {FRAMES} -q -o b.exr"));
    for _ in 0..4 {
        std::thread::sleep(Duration::from_millis(15));
        send("PIPE", &mut child);
        send("STOP", &mut child);
        std::thread::sleep(Duration::from_millis(15));
        send("CONT", &mut child);
    }
    let end = child.wait().expect("its end");
    // The first SIGPIPE may arrive before the program ignores this signal.
    assert!(end.success() || end.signal() == Some(13), "{end}");
    assert!(!end.success() || folder.bytes("a.exr") == folder.bytes("b.exr"));
    assert_eq!(unnamed(folder.path()), 0);
}

#[test]
fn second_signal_stops_a_batch_at_once() {
    let folder = Folder::empty();
    crate::support::card::Card::new(300).brackets(6, 3, 2.0).write(&folder.at("in"));
    // If the batch ends before the signals reach it, it is started again.
    let end = (0..10).find_map(|_| {
        let _ = fs::remove_dir_all(folder.at("out"));
        let mut child = begin(&folder, "batch in -d out -q --jobs 1 --threads 1");
        let has_started = || fs::read_dir(folder.at("out")).is_ok_and(|entries| entries.count() > 1);
        while !has_started() && child.try_wait().expect("its state").is_none() {
            std::thread::sleep(Duration::from_millis(2));
        }
        send("TERM", &mut child);
        std::thread::sleep(Duration::from_millis(20));
        send("TERM", &mut child);
        Some(child.wait().expect("its end")).filter(|end| !end.success())
    });
    // Code 3 instead of 143: the running job ended between the two signals.
    assert!(end.is_some_and(|end| matches!(end.code(), Some(143 | 3))), "{end:?}");
    assert_eq!(unnamed(folder.path()), 0);
    folder.line("batch in -d out -q").done();
}
