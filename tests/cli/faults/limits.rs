//! Limits of the process: open files, threads, memory, stack.

use super::{FRAMES, bracket, fails, shell, unnamed};
use crate::support::Folder;
use crate::support::card::Card;

#[test]
fn few_open_files_are_enough_and_too_few_are_an_error() {
    let folder = bracket();
    let outputs = "-o a.exr -o a.png -o a.jpg -o a.tif -o a.hdr";
    // With one thread, photographs are read one after the other, so that the error is always for the same file.
    fails(
        &folder,
        &format!("ulimit -n 6; $H merge {FRAMES} -q --threads 1 {outputs}"),
        1,
        &["a.", "Too many open files", "ulimit -n"],
    );
    let run = shell(&folder, &format!("ulimit -n 24; $H merge {FRAMES} -q {outputs}"));
    assert_eq!(run.code, 0, "{run:?}");
    // Complete files that wait to be renamed need not all be open.
    let run = shell(&folder, &format!("ulimit -n 24; $H inspect {FRAMES} -q -d look"));
    assert_eq!((run.code, unnamed(folder.path())), (0, 0), "{run:?}");
    assert!(std::fs::read_dir(folder.at("look")).expect("a folder").count() > 24);
    let folder = Folder::empty();
    Card::new(64).brackets(12, 3, 2.0).write(&folder.at("in"));
    let run = shell(&folder, "ulimit -n 24; $H batch in -d out -q --page --formats exr,png,jpg");
    assert_eq!((run.code, unnamed(folder.path())), (0, 0), "{run:?}");
}

/// Returns a prefix for `$H` in a script that refuses every thread after the first `started`.
fn refusing(started: usize) -> String {
    use std::sync::OnceLock;
    static LIBRARY: OnceLock<std::path::PathBuf> = OnceLock::new();
    let library = LIBRARY.get_or_init(|| {
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/cli/faults/refuse_threads.c");
        let library = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("refuse_threads.so");
        // There is a C compiler, because mimalloc is written in C.
        let compiler = std::env::var_os("CC").unwrap_or_else(|| "cc".into());
        let mut command = std::process::Command::new(compiler);
        let compiled = command.args(["-shared", "-fPIC", "-o"]).arg(&library).args([source, "-ldl"]).status();
        assert!(compiled.expect("a C compiler").success(), "{source}");
        library
    });
    format!("REFUSE_AFTER={started} LD_PRELOAD={} ", library.display())
}

/// Threads are refused by number, because memory limits have different effects on different machines.
#[test]
#[cfg_attr(not(all(target_os = "linux", target_env = "gnu")), ignore = "needs LD_PRELOAD and glibc")]
fn threads_that_are_refused_are_an_error() {
    let folder = bracket();
    Card::new(64).brackets(2, 3, 2.0).write(&folder.at("in"));
    let said = ["threads could not be started", "--threads", "ulimit"];
    folder.line(&format!("merge {FRAMES} -q -o a.exr")).done();
    // The number of threads is set by RAYON_NUM_THREADS here, without --threads.
    for line in [
        "merge w2.jpg w3.jpg -o b.exr",
        "align w2.jpg w3.jpg",
        "inspect w2.jpg w3.jpg -d look",
        "response w2.jpg w3.jpg -o r.json",
        "batch in --dry-run",
        "compare a.exr a.exr",
        "tonemap a.exr -o b.png",
    ] {
        let code = if line.starts_with("compare") { 2 } else { 1 };
        for started in [0, 2] {
            fails(&folder, &format!("{}RAYON_NUM_THREADS=3 $H {line}", refusing(started)), code, &said);
        }
    }
    let said = ["3 threads could not be started", "--threads", "ulimit"];
    fails(&folder, &format!("{}$H batch in --dry-run --threads 3", refusing(0)), 1, &said);
}

/// Each thread in turn is refused: if the run needs it, there is an error; otherwise the result is the same.
#[test]
#[cfg_attr(not(all(target_os = "linux", target_env = "gnu")), ignore = "needs LD_PRELOAD and glibc")]
fn refused_thread_is_an_error_or_has_no_effect() {
    let folder = bracket();
    let line = format!("merge {FRAMES} -q --threads 3 -o a.exr -o a.png --report a.html --force");
    folder.line(&line).done();
    let (exr, png) = (folder.bytes("a.exr"), folder.bytes("a.png"));
    // The first thread handles signals, the next three compute, and the others sync files.
    for started in 0..8 {
        if started < 4 {
            fails(&folder, &format!("{}$H {line}", refusing(started)), 1, &["3 threads could not be started"]);
            continue;
        }
        let run = shell(&folder, &format!("{}$H {line}", refusing(started)));
        assert_eq!((run.code, run.stderr.as_str()), (0, ""), "{started} threads");
        assert!(folder.bytes("a.exr") == exr && folder.bytes("a.png") == png, "{started} threads");
    }
}

/// A batch with refused threads does what is possible, and the next run does the rest.
#[test]
#[cfg_attr(not(all(target_os = "linux", target_env = "gnu")), ignore = "needs LD_PRELOAD and glibc")]
fn batch_with_refused_threads_is_taken_up_again() {
    let folder = Folder::empty();
    Card::new(64).brackets(2, 3, 2.0).write(&folder.at("in"));
    let line = "$H batch in -d out --formats png --threads 4 --jobs 2";
    for started in 0..12 {
        let run = shell(&folder, &format!("{}{line}", refusing(started)));
        assert!(matches!(run.code, 0 | 1 | 3) && !run.stderr.contains("panicked"), "{started} threads: {run:?}");
        assert!(run.code == 0 || run.stderr.contains("threads could not be started"), "{started} threads: {run:?}");
        assert_eq!(unnamed(folder.path()), 0, "{started} threads");
    }
    assert_eq!(shell(&folder, line).code, 0);
}

/// The folders are nested as deep as a path of 4,096 bytes allows. An earlier version resolved every folder from the
/// root, and the search took 90 s of CPU time.
#[cfg(target_os = "linux")]
#[test]
fn deep_folders_are_searched_in_little_time() {
    let folder = Folder::empty();
    Card::new(64).brackets(1, 3, 2.0).write(&folder.at("in").join("d/".repeat(1900)));
    let run = shell(&folder, "ulimit -t 20; $H batch in --dry-run");
    // The folders are too deep to be removed with the temporary folder.
    shell(&folder, "rm -rf in");
    assert!(run.code == 0 && run.stdout.contains("1 bracket of 3 photographs"), "{}", run.code);
}

#[test]
fn a_small_stack_is_enough() {
    let folder = bracket();
    let run = shell(&folder, &format!("ulimit -s 2048; $H merge {FRAMES} -q -o a.exr --report a.html"));
    assert_eq!(run.code, 0, "{run:?}");
}
