//! The threads of a run.
//!
//! In: the requested number. Out: the result of the work, from a pool of that many threads. Cost: starting the pool.

use crate::error::{Error, Result};

/// Maximum number of threads; more only cost memory.
const MOST_THREADS: usize = 1024;

/// Runs `work` on a pool of `threads` threads. If `threads` is `None`, runs it on the global pool, which is started if
/// necessary.
pub(super) fn in_pool<R: Send>(threads: Option<usize>, work: impl FnOnce() -> Result<R> + Send) -> Result<R> {
    if threads.is_none() {
        start_threads(None)?;
    }
    in_own_pool(threads, work)
}

/// Runs `work` on a pool of `threads` threads. If `threads` is `None`, runs it on the pool of the caller.
pub(super) fn in_own_pool<R: Send>(threads: Option<usize>, work: impl FnOnce() -> Result<R> + Send) -> Result<R> {
    let Some(threads) = threads else { return work() };
    let refused = |reason: String| Error::Option { option: "--threads", reason };
    if threads == 0 {
        return Err(refused("at least 1 thread is needed".into()));
    }
    if threads > MOST_THREADS {
        return Err(refused(format!(
            "{threads} threads are more than the limit of {MOST_THREADS}; give about as many as there are cores"
        )));
    }
    if rayon::current_thread_index().is_some() && rayon::current_num_threads() == threads {
        return work();
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    pool.map_err(|source| Error::Threads { threads, source })?.install(work)
}

/// Starts the global thread pool with `threads` threads, or with rayon's default (usually one per core) if it is
/// `None`, unless the pool exists. Must be called before code that computes on the global pool. Otherwise that code
/// panics if the system refuses threads.
///
/// # Errors
/// [`Error::Threads`].
pub fn start_threads(threads: Option<usize>) -> Result<()> {
    if rayon::current_thread_index().is_some() {
        return Ok(());
    }
    // For rayon, 0 is the default number.
    let threads = threads.unwrap_or(0).min(MOST_THREADS);
    match rayon::ThreadPoolBuilder::new().num_threads(threads).build_global() {
        // If the pool exists already, the error has no source.
        Err(source) if std::error::Error::source(&source).is_some() => Err(Error::Threads { threads, source }),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_threads_are_refused() {
        let error = in_pool(Some(0), || Ok(())).unwrap_err();
        assert!(error.is_usage());
    }
}
