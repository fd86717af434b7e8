//! The crates of the program and their licences: docs/reference/licences.md lists them, and this test checks it.
//!
//! `HDRALIGN_BLESS=1 cargo test --test library licences` writes the page again.

#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use std::collections::BTreeSet;
use std::fmt::Write;
use std::fs;
use std::path::Path;
use std::process::Command;

/// Accepted licences: they require only that the authors are named. deny.toml has the same list.
const FINE: [&str; 7] = ["MIT", "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "Zlib", "Unicode-3.0", "IJG"];

const PAGE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/reference/licences.md");

const BEGIN: &str = "\
# The crates in the program, and their licences

This page lists the crates that `cargo build --release --locked` compiles for `hdralign` on 64-bit
Linux, including build scripts and procedural macros. The program also contains

- the standard library of Rust (MIT or Apache-2.0),
- the library musl (MIT), only in the static binary,
- a part of the font DejaVu Sans Condensed 2.37, for the text of drawings. Its licence (Bitstream
  Vera) is in [src/draw/font/README.md](../../src/draw/font/README.md).

hdralign itself is licensed under MIT or Apache-2.0.

The test `cargo test --test library licences` fails if this page is out of date, or if a licence is
not one of those in deny.toml. With `HDRALIGN_BLESS=1` it writes this page again.

| crate | version | licence |
|---|---|---|
";

/// Returns name, version and licence of every crate that is compiled for the program, without crates for tests.
fn crates() -> BTreeSet<[String; 3]> {
    let output = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()))
        .args(["tree", "--locked", "--offline", "--edges", "normal,build", "--target", "x86_64-unknown-linux-gnu"])
        .args(["--prefix", "none", "--format", "{p};{l}"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    let read = |line: &str| {
        let (package, licence) = line.trim_end_matches(" (*)").split_once(';').expect("a package and its licence");
        let (name, version) = package.trim_end_matches(" (proc-macro)").split_once(" v").expect("a version");
        // After the version, cargo prints the source of a crate that is not from the registry.
        assert!(!version.contains(' '), "{package} is not from the registry");
        [name, version, licence].map(str::to_owned)
    };
    // The first line is the program itself.
    text.lines().skip(1).filter(|line| !line.is_empty()).map(read).collect()
}

/// With its feature `std` the code of zlib-rs, and so the bytes of PNG and TIFF files, would depend on the CPU.
#[test]
fn zlib_rs_does_not_detect_the_cpu() {
    let output = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()))
        .args(["tree", "--locked", "--offline", "--edges", "normal", "--prefix", "none", "--format", "{p};{f}"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo runs");
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    let line = text.lines().find(|line| line.starts_with("zlib-rs ")).expect("zlib-rs is used");
    assert_eq!(line.trim_end_matches(" (*)").split_once(';').map(|(_, features)| features), Some("rust-allocator"));
}

/// Returns whether the licence expression `terms` can be fulfilled with licences of [`FINE`]. Expects the form that
/// crates use: alternatives separated by OR or `/`, in parentheses where such groups are joined by AND.
fn is_fine(terms: &str) -> bool {
    terms.split(" AND ").all(|part| {
        let part = part.trim_matches(['(', ')']);
        part.split(" OR ").flat_map(|p| p.split('/')).any(|one| FINE.contains(&one.trim()))
    })
}

#[test]
fn crates_are_listed_and_have_allowed_licences() {
    let crates = crates();
    assert!(crates.len() > 50, "{} crates: the check is blind", crates.len());
    // An optional dependency of our dependencies, which must not be compiled.
    assert!(!crates.iter().any(|[name, ..]| name == "euclid"), "{crates:?}");
    let mut page = BEGIN.to_owned();
    for [name, version, licence] in crates {
        assert!(is_fine(&licence), "{name} is under {licence:?}");
        writeln!(page, "| {name} | {version} | {licence} |").expect("a string");
    }
    if std::env::var_os("HDRALIGN_BLESS").is_some_and(|v| v == "1") {
        fs::write(PAGE, &page).expect("docs/reference/licences.md");
    }
    let there = if Path::new(PAGE).exists() {
        fs::read_to_string(PAGE).expect("docs/reference/licences.md")
    } else {
        String::new()
    };
    assert!(
        there == page,
        "docs/reference/licences.md is out of date: HDRALIGN_BLESS=1 cargo test --test library licences"
    );
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
