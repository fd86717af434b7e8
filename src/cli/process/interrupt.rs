//! Signals: Ctrl-C, termination, and resource limits of the process. After a signal, no incomplete file is left.
//!
//! A command stops at once and removes its temporary files. A batch (not `batch --run`) first finishes the brackets
//! that are in progress; a second signal stops it at once. If the process was started with a signal ignored, as by
//! `nohup`, it continues to ignore this signal. A file that exceeds the limit of `ulimit -f` causes a write error, but
//! does not end the process.

use crate::cli::say;
use hdralign::write;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// If signal n ends a process, shells report the exit code 128 + n.
const ENDED_BY: i32 = 128;

static IS_BATCH: AtomicBool = AtomicBool::new(false);
static STOP: AtomicBool = AtomicBool::new(false);
static ASKED: AtomicUsize = AtomicUsize::new(0);
static IS_ENDING: AtomicBool = AtomicBool::new(false);

/// Becomes true if a file exceeds its size limit. It is never read, because the write itself fails and reports the
/// error.
#[cfg(unix)]
static OUTGREW: AtomicBool = AtomicBool::new(false);

/// Whether an abort ends the process with exit code 1, the code of a failure. It is always true; `signal_hook`
/// requires a flag.
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

/// Returns at once, unless a signal is ending the process; then never returns. So failures that the signal caused are
/// not reported, and do not determine the exit code.
pub fn give_way() {
    while IS_ENDING.load(Ordering::SeqCst) {
        std::thread::park();
    }
}

/// Starts to handle signals. If this fails, the signals have their default effects.
#[cfg(unix)]
pub fn listen() {
    use signal_hook::consts::{SIGABRT, SIGHUP, SIGINT, SIGTERM, SIGXCPU, SIGXFSZ};
    // If the system refuses memory, Rust prints a message and aborts. This handler changes the exit code of an abort
    // to 1, the code of other failures.
    let _ = signal_hook::flag::register_conditional_shutdown(SIGABRT, 1, &ABORT_IS_FAILURE);
    // With a handler, SIGXFSZ (file size limit exceeded) does not end the process. The write fails instead, and this
    // is reported as an error of the file.
    let _ = signal_hook::flag::register(SIGXFSZ, &OUTGREW);
    let of_end = [(SIGINT, "INT"), (SIGTERM, "TERM"), (SIGHUP, "HUP"), (SIGXCPU, "XCPU")];
    let heard_of: Vec<i32> = of_end.iter().filter(|(n, name)| !is_ignored(*n, name)).map(|(n, _)| *n).collect();
    let (registered, is_registered) = std::sync::mpsc::channel();
    let hear = move || {
        let signals = signal_hook::iterator::Signals::new(heard_of);
        // Dropping the sender wakes `recv` below: the handlers are registered now, or this failed.
        drop(registered);
        if let Ok(mut signals) = signals {
            signals.forever().for_each(heard);
        }
    };
    if std::thread::Builder::new().name("hdralign signals".into()).spawn(hear).is_ok() {
        let _: Result<(), _> = is_registered.recv();
    }
}

/// Returns whether the process was started with `signal` ignored; `name` is the name of the signal. Linux lists
/// ignored signals in `/proc/self/status`. On other systems, a child process sends the signal to itself: it ignores
/// the same signals as its parent, so it survives if the signal is ignored.
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

/// Starts to handle Ctrl-C. If this fails, Ctrl-C has its default effect.
#[cfg(not(unix))]
pub fn listen() {
    /// Number of the signal SIGINT, which Ctrl-C stands for.
    const INTERRUPT: i32 = 2;
    let _ = ctrlc::set_handler(|| heard(INTERRUPT));
}

/// Returns a flag: when it is true, the batch should start no further job. After this function was called, the first
/// signal sets the flag, and only the second signal ends the process.
pub fn stopping() -> &'static AtomicBool {
    IS_BATCH.store(true, Ordering::SeqCst);
    &STOP
}
