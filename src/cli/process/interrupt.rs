//! Signals: Ctrl-C, termination, and limits of the process. No incomplete file is left.
//!
//! A command stops at once, and its temporary files are taken away. A batch first ends what it has begun; asked a second time it stops
//! at once too. What the process was started to ignore, as `nohup` does, it ignores. A file that grows beyond `ulimit -f` is an error of
//! the writing, not the end of the process.

use crate::cli::say;
use hdralign::write;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// What a shell adds to the number of the signal that ended a process.
const ENDED_BY: i32 = 128;

static IS_BATCH: AtomicBool = AtomicBool::new(false);
static STOP: AtomicBool = AtomicBool::new(false);
static ASKED: AtomicUsize = AtomicUsize::new(0);
static IS_ENDING: AtomicBool = AtomicBool::new(false);

/// Whether a file outgrew its limit; nobody asks, for the write says so itself.
#[cfg(unix)]
static OUTGREW: AtomicBool = AtomicBool::new(false);

/// Whether an abort is an exit like that of any failure.
#[cfg(unix)]
static ABORT_IS_FAILURE: AtomicBool = AtomicBool::new(true);

fn heard(signal: i32) {
    let times = ASKED.fetch_add(1, Ordering::SeqCst);
    if IS_BATCH.load(Ordering::SeqCst) && times == 0 {
        STOP.store(true, Ordering::SeqCst);
        say("\nhdralign: finishing the brackets in progress; interrupt again to stop at once");
        return;
    }
    IS_ENDING.store(true, Ordering::SeqCst);
    write::abandon();
    say("\nhdralign: stopped; no incomplete files were left");
    std::process::exit(ENDED_BY + signal);
}

/// Returns at once, or never where a signal is just ending the process: what failed because of that is not to be told, nor to give the exit code.
pub fn give_way() {
    while IS_ENDING.load(Ordering::SeqCst) {
        std::thread::park();
    }
}

/// From here on signals are heard. Where they cannot be they act as they always do.
#[cfg(unix)]
pub fn listen() {
    use signal_hook::consts::{SIGABRT, SIGHUP, SIGINT, SIGTERM, SIGXCPU, SIGXFSZ};
    // Rust aborts where the system refuses memory, and has said so by then: exit code 1, as of all that fails.
    let _ = signal_hook::flag::register_conditional_shutdown(SIGABRT, 1, &ABORT_IS_FAILURE);
    // Heard, it ends nothing: the system refuses the write, and that is told as an error of the file.
    let _ = signal_hook::flag::register(SIGXFSZ, &OUTGREW);
    let of_end = [(SIGINT, "INT"), (SIGTERM, "TERM"), (SIGHUP, "HUP"), (SIGXCPU, "XCPU")];
    let heard_of: Vec<i32> = of_end.iter().filter(|(n, name)| !is_ignored(*n, name)).map(|(n, _)| *n).collect();
    let (registered, is_registered) = std::sync::mpsc::channel();
    let hear = move || {
        let signals = signal_hook::iterator::Signals::new(heard_of);
        // Whoever waits goes on when this is dropped, too.
        drop(registered);
        if let Ok(mut signals) = signals {
            signals.forever().for_each(heard);
        }
    };
    if std::thread::Builder::new().name("hdralign signals".into()).spawn(hear).is_ok() {
        let _: Result<(), _> = is_registered.recv();
    }
}

/// Whether the process was started to ignore `signal`, which has the name `name`. Linux lists those that are; elsewhere a process that this one
/// starts, and that ignores what this one ignores, is sent it.
#[cfg(unix)]
fn is_ignored(signal: i32, name: &str) -> bool {
    let listed = std::fs::read_to_string("/proc/self/status").ok().and_then(|status| {
        let bits = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
        u64::from_str_radix(bits.trim(), 16).ok()
    });
    match listed {
        Some(bits) => bits >> (signal - 1) & 1 == 1,
        None => {
            let mut shell = std::process::Command::new("sh");
            let quiet = std::process::Stdio::null;
            shell.args(["-c", &format!("ulimit -c 0; kill -{name} $$")]).stdin(quiet()).stdout(quiet()).stderr(quiet());
            shell.status().is_ok_and(|end| end.success())
        }
    }
}

/// From here on Ctrl-C is heard. Where it cannot be it acts as it always does.
#[cfg(not(unix))]
pub fn listen() {
    /// Ctrl-C's number.
    const INTERRUPT: i32 = 2;
    let _ = ctrlc::set_handler(|| heard(INTERRUPT));
}

/// Set when a batch should begin nothing more; the first signal does that from now on.
pub fn stopping() -> &'static AtomicBool {
    IS_BATCH.store(true, Ordering::SeqCst);
    &STOP
}
