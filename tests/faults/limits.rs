//! Limits of the process: open files, threads, memory, stack.

use super::{FRAMES, bracket, can, fails, settled, shell, unnamed};
use crate::support::Folder;
use crate::support::card::Card;

#[test]
fn few_open_files_are_enough_and_fewer_are_told() {
    let folder = bracket();
    let outputs = "-o a.exr -o a.png -o a.jpg -o a.tif -o a.hdr";
    fails(
        &folder,
        &format!("ulimit -n 6; $H merge {FRAMES} -q {outputs}"),
        1,
        &["a.", "Too many open files", "ulimit -n"],
    );
    let run = shell(&folder, &format!("ulimit -n 24; $H merge {FRAMES} -q {outputs}"));
    assert_eq!(run.code, 0, "{run:?}");
    // Complete files that wait for their names need not all be open.
    let run = shell(&folder, &format!("ulimit -n 24; $H inspect {FRAMES} -q -d look"));
    assert_eq!((run.code, unnamed(folder.path())), (0, 0), "{run:?}");
    assert!(std::fs::read_dir(folder.at("look")).expect("a folder").count() > 24);
    let folder = Folder::empty();
    Card::new(64).brackets(12, 3, 2.0).write(&folder.at("in"));
    let run = shell(&folder, "ulimit -n 24; $H batch in -d out -q --page --formats exr,png,jpg");
    assert_eq!((run.code, unnamed(folder.path())), (0, 0), "{run:?}");
}

/// A thread's stack is address space: a thousand of them do not fit.
#[test]
fn threads_that_are_refused_are_an_error() {
    let folder = bracket();
    Card::new(64).brackets(2, 3, 2.0).write(&folder.at("in"));
    let limit = "ulimit -v 1000000 2>/dev/null";
    if !can(
        "limit the address space",
        &format!("{limit} && [ \"$(ulimit -v)\" = 1000000 ] && [ -e /proc/self/limits ]"),
    ) {
        return;
    }
    let said = ["threads could not be started", "--threads", "ulimit"];
    fails(&folder, &format!("{limit}; $H merge {FRAMES} --threads 1024 -o a.exr"), 1, &said);
    // Where nothing is said of threads, too.
    for line in [
        "merge w2.jpg w3.jpg -o a.exr",
        "align w2.jpg w3.jpg",
        "inspect w2.jpg w3.jpg -d look",
        "response w2.jpg w3.jpg -o r.json",
        "batch in --dry-run",
    ] {
        fails(&folder, &format!("{limit}; RAYON_NUM_THREADS=1024 $H {line}"), 1, &said);
    }
    folder.line(&format!("merge {FRAMES} -q -o a.exr")).done();
    fails(&folder, &format!("{limit}; RAYON_NUM_THREADS=1024 $H compare a.exr a.exr"), 2, &said);
    fails(&folder, &format!("{limit}; RAYON_NUM_THREADS=1024 $H tonemap a.exr -o b.png"), 1, &said);
    // With as many as there is room for all goes well; a batch finds out by itself.
    let run = settled(&folder, &format!("{limit}; $H batch in -d out -q --threads 1024 --jobs 1"));
    assert_eq!(run.code, 0, "{run:?}");
    assert_eq!(shell(&folder, &format!("{limit}; $H merge {FRAMES} -q --threads 2 -o c.exr")).code, 0);
    assert!(folder.bytes("a.exr") == folder.bytes("c.exr"));
}

/// As deep as a path may be, which has 4,096 bytes. The search took 90 s of a processor when it resolved every folder from the root.
#[cfg(target_os = "linux")]
#[test]
fn deep_folders_are_searched_in_little_time() {
    let folder = Folder::empty();
    Card::new(64).brackets(1, 3, 2.0).write(&folder.at("in").join("d/".repeat(1900)));
    let run = shell(&folder, "ulimit -t 20; $H batch in --dry-run");
    // Deeper than the temporary folder can be removed by itself.
    shell(&folder, "rm -rf in");
    assert!(run.code == 0 && run.stdout.contains("1 bracket of 3 photographs"), "{}", run.code);
}

#[test]
fn a_small_stack_is_enough() {
    let folder = bracket();
    let run = shell(&folder, &format!("ulimit -s 2048; $H merge {FRAMES} -q -o a.exr --report a.html"));
    assert_eq!(run.code, 0, "{run:?}");
}
