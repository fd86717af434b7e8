//! Every crate that the program is built from, and on what terms: docs/licences.md says so, and this holds it to the truth.
//!
//! `HDRALIGN_BLESS=1 cargo test --test licences` writes the page anew.

#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Terms that ask for no more than to name the authors. deny.toml has the same list.
const FINE: [&str; 7] = ["MIT", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "Zlib", "Unicode-3.0", "IJG"];

const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/licences.md");

const BEGIN: &str = "\
# The crates in the program, and their licences

What `cargo build --release --locked` compiles into `hdralign` on 64-bit Linux, build scripts and procedural macros included; the standard library of Rust
(MIT or Apache-2.0) and, in the static binary, that of musl (MIT) come to it. hdralign itself: MIT or Apache-2.0. Written by
`HDRALIGN_BLESS=1 cargo test --test licences`, which otherwise fails when it is out of date, or when a licence is not one of those in deny.toml.

| crate | version | licence |
|---|---|---|
";

/// What cargo says of the packages, those of this platform alone: no other has been fetched.
fn metadata() -> Value {
    let output = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()))
        .args(["metadata", "--locked", "--offline", "--format-version", "1"])
        .args(["--filter-platform", "x86_64-unknown-linux-gnu"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

/// The packages that the program needs, directly or not; those of the tests are left out.
fn needed(metadata: &Value) -> BTreeSet<&str> {
    let nodes = metadata["resolve"]["nodes"].as_array().expect("a list");
    let by_id: BTreeMap<&str, &Value> = nodes.iter().map(|n| (n["id"].as_str().expect("an id"), n)).collect();
    let root = metadata["resolve"]["root"].as_str().expect("the program");
    let (mut found, mut open) = (BTreeSet::new(), vec![root]);
    while let Some(id) = open.pop() {
        for dep in by_id[id]["deps"].as_array().expect("a list") {
            let is_for_tests = dep["dep_kinds"].as_array().expect("a list").iter().all(|k| k["kind"] == "dev");
            let id = dep["pkg"].as_str().expect("an id");
            if !is_for_tests && found.insert(id) {
                open.push(id);
            }
        }
    }
    found
}

/// Whether some way through the terms leads to `FINE` ones alone. Terms as crates have them: no WITH that matters, OR binds what stands
/// in brackets, AND joins brackets.
fn is_fine(terms: &str) -> bool {
    terms.split(" AND ").all(|part| {
        let part = part.trim_matches(['(', ')']);
        part.split(" OR ").flat_map(|p| p.split('/')).any(|one| FINE.contains(&one.trim()))
    })
}

#[test]
fn all_crates_are_listed_with_their_licences_and_none_asks_for_more_than_we_allow() {
    let metadata = metadata();
    let needed = needed(&metadata);
    assert!(needed.len() > 50, "{} crates: the check is blind", needed.len());
    let mut page = BEGIN.to_owned();
    let mut lines = BTreeSet::new();
    for package in metadata["packages"].as_array().expect("a list") {
        let text = |key: &str| package[key].as_str().unwrap_or_default().to_owned();
        if needed.contains(text("id").as_str()) {
            assert!(is_fine(&text("license")), "{} is under {:?}", text("name"), text("license"));
            assert!(text("source").starts_with("registry+"), "{} is from {:?}", text("name"), text("source"));
            lines.insert((text("name"), text("version"), text("license")));
        }
    }
    for (name, version, licence) in lines {
        writeln!(page, "| {name} | {version} | {licence} |").expect("a string");
    }
    if std::env::var_os("HDRALIGN_BLESS").is_some_and(|v| v == "1") {
        fs::write(PAGE, &page).expect("docs/licences.md");
    }
    let there =
        if Path::new(PAGE).exists() { fs::read_to_string(PAGE).expect("docs/licences.md") } else { String::new() };
    assert!(there == page, "docs/licences.md is out of date: HDRALIGN_BLESS=1 cargo test --test licences");
}

#[test]
fn terms_are_read_as_they_are_written() {
    for fine in ["MIT", "MIT OR Apache-2.0", "Unlicense/MIT", "(MIT OR Apache-2.0) AND IJG", "GPL-3.0 OR Zlib"] {
        assert!(is_fine(fine), "{fine}");
    }
    for more in ["", "GPL-3.0", "MIT AND LGPL-2.1", "(MIT OR Apache-2.0) AND MPL-2.0", "Unlicense"] {
        assert!(!is_fine(more), "{more}");
    }
}
