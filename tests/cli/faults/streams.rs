//! Runs whose stdout or stderr is full, closed, or has no reader.

use super::{FRAMES, bracket, fails, shell};
use crate::support::Folder;
use crate::support::card::Card;

#[test]
#[cfg_attr(not(target_os = "linux"), ignore = "needs /dev/full")]
fn full_stdout_is_an_error_and_files_are_kept() {
    let folder = bracket();
    Card::new(64).brackets(1, 3, 2.0).write(&folder.at("in"));
    let said = ["standard output", "No space left", "another place"];
    for line in [
        "--help",
        "merge --help",
        "help merge",
        "--version",
        "completions bash",
        "man",
        "merge --tmo-set help w2.jpg",
        "batch --name help in",
        "batch in --plan -d out",
        "batch in --dry-run",
    ] {
        fails(&folder, &format!("$H {line} >/dev/full"), 1, &said);
    }
    for (i, options) in ["", "--json"].into_iter().enumerate() {
        let run = shell(&folder, &format!("$H merge {FRAMES} -q -o a{i}.exr {options} >/dev/full"));
        assert!(run.code == 1 && said.iter().all(|part| run.stderr.contains(part)), "{run:?}");
    }
    assert!(folder.bytes("a0.exr") == folder.bytes("a1.exr"));
    fails(&folder, "$H compare a0.exr a1.exr -q --json >/dev/full", 2, &said);
    folder.line("compare a0.exr a1.exr").done();
}

#[test]
fn closed_stdout_or_reader_is_not_an_error() {
    let folder = bracket();
    for (i, out) in ["| true", ">&-"].into_iter().enumerate() {
        for line in [&format!("merge {FRAMES} -q --json -o a{i}.exr")[..], "completions bash", "man", "--help"] {
            let run = shell(&folder, &format!("{{ $H {line}; echo $? >&2; }} {out}"));
            assert_eq!((run.code, run.stderr.as_str()), (0, "0\n"), "{line} {out}");
        }
        assert!(folder.bytes(&format!("a{i}.exr")).len() > 1000);
    }
}

/// If stderr is closed or full, messages are lost, but the work continues, and the exit code is the same.
#[test]
#[cfg_attr(not(target_os = "linux"), ignore = "needs /dev/full")]
fn closed_stderr_does_not_stop_the_work() {
    let folder = bracket();
    Card::new(64).brackets(2, 3, 2.0).write(&folder.at("in"));
    let heard = shell(&folder, &format!("$H merge {FRAMES} -v -o a.exr"));
    assert!(heard.code == 0 && heard.stderr.lines().count() > 6);
    for (i, to) in ["2>/dev/full", "2>&-", "2>gone", "2>/dev/null"].into_iter().enumerate() {
        // For "2>gone", stderr is a pipe without reader.
        let script = |line: &str| match to {
            "2>gone" => format!("exec 3>&1; {{ sleep 0.05; $H {line} 2>&1 >&3; echo $? >&3; }} | true"),
            _ => format!("$H {line} {to}; echo $?"),
        };
        for (line, ends) in [
            (&format!("merge {FRAMES} -v -o b{i}.exr -e=2,0,-2")[..], format!("b{i}.exr\n0\n")),
            ("merge w2.jpg gone.jpg -o c.exr", "1\n".into()),
            ("melt", "2\n".into()),
            ("compare a.exr a.exr", "0\n".into()),
            (&format!("inspect {FRAMES} -d look{i}"), "tables.json\n0\n".into()),
            (&format!("response {FRAMES} -o r{i}.json"), format!("r{i}.json\n0\n")),
            (&format!("tonemap a.exr -o t{i}.png"), format!("t{i}.png\n0\n")),
            (&format!("batch in -d out{i} -v --formats png"), "png\n0\n".into()),
        ] {
            let run = shell(&folder, &script(line));
            assert!(run.stdout.ends_with(&ends), "{line} {to}: {run:?}");
        }
    }
}

#[test]
fn truncated_plan_is_an_error() {
    let folder = Folder::empty();
    Card::new(64).brackets(1, 3, 2.0).write(&folder.at("in"));
    fails(
        &folder,
        "ulimit -f 0; $H batch in -d out --plan >plan.jsonl; code=$?; rm plan.jsonl; exit $code",
        1,
        &["standard output", "File too large"],
    );
}
