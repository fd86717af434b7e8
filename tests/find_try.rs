//! try
use hdralign::batch::{FindOptions, find};
use std::path::PathBuf;
#[test]
fn try_it() {
    let roots: Vec<PathBuf> = std::env::var("ROOTS").unwrap().split(':').map(PathBuf::from).collect();
    let options = FindOptions {
        frames: std::env::var("FRAMES").ok().map(|f| f.parse().unwrap()),
        by_folder: std::env::var("BYF").is_ok(),
        ..FindOptions::default()
    };
    let start = std::time::Instant::now();
    let found = find(&roots, &options, &|_| ()).unwrap();
    let t = start.elapsed();
    if std::env::var("QUIET").is_err() {
        for b in &found.brackets {
            let names: Vec<_> = b.photographs.iter().map(|s| s.path.file_name().unwrap().to_string_lossy().into_owned()).collect();
            println!("B {} set {} {}: {}", b.folder.display(), b.set, b.photographs.len(), names.join(" "));
        }
        for l in &found.left_over {
            println!("L {}: {}", l.path.display(), l.reason);
        }
    }
    println!("{} brackets, {} left over, {} others, {t:?}", found.brackets.len(), found.left_over.len(), found.other_files);
    println!("{}", std::fs::read_to_string("/proc/self/status").unwrap().lines().find(|l| l.starts_with("VmHWM")).unwrap());
}
