//! Files that are not photographs, cannot be read completely, or have unusual names.

use super::{FRAMES, bracket, fails, shell, unnamed};
use crate::support::Folder;
use crate::support::card::Card;
use serde_json::Value;
use std::ffi::{OsStr, OsString};
use std::fs::{self, Permissions};
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::os::unix::net::UnixListener;
use std::path::Path;
use std::process::Command;

#[test]
fn files_that_are_not_photographs_are_reported_with_their_type() {
    let folder = bracket();
    fs::create_dir(folder.at("d.jpg")).expect("a folder");
    folder.put("e.jpg", b"");
    let _socket = UnixListener::bind(folder.at("s.jpg")).expect("a socket");
    let link = |to: &str, name: &str| symlink(to, folder.at(name)).expect("a link");
    link("nowhere", "gone.jpg");
    link("two.jpg", "one.jpg");
    link("one.jpg", "two.jpg");
    link("/dev/null", "null.jpg");
    for (name, said) in [
        ("d.jpg", "it is a folder"),
        ("e.jpg", "empty"),
        ("s.jpg", "cannot be read"),
        ("gone.jpg", "No such file"),
        ("one.jpg", "symbolic links"),
        ("null.jpg", "empty"),
        ("w2.jpg/x.jpg", "Not a directory"),
    ] {
        for line in ["merge -o a.exr", "align", "inspect -d look", "response -o r.json"] {
            // `response` takes a folder as a bracket, so its message is different.
            if line.starts_with("response") && (name == "d.jpg" || name.contains('/')) {
                continue;
            }
            fails(&folder, &format!("$H {line} w2.jpg w3.jpg {name}"), 1, &[&format!("{name}: "), said]);
        }
    }
    for line in ["tonemap e.jpg", "tonemap s.jpg -o b.png", "merge FRAMES --response one.jpg -o a.exr"] {
        let code = if line.contains("--response") { 2 } else { 1 };
        fails(&folder, &format!("$H {}", line.replace("FRAMES", FRAMES)), code, &[".jpg"]);
    }
    link("two.json", "one.json");
    link("one.json", "two.json");
    fails(&folder, &format!("$H merge {FRAMES} --response one.json -o a.exr"), 1, &["one.json", "symbolic links"]);
    fails(&folder, "$H compare e.jpg w2.jpg", 2, &["e.jpg"]);
}

#[test]
fn a_pipe_is_a_photograph_when_somebody_writes_it() {
    let folder = bracket();
    let run = shell(&folder, "mkfifo p.jpg && { cat w3.jpg >p.jpg & $H merge w2.jpg p.jpg -q -o a.exr; }");
    assert_eq!(run.code, 0, "{run:?}");
    folder.line("merge w2.jpg w3.jpg -q -o b.exr").done();
    assert!(folder.bytes("a.exr") == folder.bytes("b.exr"));
    // No process writes to the pipe; the program, which waits for it, can be ended by a signal.
    let script = "$H merge w2.jpg p.jpg -q -o c.exr & sleep 0.5; kill $!; wait $!";
    fails(&folder, script, 143, &["no incomplete files were left"]);
}

/// If compiled with overflow checks, the exr crate panics on this file (see tests/fixtures/README.md).
#[test]
fn a_panic_of_a_decoder_is_not_printed() {
    let folder = bracket();
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/damaged-b44.exr");
    fs::copy(fixture, folder.at("damaged.exr")).expect("a copy");
    let run = shell(&folder, "RUST_BACKTRACE=1 $H tonemap damaged.exr -o a.png");
    assert!(!run.stderr.contains("panicked") && !run.stderr.contains(".rs:"), "{run:?}");
    // Without overflow checks, the damaged blocks of the file are read.
    assert!(run.code == 0 || run.code == 1 && run.stderr.contains("damaged.exr: "), "{run:?}");
}

/// /proc/self/mem can be opened like a file, but reading it fails, as with a damaged card.
#[test]
#[cfg_attr(not(target_os = "linux"), ignore = "needs /proc/self/mem")]
fn read_failure_names_the_file() {
    let folder = bracket();
    symlink("/proc/self/mem", folder.at("bad.jpg")).expect("a link");
    symlink("/proc/self/mem", folder.at("bad.exr")).expect("a link");
    let said = ["Input/output error", "damaged"];
    fails(&folder, "$H merge w2.jpg w3.jpg bad.jpg -o a.exr -o a.png", 1, &[said[0], said[1], "bad.jpg"]);
    fails(&folder, "$H tonemap bad.exr -o a.png", 1, &[said[0], said[1], "bad.exr"]);
    fails(&folder, "$H compare bad.exr bad.exr", 2, &[said[0], said[1], "bad.exr"]);
}

#[test]
fn a_file_that_may_not_be_read_is_named() {
    let folder = bracket();
    let allow = |path: &Path, mode| fs::set_permissions(path, Permissions::from_mode(mode)).expect("permissions");
    // Root may read everything, so the program is run as `nobody`. It is copied, because `nobody` may have no access to
    // its folder.
    let elsewhere = Folder::empty();
    let program = elsewhere.at("hdralign");
    // Another process (`cp`) makes the copy: processes that other tests start in the meantime inherit files that this
    // process has open, and a file that is open for writing cannot be executed.
    let copied = Command::new("cp").args([crate::support::program(), program.clone()]).status().expect("cp");
    assert!(copied.success());
    allow(elsewhere.path(), 0o755);
    let is_root = fs::metadata(folder.path()).expect("its owner").uid() == 0;
    let nobody = if is_root { "setpriv --reuid 65534 --regid 65534 --clear-groups " } else { "" };
    let program = format!("{nobody}{}", program.display());
    allow(&folder.at("w3.jpg"), 0o000);
    allow(folder.path(), 0o555);
    let said = ["w3.jpg: cannot be read", "Permission denied", "check the name and the permissions"];
    fails(&folder, &format!("{program} merge w2.jpg w3.jpg -o {}/none.exr", elsewhere.path().display()), 1, &said);
    let said = ["a.exr: cannot be written", "Permission denied", "permissions"];
    fails(&folder, &format!("{program} merge w2.jpg w4.jpg -o a.exr"), 1, &said);
    fails(&folder, &format!("{program} inspect w2.jpg w4.jpg -d look"), 1, &["look", "Permission denied"]);
    allow(folder.path(), 0o755);
}

/// Names with a meaning for shells, JSON, CSV and terminals.
const ODD: [&[u8]; 12] = [
    b"a b",
    b"new\nline",
    b"tab\t",
    b"\"quo'ted\"",
    b"-lead",
    b"*",
    b"[a-z]?",
    b"$HOME;`x`",
    b"back\\slash,comma",
    "\u{1f4f7}\u{202e}".as_bytes(),
    b"not\xff\xfeutf8",
    b"CON:|<>",
];

/// Joins `name` and `ending`.
fn odd(name: &[u8], ending: &str) -> OsString {
    OsString::from_vec([name, ending.as_bytes()].concat())
}

#[test]
fn names_of_any_bytes_go_in_and_out() {
    let tiny = bracket();
    let folder = Folder::empty();
    for name in ODD {
        for (frame, suffix) in [("w2.jpg", "1.jpg"), ("w3.jpg", "2.jpg")] {
            fs::write(folder.at(odd(name, suffix)), tiny.bytes(frame)).expect("a photograph");
        }
        let with = |ending: &str| Path::new(".").join(odd(name, ending)).into_os_string();
        let words = [
            "merge".into(),
            with("1.jpg"),
            with("2.jpg"),
            "-o".into(),
            with(".exr"),
            "--report".into(),
            with(".json"),
            "--json".into(),
        ];
        let run = folder.run(words).done();
        let said: Value = serde_json::from_str(&run.stdout).expect("JSON");
        let written: Value =
            serde_json::from_slice(&fs::read(folder.at(with(".json"))).expect("a report")).expect("JSON");
        assert!(said["frames"] == written["frames"] && said["outputs"].as_array().is_some_and(|all| all.len() == 1));
        assert!(folder.at(with(".exr")).is_file(), "{name:?}");
        let gone = folder.run(["merge".into(), with("1.jpg"), with("gone.jpg"), "-o".into(), "a.exr".into()]);
        assert!(gone.code == 1 && gone.stderr.contains("cannot be read"), "{gone:?}");
        folder.run(["inspect".into(), with("1.jpg"), with("2.jpg"), "-q".into(), "-d".into(), with(".look")]).done();
        folder.run(["tonemap".into(), with(".exr"), "-q".into(), "-o".into(), with(".png")]).done();
        folder.run(["compare".into(), with(".exr"), with(".exr")]).done();
    }
    // Such names also work without a folder, after `--`.
    folder.run(["merge", "--", "-lead1.jpg", "-lead2.jpg"]).done();
    assert!(folder.at("-lead1--lead2.exr").is_file() && unnamed(folder.path()) == 0);
}

/// With folders that have the names in [`ODD`], the summary is valid JSON and CSV, and a second run recognises the
/// results.
#[test]
fn a_batch_takes_folders_of_any_name() {
    let folder = Folder::empty();
    for name in ODD {
        let mut card = Card::new(64);
        card.bracket(&[0.0, -2.0, 2.0]);
        card.write(&folder.at("in").join(OsStr::from_bytes(name)));
    }
    folder.line("batch in -d out -q --by-folder --formats png").done();
    let rows = |folder: &Folder| {
        let text = folder.bytes("out/batch.csv");
        let rows = csv::Reader::from_reader(&text[..]).into_records().collect::<Result<Vec<_>, _>>().expect("CSV");
        let summary: Value = serde_json::from_slice(&folder.bytes("out/batch.json")).expect("JSON");
        (rows.len(), summary["counts"].clone())
    };
    let (count, counts) = rows(&folder);
    assert_eq!((count, counts["done"].as_u64()), (ODD.len(), Some(ODD.len() as u64)));
    folder.line("batch in -d out -q --by-folder --formats png").done();
    assert_eq!(rows(&folder).1["unchanged"].as_u64(), Some(ODD.len() as u64));
    // A plan is UTF-8, so a name that is not is reported and not planned.
    let plan = folder.line("batch in -d again --by-folder --formats png --plan");
    assert!(plan.code == 3 && plan.stdout.lines().count() == ODD.len() - 1, "{plan:?}");
    assert!(plan.stdout.lines().all(|line| serde_json::from_str::<Value>(line).is_ok()));
    assert_eq!(unnamed(folder.path()), 0);
}
