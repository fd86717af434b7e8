//! Common parts of the targets: a folder in memory, panics that are distinguished, and threads.
//!
//! In: bytes of the fuzzer. Out: files, because the library takes paths. Cost: a file in `/dev/shm`, about 20 us.

mod seeds;
pub mod ultra_hdr;

use hdralign::bracket::header::Header;
use hdralign::error::{Error, Result};
use hdralign::limits::Limits;
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, OnceLock, PoisonError};

/// Locations of panics, and their numbers.
static PANICS: Mutex<BTreeMap<String, usize>> = Mutex::new(BTreeMap::new());

/// Prepares the process. libfuzzer-sys aborts on every panic, also on those in the decoders of crates that the
/// library catches. Here only the first panic at each location is printed, and only those that [`held`] sees end the
/// process.
pub fn set_up() {
    std::panic::set_hook(Box::new(|panic| {
        let place = panic.location().map(ToString::to_string).unwrap_or_default();
        let mut panics = PANICS.lock().unwrap_or_else(PoisonError::into_inner);
        let count = panics.entry(place).or_default();
        *count += 1;
        if *count == 1 {
            eprintln!("PANIC, to be caught or not: {panic}");
        }
    }));
    // One thread, so that the same input takes the same path.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build_global();
    pool.expect("the first pool of this process");
    // Writes a first corpus instead of fuzzing: see seed.sh.
    if let Some(to) = std::env::var_os("HDRALIGN_FUZZ_SEEDS") {
        seeds::write(Path::new(&to));
        std::process::exit(0);
    }
}

/// Runs `work`, and aborts if it panics.
pub fn held<R>(work: impl FnOnce() -> R) -> R {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().cloned();
        let text = text.or_else(|| panic.downcast_ref::<&str>().map(|text| (*text).to_owned()));
        eprintln!("UNCAUGHT: {}", text.unwrap_or_default());
        std::process::abort()
    })
}

/// The folder of this process, in memory if possible.
pub fn folder() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = std::env::temp_dir().join(format!("hdralign-fuzz-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder for the files of this process");
        folder
    })
}

/// Writes `bytes` to the file `name` in this process's folder.
pub fn put(name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder().join(name);
    std::fs::write(&path, bytes).expect("room for a small file");
    path
}

/// Returns a number that depends on all of `bytes`, to choose between several ways.
pub fn hash(bytes: &[u8]) -> u64 {
    // FNV-1a.
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &b| (hash ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
}

/// Checks the text of an error: it must name the file, on one line.
pub fn check_error(error: &Error, name: &str) {
    let text = error.to_string();
    assert!(text.contains(name), "{text:?} does not name {name}");
    assert!(!text.trim().is_empty() && !text.contains("\n\n"), "{text:?}");
}

/// Reads the header of `path` and checks its guarantees.
pub fn header(path: &Path) -> Result<Header> {
    let header = Header::read(path, &Limits::default())?;
    assert!(header.width > 0 && header.height > 0);
    assert!((header.width * header.height) as u64 <= Limits::MAX_PIXELS);
    assert!(header.ev().is_none_or(f64::is_finite), "{:?}", header.exposure);
    assert!(header.bias_stops.is_none_or(f64::is_finite) && header.bracket_stops.is_none_or(f64::is_finite));
    assert!(header.focal_length_mm.is_none_or(|f| f > 0.0), "{:?}", header.focal_length_mm);
    let _ = (header.is_ours(), header.taken.map(|at| (at.to_string(), at.resolution_s(), at.since(&at))));
    Ok(header)
}
