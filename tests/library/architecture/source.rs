//! The sources for the checks: comments, string literals and tests are blanked, and lines keep their numbers.

use std::fs;
use std::path::{Path, PathBuf};

/// A file of `src/`.
pub struct Source {
    /// Path from the package's folder, with `/`.
    pub path: String,
    /// Module path from the crate's root: `["align", "features", "sift", "extrema"]`; empty for the crate's root and
    /// `main`.
    pub module: Vec<String>,
    /// Number of lines of the file.
    pub lines: usize,
    /// The code, in which comments, string literals and tests are blanked.
    pub code: String,
    /// The string literals outside of tests, as written.
    pub texts: Vec<String>,
}

impl Source {
    pub fn new(path: &str, text: &str) -> Self {
        let inner = path.trim_start_matches("src/").trim_end_matches(".rs");
        let mut module: Vec<String> = inner.split('/').map(str::to_owned).collect();
        if matches!(module.last().map(String::as_str), Some("mod" | "lib" | "main")) {
            module.pop();
        }
        let (blanked, literals) = blank(text);
        let code = without_tests(&blanked);
        // Blanking keeps the number of characters, so the marks of literals outside of tests are still at their
        // positions.
        let marks: Vec<char> = code.chars().collect();
        let texts = literals.into_iter().filter(|(at, _)| marks[*at] == MARK).map(|(_, text)| text).collect();
        let code = code.replace(MARK, " ");
        Source { path: path.to_owned(), module, lines: text.lines().count(), code, texts }
    }

    /// Returns `file:line` of the byte `at` of the code.
    pub fn place(&self, at: usize) -> String {
        format!("{}:{}", self.path, 1 + self.code[..at].matches('\n').count())
    }

    /// Returns the positions of `word` in the code, except where it is part of a longer word.
    pub fn words<'a>(&'a self, word: &'a str) -> impl Iterator<Item = usize> + 'a {
        let part = |c: char| c.is_alphanumeric() || c == '_';
        self.code.match_indices(word).map(|(at, _)| at).filter(move |&at| {
            let (before, after) = (&self.code[..at], &self.code[at + word.len()..]);
            !(word.starts_with(part) && before.ends_with(part) || word.ends_with(part) && after.starts_with(part))
        })
    }

    /// Returns the absolute module paths that the code names by `crate::`, `self::` or `super::`, each with its
    /// position.
    pub fn paths(&self) -> Vec<(Vec<String>, usize)> {
        let mut found = Vec::new();
        for root in ["crate", "self", "super"] {
            for at in self.words(root) {
                let rest = &self.code[at + root.len()..];
                let inside = self.code[..at].ends_with("::");
                if inside || !rest.trim_start().starts_with("::") {
                    continue;
                }
                let mut base = if root == "crate" { Vec::new() } else { self.module.clone() };
                if root == "super" {
                    base.pop();
                }
                let mut rest = rest.trim_start().trim_start_matches("::").trim_start();
                while let Some(further) = rest.strip_prefix("super::") {
                    base.pop();
                    rest = further;
                }
                let mut paths = Vec::new();
                tree(rest, &base, &mut paths);
                found.extend(paths.into_iter().map(|p| (p, at)));
            }
        }
        found
    }
}

/// Adds to `found` the path at the start of `text`, or all paths of a tree such as `a::{b, c::d}`, relative to `base`.
/// Returns the rest of the text.
fn tree<'a>(text: &'a str, base: &[String], found: &mut Vec<Vec<String>>) -> &'a str {
    let text = text.trim_start();
    if let Some(mut rest) = text.strip_prefix('{') {
        loop {
            rest = rest.trim_start().trim_start_matches(',').trim_start();
            if rest.is_empty() || rest.starts_with('}') {
                return rest.strip_prefix('}').unwrap_or(rest);
            }
            let before = rest.len();
            rest = tree(rest, base, found);
            if let Some(renamed) = rest.trim_start().strip_prefix("as ") {
                rest = renamed.trim_start().trim_start_matches(|c: char| c.is_alphanumeric() || c == '_');
            }
            assert!(rest.len() < before, "a use tree that is not understood: {rest:.40}");
        }
    }
    if let Some(rest) = text.strip_prefix('*') {
        found.push(base.to_vec());
        return rest;
    }
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len());
    let mut path = base.to_vec();
    if &text[..end] != "self" {
        path.push(text[..end].to_owned());
    }
    match text[end..].strip_prefix("::") {
        Some(rest) if rest.starts_with(|c: char| c.is_alphanumeric() || matches!(c, '_' | '{' | '*')) => {
            tree(rest, &path, found)
        }
        _ => {
            found.push(path);
            &text[end..]
        }
    }
}

/// Marks the start of a blanked string literal.
const MARK: char = '\u{1}';

/// Blanks comments, strings and characters, character by character. Returns also the strings, each with its position in characters, at which
/// the blanked text has a [`MARK`].
fn blank(text: &str) -> (String, Vec<(usize, String)>) {
    let mut out = String::with_capacity(text.len());
    let mut literals = Vec::new();
    let mut length = 0;
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let end = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").map_or(rest.len(), |i| i + 2)
        } else if let Some(hashes) = raw_string(rest, &out) {
            let close = format!("\"{}", "#".repeat(hashes));
            let open = hashes + 2;
            rest[open..].find(&close).map_or(rest.len(), |i| open + i + close.len())
        } else if c == '"' {
            quoted(rest, '"')
        } else if c == '\'' && (rest[1..].starts_with('\\') || rest.chars().nth(2) == Some('\'')) {
            quoted(rest, '\'')
        } else {
            out.push(c);
            length += 1;
            rest = &rest[c.len_utf8()..];
            continue;
        };
        let is_string = c == '"' || c == 'r';
        if is_string {
            literals.push((length, rest[..end].trim_start_matches(['r', '#']).trim_matches(['#', '"']).to_owned()));
        }
        let blanks = rest[..end].chars().enumerate();
        out.extend(blanks.map(|(i, c)| {
            if is_string && i == 0 {
                MARK
            } else if c == '\n' {
                '\n'
            } else {
                ' '
            }
        }));
        length += rest[..end].chars().count();
        rest = &rest[end..];
    }
    (out, literals)
}

/// Returns the number of `#` of the raw string at the start of `text`, if there is one; `before` is the text before it.
fn raw_string(text: &str, before: &str) -> Option<usize> {
    let rest = text.strip_prefix('r')?;
    let hashes = rest.len() - rest.trim_start_matches('#').len();
    let begins = !before.ends_with(|c: char| c.is_alphanumeric() && c != 'b' || c == '_');
    (begins && rest[hashes..].starts_with('"')).then_some(hashes)
}

/// Returns the position after the literal at the start of `text`.
fn quoted(text: &str, quote: char) -> usize {
    let mut escaped = false;
    for (i, c) in text.char_indices().skip(1) {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            c if c == quote => return i + 1,
            _ => {}
        }
    }
    text.len()
}

/// Returns `code` in which every item with `#[cfg(test)]` is blanked, to the end of its block or to its semicolon.
fn without_tests(code: &str) -> String {
    let mut out = String::with_capacity(code.len());
    let mut rest = code;
    while let Some(at) = rest.find("#[cfg(test)]") {
        out.push_str(&rest[..at]);
        let mut depth = 0;
        let end = rest[at..].char_indices().find_map(|(i, c)| {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                _ => {}
            }
            (matches!(c, '}' | ';') && depth == 0).then_some(at + i + 1)
        });
        let end = end.unwrap_or(rest.len());
        out.extend(rest[at..end].chars().map(|c| if c == '\n' { '\n' } else { ' ' }));
        rest = &rest[end..];
    }
    out + rest
}

/// Returns all files of `src/`, sorted by path.
pub fn sources() -> Vec<Source> {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    walk(&package.join("src"), &mut files);
    files.sort();
    let found: Vec<Source> = files
        .iter()
        .map(|file| {
            let path = file.strip_prefix(package).expect("inside the package").to_string_lossy().replace('\\', "/");
            Source::new(&path, &fs::read_to_string(file).expect("a source file"))
        })
        .collect();
    assert!(found.len() > 30, "only {} files under src/", found.len());
    found
}

fn walk(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("an entry").path();
        if path.is_dir() {
            walk(&path, files);
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
}
