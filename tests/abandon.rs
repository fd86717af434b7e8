//! An abandoned run leaves no files. Abandoning ends all writing of the process, so this test is a program of its own.

mod support;

use hdralign::error::Error;
use hdralign::write::{self, Pending};
use support::Folder;

#[test]
fn abandoned_run_leaves_no_files_and_creates_none() {
    let folder = Folder::empty();
    let at = |name: &str| folder.at(name);
    let pending = write::text(&at("a.txt"), "a").unwrap().file;
    let whole = write::complete(&at("b.txt"), b"b").unwrap();
    let new = write::NewFolder::create(&at("new")).unwrap();
    let inside = write::complete(&at("new/c.txt"), b"c").unwrap();
    write::abandon();
    assert!(folder.listing().is_empty(), "at once");
    let is_abandoned = |error: Error, name: &str| {
        let text = error.to_string();
        assert!(matches!(error, Error::Abandoned { .. }) && text.contains(name) && !error.is_usage(), "{text}");
    };
    is_abandoned(write::commit(vec![pending], true).unwrap_err(), "a.txt");
    is_abandoned(write::rename_all(vec![whole], true).unwrap_err(), "b.txt");
    is_abandoned(Pending::create(&at("c.txt")).unwrap_err(), "c.txt");
    is_abandoned(write::NewFolder::create(&at("d")).unwrap_err(), "d: was not written");
    drop((inside, new));
    assert!(folder.listing().is_empty());
}
