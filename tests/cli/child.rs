//! A running process of the program, which the test observes and to which it sends signals.

#![cfg(unix)]

use crate::support::{Folder, program};
use signal_hook::consts::{SIGHUP, SIGINT};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Once};

/// Starts the program with the arguments `line` in `folder`.
pub fn begin(folder: &Folder, line: &str) -> Child {
    handle_signals();
    let mut command = Command::new(program());
    command.args(line.split_whitespace()).current_dir(folder.path());
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts")
}

/// Installs handlers for INT and HUP, so that child processes do not ignore these signals. If the tests run in the
/// background of a script, they ignore INT, and with `nohup` HUP; without handlers the child processes would inherit
/// this.
fn handle_signals() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        for signal in [SIGHUP, SIGINT] {
            // The handler ends the tests, as the default effect of the signal does.
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
