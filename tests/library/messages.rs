//! The table of messages: every text of the program with five words or more, sorted, so that a change is reviewed beside similar messages.
//!
//! `HDRALIGN_BLESS=1 cargo test --test library messages` writes the table again.

use crate::architecture::source::sources;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Smallest number of words of a text in the table; shorter ones are names, keys and labels.
const FEWEST_WORDS: usize = 5;

/// Returns the texts of the sources, each with its file. Line breaks and indentation of the source are removed; texts
/// in HTML, SVG or XML are skipped.
fn table() -> String {
    let mut lines = BTreeSet::new();
    for source in sources().iter().filter(|source| !source.path.contains("tests")) {
        for text in &source.texts {
            let mut joined = String::new();
            for (i, line) in text.split("\\\n").enumerate() {
                joined += if i == 0 { line } else { line.trim_start() };
            }
            let is_markup = joined.contains('<') && joined.contains('>');
            let words = joined.split_whitespace().filter(|word| word.chars().any(char::is_alphabetic)).count();
            if words >= FEWEST_WORDS && !is_markup && !joined.contains('\n') {
                lines.insert(format!("{joined}  [{}]", source.path));
            }
        }
    }
    lines.into_iter().collect::<Vec<_>>().join("\n") + "\n"
}

#[test]
fn messages_are_those_of_the_reviewed_table() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/messages.txt");
    let actual = table();
    assert!(actual.lines().count() > 300, "only {} messages: the check is blind", actual.lines().count());
    if std::env::var_os("HDRALIGN_BLESS").is_some() {
        fs::write(&file, &actual).expect("the table is written");
    }
    let expected = fs::read_to_string(&file).expect("tests/fixtures/messages.txt");
    let (expected, actual): (BTreeSet<&str>, BTreeSet<&str>) = (expected.lines().collect(), actual.lines().collect());
    let gone: Vec<&&str> = expected.difference(&actual).collect();
    let new: Vec<&&str> = actual.difference(&expected).collect();
    assert!(
        gone.is_empty() && new.is_empty(),
        "messages have changed:\n- {gone:#?}\n+ {new:#?}\nto accept them: HDRALIGN_BLESS=1 cargo test --test library messages"
    );
}
