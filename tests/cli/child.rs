//! A run of the program that goes on while the test looks, and is sent signals.

#![cfg(unix)]

use crate::support::{Folder, program};
use signal_hook::consts::{SIGHUP, SIGINT};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Once};

/// Begins `line` in `folder`.
pub fn begin(folder: &Folder, line: &str) -> Child {
    handle_signals();
    let mut command = Command::new(program());
    command.args(line.split_whitespace()).current_dir(folder.path());
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts")
}

/// Gives INT and HUP handlers, so that processes started from here do not ignore them. They would inherit that where the tests run in the
/// background of a script, which ignores INT, or by `nohup`.
fn handle_signals() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        for signal in [SIGHUP, SIGINT] {
            // The tests end as they would.
            let always = Arc::new(AtomicBool::new(true));
            signal_hook::flag::register_conditional_shutdown(signal, 128 + signal, always).expect("a handler");
        }
    });
}

/// Sends `signal` to `child`, unless it has ended.
pub fn send(signal: &str, child: &mut Child) {
    if child.try_wait().expect("its state").is_none() {
        let sent = Command::new("kill").args([format!("-{signal}"), child.id().to_string()]).status().expect("kill");
        assert!(sent.success());
    }
}
