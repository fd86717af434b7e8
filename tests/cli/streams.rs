//! stdout contains only results; stderr contains everything else, and with `-q` only errors.

use crate::support::Folder;
use serde_json::Value;

#[test]
fn stdout_is_the_paths_written_one_a_line() {
    let folder = Folder::with_bracket();
    let line = "merge w2.jpg w3.jpg w4.jpg -o b.hdr -o a.exr -o c.png -o d.tif --save-response r.json --report p.html";
    let run = folder.line(line).done();
    assert_eq!(run.stdout, "b.hdr\na.exr\nc.png\nd.tif\nr.json\np.html\n");
    for path in run.stdout.lines() {
        assert!(folder.at(path).is_file(), "{path} is not there");
    }
    assert_eq!(folder.line("align w2.jpg w3.jpg").done().stdout, "", "nothing was written");
    assert_eq!(folder.line("align w2.jpg w3.jpg --report a.json").done().stdout, "a.json\n");
}

#[test]
fn json_option_prints_only_json() {
    let folder = Folder::with_bracket();
    for command in ["align", "merge -o a.exr"] {
        let run = folder.line(&format!("{command} w2.jpg w3.jpg w4.jpg --json")).done();
        // The whole of stdout is a single JSON value: anything before or after it would be a parser error.
        let json: Value =
            serde_json::from_str(&run.stdout).unwrap_or_else(|e| panic!("{command}: {e}\n{}", run.stdout));
        assert_eq!(json["schema"], "hdralign-report/1");
        assert_eq!(json["frames"].as_array().map(Vec::len), Some(3));
    }
}

#[test]
fn quiet_leaves_stderr_empty_even_of_warnings() {
    let folder = Folder::with_bracket();
    let line = "merge w2.jpg w3.jpg w4.jpg -o a.exr --force";
    assert_ne!(folder.line(line).done().stderr, "", "a summary");
    let quiet = folder.line(&format!("{line} -q")).done();
    assert_eq!((quiet.stderr.as_str(), quiet.stdout.as_str()), ("", "a.exr\n"));
    let errors = folder.line("merge w2.jpg gone.jpg -q -o b.exr");
    assert!(errors.code == 1 && errors.stderr.contains("gone.jpg"), "{errors:?}");
}

#[test]
fn no_bar_is_drawn_without_a_terminal() {
    let folder = Folder::with_bracket();
    for options in ["", "-v"] {
        let run = folder.line(&format!("merge w2.jpg w3.jpg w4.jpg -o a.exr --force {options}")).done();
        let drawn = run.stderr.contains(['\r', '\u{1b}', '\u{8}']) || run.stderr.contains("[=");
        assert!(!drawn, "{:?}", run.stderr);
        assert!(run.stderr.ends_with('\n'));
    }
}

#[test]
fn six_lines_sum_up_and_a_file_gets_no_control_characters() {
    let folder = Folder::with_bracket();
    // Deghosting is off, because frames without alignment would seem to contain movement, which has another line.
    let run = folder.line("merge w2.jpg w3.jpg w4.jpg --align none --deghost=off -o a.exr -o a.png").done();
    let lines: Vec<&str> = run.stderr.lines().collect();
    let labels: Vec<&str> = lines.iter().rev().take(6).rev().map(|l| &l[..11]).collect();
    assert_eq!(labels, ["merged     ", "aligned    ", "frames     ", "range      ", "files      ", "time       "]);
    assert!(run.stderr.contains("3 frames, 300 x 200 pixels") && run.stderr.contains("a.exr, a.png"), "{}", run.stderr);
    assert!(run.stderr.contains(", the result "), "{}", run.stderr);
    // stderr is a file: warnings, lines for frames and errors have no control characters, and each is on one line, for
    // grep.
    for line in
        ["merge w2.jpg w3.jpg w4.jpg -e=2,0,-2 -v --force -o a.exr", "align w2.jpg gone.jpg", "compare a.exr a.exr -v"]
    {
        let run = folder.line(line);
        assert!(run.stderr.chars().all(|c| c == '\n' || !c.is_control()), "{:?}", run.stderr);
    }
    let run = folder.line("merge w2.jpg w3.jpg w4.jpg -e=2,0,-2 --force -o a.exr").done();
    let warnings: Vec<&str> = run.stderr.lines().filter(|l| l.starts_with("warning: ")).collect();
    assert!(warnings.len() == 2 && warnings[0].ends_with("in the order of the files"), "{warnings:?}");
}

#[test]
fn verbose_has_a_line_for_each_frame() {
    let folder = Folder::with_bracket();
    let run = folder.line("align w2.jpg w3.jpg w4.jpg -v").done();
    for name in ["w2.jpg: ", "w3.jpg: ", "w4.jpg: "] {
        assert_eq!(run.stderr.lines().filter(|l| l.starts_with(name)).count(), 1, "{}", run.stderr);
    }
}

#[test]
fn help_and_version_are_results() {
    let folder = Folder::empty();
    for line in [
        "--help",
        "merge --help",
        "align --help",
        "inspect --help",
        "tonemap --help",
        "compare --help",
        "completions --help",
        "man --help",
        "--version",
    ] {
        let run = folder.line(line).done();
        assert!(run.stderr.is_empty() && run.stdout.contains("hdralign"), "{line}: {run:?}");
    }
    assert!(folder.line("--help").stdout.contains("Exit codes:"));
    for command in ["merge", "batch", "tonemap", "compare"] {
        let help = folder.line(&format!("{command} --help")).stdout;
        let words = help.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains("printed to stdout: the names of"), "{command}");
    }
}
