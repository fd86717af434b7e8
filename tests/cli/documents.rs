//! Compares the documents and the help with the program: quoted commands, options and values, and names of files and
//! tests.

use crate::book::pages;
use crate::shell::COMMANDS;
use crate::support::Folder;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Returns the root folder of the project.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Returns the relative path and the text of each document.
fn documents() -> Vec<(String, String)> {
    let others = ["README.md", "testdata/window/README.md", "workflow/Snakefile", "workflow/parallel.sh"];
    let paths: BTreeSet<PathBuf> =
        pages(&root().join("docs")).into_iter().chain(others.map(|name| root().join(name))).collect();
    let read = |path: PathBuf| {
        let name = path.strip_prefix(root()).expect("a document of the project").to_string_lossy().into_owned();
        (name, fs::read_to_string(path).expect("a document"))
    };
    paths.into_iter().map(read).collect()
}

/// Returns the output of `hdralign COMMAND --help` for each command, with a name.
fn helps(folder: &Folder) -> Vec<(String, String)> {
    let help = |command| (format!("{command} --help"), folder.run([command, "--help"]).done().stdout);
    COMMANDS.into_iter().map(help).collect()
}

/// Returns the texts between backticks on a line.
fn spans(line: &str) -> impl Iterator<Item = &str> {
    line.split('`').skip(1).step_by(2)
}

/// Returns the command on `line` of a document or of the help, without redirections; `None` if there is none.
fn command(line: &str) -> Option<&str> {
    let line = line.trim_start_matches(['#', ' ']).strip_prefix("hdralign ")?;
    let end = ["   ", " #", " >", " |", " \\"].iter().filter_map(|mark| line.find(mark)).min();
    Some(&line[..end.unwrap_or(line.len())])
}

/// Returns the lines of `text` in code blocks: between fences, or indented.
fn set_apart(text: &str) -> Vec<&str> {
    let mut is_fenced = false;
    let mut lines = Vec::new();
    for line in text.lines() {
        if line.starts_with("```") {
            is_fenced = !is_fenced;
        } else if is_fenced || line.trim_start_matches("#").starts_with("  ") {
            lines.push(line);
        }
    }
    lines
}

/// The files in the quoted commands do not exist, but the parser must accept the commands.
#[test]
fn quoted_command_is_understood() {
    let folder = Folder::empty();
    let texts = documents().into_iter().chain(helps(&folder)).chain([("--help".into(), folder.line("--help").stdout)]);
    let mut count = 0;
    for (name, text) in texts {
        for line in set_apart(&text) {
            let Some(command) = command(line) else { continue };
            // Absolute paths would refer to files of this machine, so they are made relative.
            let run = folder.run(command.split_whitespace().map(|word| word.trim_start_matches('/')));
            assert!(!run.stderr.starts_with("error:"), "{name}: hdralign {command}\n{}", run.stderr);
            count += 1;
        }
    }
    assert!(count > 60, "only {count} commands were found");
}

/// Splits the help into parts, one for each option: the line with its name, and its description.
fn by_option(help: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    for line in help.lines() {
        let inset = line.len() - line.trim_start().len();
        if inset <= 6 && line.trim_start().starts_with('-') {
            parts.push(String::new());
        }
        parts.last_mut().expect("a part").extend([line, "\n"]);
    }
    parts.split_off(1)
}

/// Returns whether this part of the help describes `option`.
fn is_on(part: &str, option: &str) -> bool {
    part.lines().next().is_some_and(|head| head.split([' ', ',', '[']).any(|word| word == option))
}

#[test]
fn named_option_exists_and_takes_the_values_named() {
    let folder = Folder::empty();
    let parts: Vec<String> = helps(&folder).iter().flat_map(|(_, help)| by_option(help)).collect();
    let (mut count, mut values) = (0, 0);
    // Pages that are skipped: they name options of other programs, or are the help itself.
    let others = [
        "docs/contributing/add-a-detector.md",
        "docs/contributing/tests.md",
        "docs/guides/cluster.md",
        "docs/guides/parallel.md",
        "docs/reference/options.md",
        "docs/reference/report-page.md",
    ];
    for (name, text) in documents().into_iter().filter(|(name, _)| !others.contains(&name.as_str())) {
        for (number, line) in text.lines().enumerate() {
            for span in spans(line).filter(|span| span.starts_with("--") && span.len() > 2) {
                let span = span.replace('\\', "");
                let (option, value) = span.split_once([' ', '=', '[']).unwrap_or((&span, ""));
                let parts: Vec<&String> = parts.iter().filter(|part| is_on(part, option)).collect();
                let place = format!("{name}:{}: {span}", number + 1);
                assert!(!parts.is_empty() || option == "--version", "{place}: no command has it");
                count += 1;
                for value in value.split('|').filter(|v| v.starts_with(|c: char| c.is_ascii_lowercase())) {
                    let listed = |part: &&String| part.contains("Possible values:");
                    let is_taken = |part: &&String| part.contains(&format!("- {value}:"));
                    assert!(!parts.iter().any(listed) || parts.iter().any(is_taken), "{place}: {value} is not taken");
                    values += usize::from(parts.iter().any(listed));
                }
            }
        }
    }
    assert!(count > 120 && values > 30, "only {count} options and {values} values were found");
}

/// Adds the path and the text of each test source in `folder` to `found`.
fn tests_of(folder: &Path, found: &mut Vec<(String, String)>) {
    for path in fs::read_dir(folder).expect("a folder of tests").map(|entry| entry.expect("an entry").path()) {
        if path.is_dir() {
            tests_of(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push((path.to_string_lossy().into_owned(), fs::read_to_string(&path).expect("a test")));
        }
    }
}

#[test]
fn named_test_and_file_exist() {
    let mut sources = Vec::new();
    tests_of(&root().join("tests"), &mut sources);
    let (mut tests, mut files) = (0, 0);
    for (name, text) in documents() {
        for (number, line) in text.lines().enumerate() {
            let place = |what: &str| format!("{name}:{}: {what}", number + 1);
            for span in spans(line) {
                let is_test = span.contains("::")
                    && !span.ends_with(':')
                    && span.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '_' | ':'));
                if is_test {
                    let (module, test) = span.rsplit_once("::").expect("two parts");
                    let is_there = sources.iter().any(|(path, source)| {
                        path.contains(&module.replace("::", "/")) && source.contains(&format!("fn {test}("))
                    });
                    assert!(is_there, "{}", place(span));
                    tests += 1;
                }
            }
            for word in line.split([' ', '`', '(', ')', '"', ',', '|', ';']) {
                let path = word.split('#').next().unwrap_or(word).trim_end_matches(['.', ':']);
                let is_path = ["tests/", "src/", "benches/", "docs/", "testdata/", "workflow/", "examples/"]
                    .iter()
                    .any(|f| path.starts_with(f));
                // Files of examples in the pages for contributors do not exist.
                let is_example = ["surf", "ward97", "pfm", "ppm"].iter().any(|name| path.contains(name));
                if is_path && !is_example && !path.contains('*') {
                    assert!(root().join(path).exists(), "{}", place(path));
                    files += 1;
                }
            }
        }
    }
    assert!(tests > 100 && files > 20, "only {tests} tests and {files} files were found");
}
