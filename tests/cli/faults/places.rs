//! Where results are asked to go: links, folders, devices, names that are too long, other disks.

use super::{FRAMES, bracket, fails, shell};
use std::fs;
use std::os::unix::fs::{MetadataExt, symlink};
use std::path::Path;

#[test]
fn a_link_is_replaced_and_what_it_points_to_is_left() {
    let folder = bracket();
    folder.put("precious", b"precious");
    for (to, name) in
        [("nowhere", "dangling.exr"), ("loop.exr", "loop.exr"), ("/dev/full", "device.exr"), ("precious", "file.exr")]
    {
        symlink(to, folder.at(name)).expect("a link");
        let line = format!("$H merge {FRAMES} -q -o {name}");
        fails(&folder, &line, 1, &[name, "exists already", "--force"]);
        assert_eq!(shell(&folder, &format!("{line} --force")).code, 0);
        let there = fs::symlink_metadata(folder.at(name)).expect("a result");
        assert!(there.is_file() && there.len() > 1000, "{name}");
    }
    assert_eq!(folder.bytes("precious"), b"precious");
    assert!(!folder.at("nowhere").exists());
    // But never onto a photograph that is read, by whatever name.
    symlink("w2.jpg", folder.at("in.jpg")).expect("a link");
    for name in ["in.jpg", "./w2.jpg", "\"$PWD\"/w2.jpg"] {
        fails(&folder, &format!("$H merge {FRAMES} --force -o {name}"), 2, &["one of the files that are read"]);
    }
}

#[test]
fn places_that_cannot_be_are_refused() {
    let folder = bracket();
    fs::create_dir(folder.at("sub.exr")).expect("a folder");
    symlink("sub.exr", folder.at("link.exr")).expect("a link");
    let long = format!("{}.exr", "x".repeat(252));
    for (name, code, said) in [
        ("sub.exr", 1, "it is a folder"),
        ("./sub.exr/", 1, "it is a folder"),
        ("..", 2, "extension"),
        (".exr", 2, "extension"),
        ("noextension", 2, "extension"),
        ("/dev/full", 2, "extension"),
        ("none/a.exr", 1, "mkdir -p none"),
        ("w2.jpg/a.exr", 1, "not a folder"),
        (&long, 1, "give it a shorter name"),
        ("link.exr", 1, ""),
    ] {
        if name == "link.exr" {
            // A link to a folder is a link: replaced when that is asked for, and the folder stays.
            fails(&folder, &format!("$H merge {FRAMES} -o {name}"), 1, &["exists already"]);
            continue;
        }
        fails(&folder, &format!("$H merge {FRAMES} --force -o a.png -o {name}"), code, &[said]);
    }
    fails(&folder, &format!("$H merge {FRAMES} -o a.png -o ./a.png"), 2, &["a.png", "named twice"]);
    fails(&folder, &format!("$H merge {FRAMES} -o a.exr --report r.json --save-response r.json"), 2, &["named twice"]);
    let longest = &long[1..];
    assert_eq!(shell(&folder, &format!("$H merge {FRAMES} -q -o {longest}")).code, 0);
    assert!(folder.at(longest).is_file());
}

#[test]
#[ignore = "needs a second file system at /dev/shm; .ci/run runs it"]
fn results_may_go_to_another_disk() {
    let folder = bracket();
    let device = |path: &Path| fs::metadata(path).map(|there| there.dev()).ok();
    let other = tempfile::tempdir_in("/dev/shm").expect("a folder in /dev/shm");
    assert_ne!(device(other.path()), device(folder.path()), "/dev/shm is no other file system");
    let there = other.path().join("a.exr");
    let line = format!("$H merge {FRAMES} -q -o here.exr -o {}", there.display());
    assert_eq!(shell(&folder, &line).code, 0);
    assert!(fs::read(&there).expect("a result") == folder.bytes("here.exr"));
    // A link to a folder there is a folder, and the memory's overflow may be there as well.
    symlink(other.path(), folder.at("link")).expect("a link");
    let line = format!("$H merge {FRAMES} -q --max-memory 64MB --scratch link -o link/b.exr -o again.exr");
    assert_eq!(shell(&folder, &line).code, 0);
    assert!(fs::read(folder.at("link/b.exr")).expect("a result") == folder.bytes("here.exr"));
    assert_eq!(fs::read_dir(other.path()).expect("the folder").count(), 2);
}

/// It is taken away while the results are being made.
#[test]
fn a_folder_that_vanishes_is_named() {
    let folder = bracket();
    fs::create_dir(folder.at("sub")).expect("a folder");
    // The first temporary file shows that the work is nearly done; a quick run may win.
    let script = format!(
        "$H merge {FRAMES} -q --tmo fattal -o sub/a.jpg -o sub/a.exr -o sub/a.tif -o sub/a.png --report sub/a.html & \
         while kill -0 $! 2>/dev/null && [ -z \"$(ls -A sub)\" ]; do :; done; rm -rf sub; wait $!"
    );
    let run = shell(&folder, &script);
    let is_told = run.stderr.contains("sub/a.") && run.stderr.contains("cannot be written");
    assert!((run.code, is_told) == (1, true) || run.code == 0, "{run:?}");
    assert!(!run.stderr.contains("panicked"), "{run:?}");
}
