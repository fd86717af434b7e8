//! `hdralign completions` and `hdralign man`, which are generated from the definitions of the options.

use crate::support::Folder;
use std::collections::BTreeSet;

pub const COMMANDS: [&str; 9] =
    ["merge", "batch", "align", "response", "inspect", "tonemap", "compare", "completions", "man"];

#[test]
fn completions_contain_every_command_and_option() {
    let folder = Folder::empty();
    for shell in ["bash", "zsh", "fish", "powershell"] {
        let script = folder.line(&format!("completions {shell}")).done().stdout;
        for word in COMMANDS.into_iter().chain(["tolerance-stops", "save-aligned", "max-memory"]) {
            assert!(script.contains(word), "{shell}: {word}");
        }
    }
    assert!(folder.line("completions bash").done().stdout.starts_with("_hdralign()"));
    assert!(folder.line("completions zsh").done().stdout.starts_with("#compdef hdralign"));
    let unknown = folder.line("completions tcsh");
    assert!(unknown.code == 2 && unknown.stderr.contains("bash, zsh, fish, powershell"), "{unknown:?}");
}

#[test]
fn man_pages_exist_for_every_command_and_existing_files_are_kept() {
    let folder = Folder::empty();
    let main = folder.line("man").done().stdout;
    assert!(main.contains(".TH hdralign 1") && main.contains("hdralign\\-merge(1)"), "{main}");
    let names = |listing: &str| listing.lines().map(str::to_owned).collect::<BTreeSet<_>>();
    let written = names(&folder.line("man share/man1").done().stdout);
    let expected =
        COMMANDS.iter().map(|c| format!("share/man1/hdralign-{c}.1")).chain(["share/man1/hdralign.1".into()]);
    assert_eq!(written, expected.collect());
    assert_eq!(folder.bytes("share/man1/hdralign.1"), main.as_bytes());
    let page = String::from_utf8(folder.bytes("share/man1/hdralign-compare.1")).unwrap();
    assert!(
        page.contains("tolerance\\-stops") && page.contains("Examples:") && page.contains("hdralign compare"),
        "{page}"
    );
    let again = folder.line("man share/man1");
    assert!(again.code == 1 && again.stderr.contains("--force"), "{again:?}");
    folder.line("man share/man1 --force").done();
}
