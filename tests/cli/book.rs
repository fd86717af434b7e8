//! The book (`docs/`) and the README: every command runs, every link leads to a file or heading, and the pages of
//! options are the output of `--help`.
//!
//! A line of a `sh` block that starts with `hdralign` or `mkdir` is a command. The commands of a page run one after the
//! other in a new folder, which contains the bracket `IMG_1.jpg` to `IMG_5.jpg` and the same files in `card/`. Each
//! must exit with 0, or with N if it has a comment `# exits with N`. Blocks marked `console` are not run.

use crate::shell::COMMANDS;
use crate::support::{FRAMES, Folder, program, small_jpeg};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Returns the root folder of the project.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Returns the Markdown files in `folder` and the folders below it.
pub fn pages(folder: &Path) -> BTreeSet<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder of documents").map(|entry| entry.expect("an entry").path());
    entries.fold(BTreeSet::new(), |mut found, path| {
        if path.is_dir() {
            found.extend(pages(&path));
        } else if path.extension().is_some_and(|e| e == "md") {
            found.insert(path);
        }
        found
    })
}

fn text(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Returns the commands of a page, each with its line number and the expected exit code.
fn commands(text: &str) -> Vec<(usize, String, i32)> {
    let mut found = Vec::new();
    let mut is_shell = false;
    let mut lines = text.lines().enumerate();
    while let Some((number, line)) = lines.next() {
        if line.starts_with("```") {
            is_shell = line == "```sh";
        } else if is_shell && ["hdralign ", "mkdir "].iter().any(|word| line.starts_with(word)) {
            let mut command = line.to_owned();
            while command.ends_with('\\') {
                command.pop();
                command += lines.next().expect("a continued line").1;
            }
            let code = command.split_once("# exits with ").map_or(0, |(_, rest)| {
                rest.split(|c: char| !c.is_ascii_digit()).next().and_then(|n| n.parse().ok()).expect("an exit code")
            });
            found.push((number + 1, command, code));
        }
    }
    found
}

/// Runs the commands of `page`. Returns their number.
#[cfg(unix)]
fn run(page: &Path) -> usize {
    let commands = commands(&text(page));
    if commands.is_empty() {
        return 0;
    }
    let folder = Folder::empty();
    fs::create_dir(folder.at("card")).expect("a folder");
    for i in 1..=FRAMES {
        folder.put(&format!("IMG_{i}.jpg"), small_jpeg(i));
        folder.put(&format!("card/IMG_{i}.jpg"), small_jpeg(i));
    }
    let called = format!("hdralign() {{ '{}' \"$@\"; }}\n", program().display());
    for (line, command, expected) in &commands {
        let mut shell = Command::new("sh");
        shell.arg("-c").arg(called.clone() + command).current_dir(folder.path());
        let output = shell.stdin(Stdio::null()).output().expect("a shell");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(*expected), "{}:{line}: {command}\n{stderr}", page.display());
    }
    commands.len()
}

#[cfg(unix)]
#[test]
fn every_command_of_the_guides_runs() {
    let count: usize = pages(&root().join("docs/guides")).iter().map(|page| run(page)).sum();
    assert!(count > 50, "only {count} commands were found");
}

#[cfg(unix)]
#[test]
fn every_command_of_the_other_pages_runs() {
    let others = pages(&root().join("docs")).into_iter().filter(|page| !page.starts_with(root().join("docs/guides")));
    let count: usize = others.chain([root().join("README.md")]).map(|page| run(&page)).sum();
    assert!(count > 20, "only {count} commands were found");
}

#[test]
fn commands_are_found_with_their_exit_codes_and_continued_lines() {
    let text = "```sh\nhdralign a \\\n  b\ncargo x\nhdralign c # exits with 3: d\n```\n```console\nhdralign e\n```\n";
    assert_eq!(commands(text), [(2, "hdralign a   b".into(), 0), (5, "hdralign c # exits with 3: d".into(), 3)]);
}

/// Returns the anchor that Markdown renderers give to a heading.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    let kept = kept.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// Returns the anchors of the headings of a page.
fn anchors(text: &str) -> BTreeSet<String> {
    let mut is_fenced = false;
    let headings = text.lines().filter_map(|line| {
        is_fenced ^= line.starts_with("```");
        line.strip_prefix('#').filter(|_| !is_fenced)
    });
    headings.map(|heading| anchor(heading.trim_start_matches('#'))).collect()
}

#[test]
fn every_link_has_a_target() {
    let mut count = 0;
    for page in pages(&root().join("docs")).into_iter().chain([root().join("README.md")]) {
        let text = text(&page);
        let folder = page.parent().expect("a folder");
        for part in text.split("](").skip(1) {
            let target = part.split(')').next().expect("the end of the link");
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            let (path, heading) = target.split_once('#').unwrap_or((target, ""));
            let path = if path.is_empty() { page.clone() } else { folder.join(path) };
            assert!(path.exists(), "{}: ({target}) is not there", page.display());
            if !heading.is_empty() {
                let there = anchors(&fs::read_to_string(&path).expect("a page"));
                assert!(there.contains(heading), "{}: ({target}): no such heading: {there:?}", page.display());
            }
            count += 1;
        }
    }
    assert!(count > 80, "only {count} links were found");
}

#[test]
fn every_page_is_listed_in_the_summary() {
    let summary = text(&root().join("docs/SUMMARY.md"));
    for page in pages(&root().join("docs")) {
        let name = page.strip_prefix(root().join("docs")).expect("a page").to_string_lossy().replace('\\', "/");
        let is_listed = summary.contains(&format!("]({name})"));
        assert!(is_listed || ["SUMMARY.md", "pictures/README.md"].contains(&name.as_str()), "{name} is not listed");
    }
}

/// Compares `actual` with the file `path`; with `HDRALIGN_BLESS` writes it to the file instead.
fn compare(path: &str, actual: &str) {
    let file = root().join(path);
    if std::env::var_os("HDRALIGN_BLESS").is_some() {
        return fs::write(file, actual).expect("the file is written");
    }
    let expected = fs::read_to_string(file).unwrap_or_default();
    let differs = expected.lines().zip(actual.lines()).position(|(a, b)| a != b);
    let line = differs.unwrap_or(expected.lines().count().min(actual.lines().count())) + 1;
    assert!(
        expected == actual,
        "{path}:{line}: the help text has changed:\n  {:?}\n  {:?}\nto accept it: HDRALIGN_BLESS=1 cargo test --test cli -- book",
        expected.lines().nth(line - 1).unwrap_or_default(),
        actual.lines().nth(line - 1).unwrap_or_default()
    );
}

#[test]
fn page_of_options_equals_the_help() {
    let folder = Folder::empty();
    let mut page = String::from(
        "# Commands and options\n\nThis page is what `hdralign COMMAND --help` prints. `hdralign COMMAND -h` is the short form.\n",
    );
    let mut section = |title: &str, help: String| {
        page += &format!("\n## {title}\n\n```text\n{}\n```\n", help.trim_end());
    };
    section("hdralign", folder.line("--help").done().stdout);
    for command in COMMANDS {
        section(&format!("hdralign {command}"), folder.run([command, "--help"]).done().stdout);
    }
    compare("docs/reference/options.md", &page);
}

/// Largest number of lines of a short help text, so that it fits on a screen.
const SCREEN: usize = 62;

#[test]
fn short_help_is_as_reviewed_and_fits_a_screen() {
    let folder = Folder::empty();
    let mut all = String::new();
    for command in COMMANDS {
        let help = folder.run([command, "-h"]).done().stdout;
        let (lines, widest) = (help.lines().count(), help.lines().map(str::len).max().unwrap_or_default());
        assert!(lines <= SCREEN && widest <= 100, "hdralign {command} -h: {lines} lines, {widest} columns");
        all += &format!("$ hdralign {command} -h\n{help}\n");
    }
    compare("tests/fixtures/short-help.txt", &all);
}
