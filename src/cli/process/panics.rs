//! Handling of panics. The library catches panics of decoders. `batch` (not `batch --run`) also catches panics of a
//! job; then only this job fails. This module prints nothing for panics that are caught. A panic of the thread that
//! moves the progress bar is ignored. Other panics of a command end the program with a message.

use crate::cli::say;
use std::backtrace::{Backtrace, BacktraceStatus};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::sync::Mutex;

/// The message and source position of the last panic, with a backtrace if one was captured.
static LAST: Mutex<String> = Mutex::new(String::new());

/// The exit code of Rust programs that panic.
const PANICKED: u8 = 101;

/// Calls `run` and returns its result. Panics that are caught inside `run` print nothing. A panic that `run` does not
/// catch is printed, and the exit code is [`PANICKED`].
pub(crate) fn guarded(run: impl FnOnce() -> ExitCode) -> ExitCode {
    std::panic::set_hook(Box::new(|panic| {
        let trace = Backtrace::capture();
        let trace = if trace.status() == BacktraceStatus::Captured { format!("\n{trace}") } else { String::new() };
        let mut last = LAST.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        *last = format!("{panic}{trace}");
    }));
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|_| {
        let last = LAST.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        say(format_args!("hdralign: internal error; please report it, with the files and this text: {last}"));
        ExitCode::from(PANICKED)
    })
}
