//! Plain English: words that sources and documents do not use, and what to write instead.
//!
//! The list grows when a reader stumbles over a word. A line that must use one (a quotation, a term of a format) ends with `// plain-english: allow`
//! in sources; documents have no exceptions.

use std::fs;
use std::path::{Path, PathBuf};

/// Words and phrases to avoid, in lower case, each with the plain replacement.
const INSTEAD: [(&str, &str); 46] = [
    ("afresh", "again"),
    ("aloud", "with a warning"),
    ("anew", "again"),
    ("as good as none", "negligible"),
    ("as it lies", "unaligned"),
    ("as they lie", "unaligned"),
    ("befall", "happen"),
    ("begun", "started"),
    ("believed", "used, accepted"),
    ("brackets that are none", "invalid brackets"),
    ("burnt out", "clipped"),
    ("by content and not by date", "compared by hash"),
    ("doubted", "reported as uncertain"),
    ("for want of", "without"),
    ("gainsay", "contradict"),
    ("goes by", "is selected by"),
    ("heed", "use"),
    ("in its stead", "instead"),
    ("in their stead", "instead"),
    ("is had", "is recovered, is obtained"),
    ("keep company", "agree"),
    ("lest", "so that ... not"),
    ("mend", "fix"),
    ("mended", "fixed"),
    ("mends", "fixes"),
    ("none to speak of", "negligible"),
    ("nothing left out", "all frames used"),
    ("nothing to speak of", "negligible"),
    ("of its own accord", "automatically"),
    ("see it off", "measure it displaced"),
    ("so much as", "even"),
    ("spoil", "corrupt, affect"),
    ("spoils", "corrupts, affects"),
    ("spoilt", "corrupted, affected"),
    ("suitor", "candidate"),
    ("suitors", "candidates"),
    ("to speak of", "considerable"),
    ("told", "reported, printed, known"),
    ("unto", "to"),
    ("veil", "flare"),
    ("vouch", "show"),
    ("vouches", "shows"),
    ("whence", "from which"),
    ("whoever", "code that, a user who"),
    ("whole in itself", "self-contained"),
    ("witness", "evidence"),
];

fn walk(folder: &Path, extensions: &[&str], found: &mut Vec<PathBuf>) {
    for path in fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path()) {
        if path.is_dir() {
            walk(&path, extensions, found);
        } else if path.extension().is_some_and(|e| extensions.iter().any(|x| e == *x)) {
            found.push(path);
        }
    }
}

/// Returns the words of `text` in lower case, with single spaces between and around them. Underscores separate words.
fn words(text: &str) -> String {
    let mut words = String::from(" ");
    for word in text.split(|c: char| !c.is_alphanumeric() && c != '\'').filter(|word| !word.is_empty()) {
        words.extend([&word.to_lowercase(), " "]);
    }
    words
}

/// Returns the line number, the word and its replacement for each finding in `text`.
fn findings(text: &str) -> Vec<(usize, &'static str, &'static str)> {
    let mut found = Vec::new();
    for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.contains("plain-english: allow")) {
        let words = words(line);
        let on_line = INSTEAD.iter().filter(|(word, _)| words.contains(&format!(" {word} ")));
        found.extend(on_line.map(|&(word, plain)| (number + 1, word, plain)));
    }
    found
}

#[test]
fn sources_and_documents_use_plain_words() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = ["README.md", "CHANGELOG.md", ".ci/run", "Cargo.toml", "deny.toml"].map(|f| root.join(f)).to_vec();
    walk(&root.join("src"), &["rs"], &mut files);
    walk(&root.join("docs"), &["md"], &mut files);
    walk(&root.join("workflow"), &["md", "sh", "Snakefile", "yaml"], &mut files);
    walk(&root.join("benches"), &["rs", "py"], &mut files);
    walk(&root.join("examples"), &["rs"], &mut files);
    walk(&root.join("fuzz/fuzz_targets"), &["rs"], &mut files);
    walk(&root.join("fuzz/src"), &["rs"], &mut files);
    walk(&root.join("tests"), &["rs"], &mut files);
    // This file contains the list itself.
    files.retain(|file| !file.ends_with("tests/library/language.rs"));
    assert!(files.len() > 300, "only {} files were read", files.len());
    files.sort();
    let mut all = Vec::new();
    for file in files {
        let text = fs::read_to_string(&file).unwrap_or_else(|e| panic!("{}: {e}", file.display()));
        let name = file.strip_prefix(root).expect("a file of the project").display().to_string();
        all.extend(findings(&text).into_iter().map(|(n, word, plain)| format!("{name}:{n}: {word}: write {plain}")));
    }
    assert!(all.is_empty(), "{} places:\n  {}\n", all.len(), all.join("\n  "));
}

#[test]
fn words_are_found_whole_and_across_punctuation() {
    assert_eq!(words("It's_told, Twice."), " it's told twice ");
    let text = "stolden\nis\n// was (told)\nlet a = 1; // told plain-english: allow\nin_its_stead";
    assert_eq!(findings(text), [(3, "told", "reported, printed, known"), (5, "in its stead", "instead")]);
}
