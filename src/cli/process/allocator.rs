//! The allocator: where memory is limited, what is freed goes back to the system soon.
//!
//! mimalloc keeps freed pages for a second, so that how much is resident depends on how fast the machine is, and is up to twice what is in use. In a
//! millisecond no machine fills more than a few megabytes of other pages. It reads its settings from the environment before `main` begins; so the
//! program begins anew, in the same process, with the setting, which costs 2 ms.

use clap::ArgMatches;

/// How long mimalloc keeps freed pages, in milliseconds.
#[cfg(unix)]
const DELAY: (&str, &str) = ("MIMALLOC_PURGE_DELAY", "1");

/// Begins this program anew where memory is limited, by `--max-memory` or by an engine that begins the steps of a plan, and freed pages would be
/// kept. Whoever sets the delay in the environment has it so; where the system does not let the program begin anew it goes on.
#[cfg(unix)]
pub fn give_back_soon(matches: &ArgMatches) {
    use std::env;
    use std::os::unix::process::CommandExt;
    use std::process::Command;

    let has = |matches: &ArgMatches, id| matches.try_contains_id(id).unwrap_or(false);
    let is_limited = matches.subcommand().is_some_and(|(_, own)| has(own, "max_memory") || has(own, "run"));
    let (name, value) = DELAY;
    if !is_limited || env::var_os(name).is_some() {
        return;
    }
    let Ok(program) = env::current_exe() else { return };
    let mut args = env::args_os();
    let mut again = Command::new(program);
    if let Some(name) = args.next() {
        again.arg0(name);
    }
    // It gives only an error.
    let _ = again.args(args).env(name, value).exec();
}

/// Elsewhere a process cannot begin anew.
#[cfg(not(unix))]
pub fn give_back_soon(_: &ArgMatches) {}
