//! The memory allocator (mimalloc). On Unix, freed memory is returned to the system after a millisecond if the user
//! limits memory with `--max-memory`, and in `batch --run`. The default limit of memory does not have this effect.
//!
//! By default, mimalloc keeps freed pages for a second. The resident memory then depends on the speed of the machine,
//! and can be twice the memory in use. With a delay of a millisecond, it exceeds the memory in use by only a few
//! megabytes. mimalloc reads its settings from the environment before `main`. So the program sets an environment
//! variable and executes itself again in the same process. This costs 2 ms.

use clap::ArgMatches;

/// The environment variable for the time for which mimalloc keeps freed pages, and its value in milliseconds.
#[cfg(unix)]
const DELAY: (&str, &str) = ("MIMALLOC_PURGE_DELAY", "1");

/// Executes this program again with [`DELAY`] in its environment if `--max-memory` or `batch --run` is given. Does
/// nothing if the environment already sets a delay, or if the system cannot execute the program again.
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
    // `exec` returns only on failure.
    let _ = again.args(args).env(name, value).exec();
}

/// Does nothing, because only Unix can replace the program of a running process.
#[cfg(not(unix))]
pub fn give_back_soon(_: &ArgMatches) {}
