//! Paths of results: links, folders, devices, long names, other disks.

use super::{FRAMES, bracket, fails, shell, unnamed};
use crate::support::card::Card;
use crate::support::{Folder, without};
use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::path::Path;

#[test]
fn link_is_replaced_and_its_target_is_unchanged() {
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
    // A photograph is never replaced, whatever name is given for it.
    symlink("w2.jpg", folder.at("in.jpg")).expect("a link");
    for name in ["in.jpg", "./w2.jpg", "\"$PWD\"/w2.jpg"] {
        fails(&folder, &format!("$H merge {FRAMES} --force -o {name}"), 2, &["also an input file"]);
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
            // A link to a folder counts as a link: with --force it would be replaced, and the folder kept.
            fails(&folder, &format!("$H merge {FRAMES} -o {name}"), 1, &["exists already"]);
            continue;
        }
        fails(&folder, &format!("$H merge {FRAMES} --force -o a.png -o {name}"), code, &[said]);
    }
    fails(&folder, &format!("$H merge {FRAMES} -o a.png -o ./a.png"), 2, &["a.png", "named twice"]);
    for (line, said) in [
        ("-o a.exr --report r.json --save-response r.json", "--report: r.json is named twice, also by --save-response"),
        ("-o a.exr --report r.json --transforms ./r.json", "--transforms: ./r.json is named twice, also by --report"),
        ("--deghost -o a.png --ghost-mask a.png", "--ghost-mask: a.png is named twice, also by -o"),
    ] {
        fails(&folder, &format!("$H merge {FRAMES} {line}"), 2, &[said]);
    }
    let longest = &long[1..];
    assert_eq!(shell(&folder, &format!("$H merge {FRAMES} -q -o {longest}")).code, 0);
    assert!(folder.at(longest).is_file());
}

/// Files are identified by device and inode, so that they are recognised under another name, in another letter case,
/// and through another mount.
#[test]
fn input_under_another_name_is_refused_by_the_option_that_names_it() {
    let folder = bracket();
    folder.line(&format!("merge {FRAMES} -q -o a.exr -o b.exr --save-response curve.json")).done();
    folder.line(&format!("align {FRAMES} -q --transforms moves.json")).done();
    for (file, alias, line, option) in [
        ("w2.jpg", "W2.jpg", "merge FRAMES -o ALIAS", "-o"),
        ("w3.jpg", "x.json", "merge FRAMES -o c.exr --report ALIAS", "--report"),
        ("w3.jpg", "x.json", "align FRAMES --transforms t.json --report ALIAS", "--report"),
        ("w4.jpg", "x.rsp", "merge FRAMES -o c.exr --save-response ALIAS", "--save-response"),
        ("w4.jpg", "x.png", "merge FRAMES -o c.exr --deghost --ghost-mask ALIAS", "--ghost-mask"),
        ("w2.jpg", "on_w2.tif", "align FRAMES --save-aligned on_", "--save-aligned"),
        ("w2.jpg", "x.csv", "response FRAMES -o ALIAS", "-o"),
        ("w2.jpg", "x.svg", "response FRAMES -o r.json --plot ALIAS", "--plot"),
        ("w2.jpg", "look/tables.txt", "inspect FRAMES -d look", "-d"),
        ("a.exr", "A.hdr", "tonemap a.exr -o ALIAS", "-o"),
        ("b.exr", "x.png", "compare a.exr b.exr --diff ALIAS", "--diff"),
        ("curve.json", "x.json", "merge FRAMES -o c.exr --response curve.json --report ALIAS", "--report"),
        ("moves.json", "x.json", "align FRAMES --transforms moves.json --report ALIAS", "--report"),
    ] {
        fs::create_dir_all(folder.at("look")).expect("a folder");
        fs::hard_link(folder.at(file), folder.at(alias)).expect("another name");
        let line = line.replace("FRAMES", FRAMES).replace("ALIAS", alias);
        let said = format!("{option}: {alias} is also an input file");
        fails(&folder, &format!("$H {line} --force"), 2, &[&said]);
        fs::remove_file(folder.at(alias)).expect("another name");
    }
}

#[test]
#[ignore = "mounts a folder twice; .ci/run runs it where the system allows that"]
fn input_through_another_mount_is_refused() {
    let folder = bracket();
    fs::create_dir_all(folder.at("again")).expect("a folder");
    for line in ["-o again/w2.jpg", "-o c.exr -o again/c.exr"] {
        let line = format!("unshare -rm sh -c 'mount --bind . again && $H merge {FRAMES} --force {line}'");
        fails(&folder, &line, 2, &["-o: again/"]);
    }
}

#[test]
fn batch_that_would_replace_a_photograph_is_refused_by_its_name_option() {
    let folder = Folder::empty();
    Card::new(64).brackets(1, 3, 2.0).write(&folder.at("in"));
    for path in fs::read_dir(folder.at("in")).expect("the card").flatten().map(|entry| entry.path()) {
        fs::rename(&path, path.with_extension("jpg")).expect("another extension");
    }
    let first = fs::read(folder.at("in/IMG_0001.jpg")).expect("a photograph");
    let run = folder.line("batch in --name {first} --formats jpg --force");
    let said = "--name: ";
    assert!(run.code == 1 && run.stderr.contains(said) && run.stderr.contains("also an input file"), "{run:?}");
    assert!(fs::read(folder.at("in/IMG_0001.jpg")).expect("a photograph") == first);
}

/// Some FUSE file systems support neither hard links nor renaming without replacement, and most do not support files
/// without a name.
#[test]
#[ignore = "filters system calls; .ci/run runs it where the system allows that"]
fn file_system_that_lacks_links_or_more_is_written_to_all_the_same() {
    let folder = bracket();
    folder.line(&format!("merge {FRAMES} -q -o a.exr -o a.png")).done();
    for lacks in ["anonymous", "link", "noreplace", "link,noreplace", "anonymous,link", "anonymous,link,noreplace"] {
        let before = without(lacks).expect("a filter of system calls");
        let line = format!("{} $H merge {FRAMES} -q -o b.exr -o b.png", before.join(" "));
        let run = shell(&folder, &line);
        assert_eq!((run.code, run.stderr.as_str()), (0, ""), "{lacks}");
        let is_same =
            || ["exr", "png"].iter().all(|e| folder.bytes(&format!("a.{e}")) == folder.bytes(&format!("b.{e}")));
        assert!(is_same(), "{lacks}");
        fails(&folder, &line, 1, &["b.exr: exists already"]);
        folder.put("b.png", b"old");
        assert_eq!(shell(&folder, &format!("{line} --force")).code, 0, "{lacks}");
        assert!(is_same() && unnamed(folder.path()) == 0, "{lacks}");
        fs::remove_file(folder.at("b.exr")).and_then(|()| fs::remove_file(folder.at("b.png"))).expect("two results");
    }
}

/// The results of private photographs stay private.
#[test]
fn replaced_files_keep_their_permissions() {
    let folder = bracket();
    let mode = |name: &str| fs::metadata(folder.at(name)).expect("a file").mode() & 0o777;
    let set =
        |name: &str, mode| fs::set_permissions(folder.at(name), fs::Permissions::from_mode(mode)).expect("its mode");
    folder.line(&format!("merge {FRAMES} -q -o a.exr -o b.exr --response-model srgb")).done();
    set("a.exr", 0o600);
    folder.line(&format!("merge {FRAMES} -q -o a.exr --force")).done();
    assert_eq!(mode("a.exr"), 0o600);
    // An expected file of `compare --bless` keeps its permissions; a new one has no more than the file that is copied.
    set("b.exr", 0o640);
    set("a.exr", 0o644);
    folder.line("compare b.exr a.exr -q --bless").done();
    assert_eq!(mode("b.exr"), 0o640);
    set("a.exr", 0o400);
    folder.line("compare new.exr a.exr -q --bless").done();
    assert_eq!(mode("new.exr"), 0o400);
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
    // A link to a folder on the other disk is used as a folder, also for the scratch file.
    symlink(other.path(), folder.at("link")).expect("a link");
    let line = format!("$H merge {FRAMES} -q --threads 16 --max-memory 64MB --scratch link -o link/b.exr -o again.exr");
    assert_eq!(shell(&folder, &line).code, 0);
    assert!(fs::read(folder.at("link/b.exr")).expect("a result") == folder.bytes("here.exr"));
    assert_eq!(fs::read_dir(other.path()).expect("the folder").count(), 2);
}

/// The folder is removed while the results are written.
#[test]
fn a_folder_that_vanishes_is_named() {
    let folder = bracket();
    fs::create_dir(folder.at("sub")).expect("a folder");
    // The folder is removed when the first temporary file in it, with or without a name, shows that the work is nearly
    // done. A quick run may end before.
    let script = format!(
        "$H merge {FRAMES} -q --tmo fattal -o sub/a.jpg -o sub/a.exr -o sub/a.tif -o sub/a.png --report sub/a.html & \
         while kill -0 $! 2>/dev/null && [ -z \"$(ls -A sub)$(ls -l /proc/$!/fd 2>/dev/null | grep /sub/)\" ]; do :; done; rm -rf sub; wait $!"
    );
    let run = shell(&folder, &script);
    let is_reported = run.stderr.contains("sub/a.") && run.stderr.contains("cannot be written");
    assert!((run.code, is_reported) == (1, true) || run.code == 0, "{run:?}");
    assert!(!run.stderr.contains("panicked"), "{run:?}");
}
