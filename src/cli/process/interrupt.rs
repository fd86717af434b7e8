//! Signals: Ctrl-C, termination, and limits of the process. No incomplete file is left.
//!
//! A command stops at once and removes its temporary files. A batch first finishes the brackets in progress; a second
//! signal stops it at once too. Signals that the process was started to ignore, as by `nohup`, are ignored. A file that
//! exceeds `ulimit -f` is a write error and does not end the process.

use crate::cli::say;
use hdralign::write;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Shells report a process ended by signal n with exit code 128 + n.
const ENDED_BY: i32 = 128;

static IS_BATCH: AtomicBool = AtomicBool::new(false);
static STOP: AtomicBool = AtomicBool::new(false);
static ASKED: AtomicUsize = AtomicUsize::new(0);
static IS_ENDING: AtomicBool = AtomicBool::new(false);

/// Set if a file exceeded its size limit. It is never read, because the write itself fails and reports the error.
#[cfg(unix)]
static OUTGREW: AtomicBool = AtomicBool::new(false);

/// Whether an abort becomes an exit with the code of a failure, 1; always true.
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

/// Returns at once, or never if a signal is ending the process: failures that the signal caused are not reported and do
/// not set the exit code.
pub fn give_way() {
    while IS_ENDING.load(Ordering::SeqCst) {
        std::thread::park();
    }
}

/// Starts to handle signals. If that fails, they have their default effects.
#[cfg(unix)]
pub fn listen() {
    use signal_hook::consts::{SIGABRT, SIGHUP, SIGINT, SIGTERM, SIGXCPU, SIGXFSZ};
    // If the system refuses memory, Rust prints a message and aborts; this changes the exit code to 1, as for other
    // failures.
    let _ = signal_hook::flag::register_conditional_shutdown(SIGABRT, 1, &ABORT_IS_FAILURE);
    // If SIGXFSZ is handled, it does not end the process: the write fails, which is reported as an error of the file.
    let _ = signal_hook::flag::register(SIGXFSZ, &OUTGREW);
    let of_end = [(SIGINT, "INT"), (SIGTERM, "TERM"), (SIGHUP, "HUP"), (SIGXCPU, "XCPU")];
    let heard_of: Vec<i32> = of_end.iter().filter(|(n, name)| !is_ignored(*n, name)).map(|(n, _)| *n).collect();
    let (registered, is_registered) = std::sync::mpsc::channel();
    let hear = move || {
        let signals = signal_hook::iterator::Signals::new(heard_of);
        // Dropping the sender ends the `recv` below.
        drop(registered);
        if let Ok(mut signals) = signals {
            signals.forever().for_each(heard);
        }
    };
    if std::thread::Builder::new().name("hdralign signals".into()).spawn(hear).is_ok() {
        let _: Result<(), _> = is_registered.recv();
    }
}

/// Returns whether the process was started to ignore `signal`, which has the name `name`. Linux lists ignored signals
/// in `/proc/self/status`. On other systems a child process, which ignores the same signals, sends the signal to
/// itself.
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

/// Starts to handle Ctrl-C. If that fails, Ctrl-C has its default effect.
#[cfg(not(unix))]
pub fn listen() {
    /// Number of the signal of Ctrl-C.
    const INTERRUPT: i32 = 2;
    let _ = ctrlc::set_handler(|| heard(INTERRUPT));
}

/// Returns the flag that is set when a batch should start no further job. After this call, the first signal sets the
/// flag, and only the second ends the process.
pub fn stopping() -> &'static AtomicBool {
    IS_BATCH.store(true, Ordering::SeqCst);
    &STOP
}
