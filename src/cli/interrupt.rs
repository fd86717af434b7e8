//! Ctrl-C, and the signal by which systems end a process: nothing half is left behind.
//!
//! A command stops at once, and its temporary files are taken away. A batch first ends what it has begun; asked a second time it stops
//! at once too.

use hdralign::write;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// What a shell says of a process that Ctrl-C ended: 128 and the number of the signal.
const INTERRUPTED: i32 = 130;

static IS_BATCH: AtomicBool = AtomicBool::new(false);
static STOP: AtomicBool = AtomicBool::new(false);
static ASKED: AtomicUsize = AtomicUsize::new(0);

/// From here on signals are heard.
pub fn listen() {
    let heard = || {
        let times = ASKED.fetch_add(1, Ordering::SeqCst);
        if IS_BATCH.load(Ordering::SeqCst) && times == 0 {
            STOP.store(true, Ordering::SeqCst);
            eprintln!("\nhdralign: ending what has begun; once more stops at once");
            return;
        }
        write::abandon();
        eprintln!("\nhdralign: stopped; nothing half-written was left");
        std::process::exit(INTERRUPTED);
    };
    // Where signals cannot be heard they act as they always do.
    let _ = ctrlc::set_handler(heard);
}

/// Set when a batch should begin nothing more; the first signal does that from now on.
pub fn stopping() -> &'static AtomicBool {
    IS_BATCH.store(true, Ordering::SeqCst);
    &STOP
}
