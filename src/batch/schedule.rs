//! Runs all jobs of a plan on one machine: as many at a time as cores and memory allow.
//!
//! In: jobs. Out: the outcome of each job. Cost: the jobs. A job starts after the jobs that it needs have ended. While
//! there are enough jobs for all cores, each job runs on one core: in total, this takes less time than running one job
//! on several cores. The last jobs share the remaining cores.
//!
//! A separate thread waits until files are on the disk and gives them their final names, so that computing threads do
//! not wait for the disk. If a job fails, only the jobs that need it are not run. Results do not depend on which jobs
//! run at the same time.

use super::job::{self, Brief, Made, Started};
use super::plan::Job;
use crate::budget::Demand;
use crate::error::Result;
use crate::pipeline::{self, Options};
use crate::scratch::MemoryLimit;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Largest number of computed jobs whose files are not on the disk yet. The thread that computes one more waits too.
const WAITING: usize = 4;

/// Limits on the resources that the batch uses.
#[derive(Debug, Clone, PartialEq)]
pub struct Limits {
    /// Largest number of jobs at a time; at least 1.
    pub jobs: usize,
    /// Largest number of computing threads, added over all running jobs; at least 1.
    pub threads: usize,
    /// Largest memory, added over all running jobs; `None` for no limit.
    pub memory: Option<MemoryLimit>,
}

/// The outcome of a job.
#[derive(Debug, Clone, PartialEq)]
pub enum Ending {
    /// The job was run in this batch.
    Done(Brief),
    /// The job was done in a previous run, with the same inputs, options and version.
    Unchanged(Brief),
    /// The job failed, with this error message.
    Failed(String),
    /// The job was not started, because the batch was stopped earlier, the disk for the job's results is full, or a job
    /// that it needs was not started.
    NotStarted,
}

/// An event of a batch. Any thread may report it.
#[derive(Debug)]
pub enum Event<'a> {
    /// A job starts.
    Begins(&'a Job),
    /// A job has ended.
    Ends(&'a Job, &'a Ending),
    /// The disk for this job's results is full; no further job that writes to the same disk is started.
    Fills(&'a Job),
}

/// Runs `jobs` with `options`. Returns their outcomes in the order of `jobs`. With `force`, jobs that were done in an
/// earlier run are run again. When `stop` becomes true, the running jobs are finished and no other job is started.
pub fn run(
    jobs: &[Job],
    options: &Options,
    limits: &Limits,
    force: bool,
    stop: &AtomicBool,
    watch: &(dyn Fn(Event) + Sync),
) -> Vec<Ending> {
    let board = Board::new(jobs, limits, stop, watch);
    let (to_namer, made) = sync_channel(WAITING);
    std::thread::scope(|scope| {
        // The system may refuse to start threads. So the current thread also runs jobs. If the thread that names
        // files could not be started, the threads that run jobs name the files.
        let thread = |name: &str| std::thread::Builder::new().name(name.into());
        let _ = thread("hdralign names").spawn_scoped(scope, || name(&board, made));
        for _ in 1..workers(jobs, limits) {
            let (to_namer, board) = (to_namer.clone(), &board);
            let _ = thread("hdralign jobs").spawn_scoped(scope, move || work(board, options, force, &to_namer));
        }
        work(&board, options, force, &to_namer);
        drop(to_namer);
    });
    board.endings()
}

/// Returns the largest number of jobs that can run at the same time. It is limited by [`Limits::jobs`], by the number
/// of jobs, and by how many jobs as small as the smallest fit into memory.
fn workers(jobs: &[Job], limits: &Limits) -> usize {
    let least = jobs.iter().map(pixels).min().unwrap_or(0).max(1);
    let fitting = usize::try_from(capacity(limits) / least).unwrap_or(usize::MAX);
    limits.jobs.min(jobs.len()).min(fitting).max(1)
}

/// Runs jobs of the board one after the other, until no job is left to start.
fn work<'a>(board: &Board<'a>, options: &Options, force: bool, to_namer: &SyncSender<(usize, Box<Made<'a>>)>) {
    // The thread pool is reused for the next job, because a new pool would not free the memory of the old threads.
    // While this thread waits for work, the pool is dropped, because idle threads keep memory that other jobs need.
    let mut pool: Option<ThreadPool> = None;
    while let Some((i, share)) = board.take(|| pool = None) {
        let own = share.options(options);
        if pool.as_ref().is_none_or(|pool| pool.current_num_threads() != share.threads) {
            pool = ThreadPoolBuilder::new().num_threads(share.threads).build().ok();
        }
        let begin = || guarded(|| job::begin(&board.jobs[i], &own, force, &pipeline::unwatched), || board.fill(i));
        // If the pool cannot be created here, `job::begin` tries to create it and reports the error.
        let started = pool.as_ref().map_or_else(begin, |pool| pool.install(begin));
        board.give_back(&share);
        match started {
            Ok(Started::Unchanged(brief)) => board.end(i, Ending::Unchanged(brief)),
            Ok(Started::Made(made)) => {
                if let Err(back) = to_namer.send((i, made)) {
                    let (i, made) = back.0;
                    board.end(i, named(board, i, made));
                }
            }
            Err(error) => board.end(i, Ending::Failed(error)),
        }
    }
}

/// Receives computed jobs. For each one, waits until its files are on the disk, and gives them their final names.
fn name(board: &Board, made: Receiver<(usize, Box<Made>)>) {
    made.iter().for_each(|(i, made)| board.end(i, named(board, i, made)));
}

fn named(board: &Board, i: usize, made: Box<Made>) -> Ending {
    guarded(|| made.commit(), || board.fill(i)).map_or_else(Ending::Failed, Ending::Done)
}

/// Runs `work` for a job. Returns its result, or the message of its error or panic. Calls `fill` if the error is a
/// full disk.
fn guarded<R>(work: impl FnOnce() -> Result<R>, fill: impl FnOnce()) -> std::result::Result<R, String> {
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
    let result = outcome.map_err(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
        let why = text.unwrap_or("unknown reason");
        format!("internal error ({why}); please report it, with these photographs")
    })?;
    result.map_err(|error| {
        if error.is_disk_full() {
            fill();
        }
        error.to_string()
    })
}

/// Returns the device number of the disk to which `job` writes its results; 0 if it is not known.
#[cfg(unix)]
fn disk(job: &Job) -> u64 {
    use std::os::unix::fs::MetadataExt;
    let there = job.report.ancestors().skip(1).find_map(|folder| {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        std::fs::metadata(folder).ok()
    });
    there.map_or(0, |folder| folder.dev())
}

#[cfg(not(unix))]
fn disk(_: &Job) -> u64 {
    0
}

/// The resources that one job may use.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Share {
    threads: usize,
    /// The bytes of [`Limits::memory`] that the job may use for its pixels and for its threads after the first.
    taken: u64,
}

impl Share {
    /// Returns the share of a job. `pixels` is the memory that its pixels need, `thread` the memory that each thread
    /// after the first needs, and `free` the free memory, all in bytes. The job may use at most `threads` threads.
    /// There are two cases if `free` is not enough for the pixels and all threads. If the pixels need at least four
    /// times as much memory as the additional threads, the job gets all threads, and keeps fewer pixels in memory.
    /// Otherwise the job gets one thread.
    fn of(pixels: u64, thread: u64, free: u64, threads: usize) -> Share {
        let extra = thread * (threads as u64 - 1);
        if pixels.saturating_add(extra) <= free {
            return Share { threads, taken: pixels + extra };
        }
        if pixels >= 4 * extra {
            return Share { threads, taken: free };
        }
        Share { threads: 1, taken: pixels }
    }

    fn options(&self, options: &Options) -> Options {
        let mut own = Options { threads: Some(self.threads), ..options.clone() };
        if let Some(limit) = &mut own.load.memory {
            limit.bytes = self.taken.saturating_add(MemoryLimit::PROGRAM);
        }
        own
    }
}

#[derive(Debug)]
enum State {
    Open,
    Going,
    Ended(Ending),
}

/// The states of all jobs, and the free resources.
struct Board<'a> {
    jobs: &'a [Job],
    places: BTreeMap<&'a str, usize>,
    limits: &'a Limits,
    stop: &'a AtomicBool,
    watch: &'a (dyn Fn(Event) + Sync),
    open: Mutex<Open>,
    changed: Condvar,
}

struct Open {
    states: Vec<State>,
    /// Bytes of the memory for pixels that no running job has taken.
    free: u64,
    /// Number of jobs that are being computed.
    going: usize,
}

impl<'a> Board<'a> {
    fn new(jobs: &'a [Job], limits: &'a Limits, stop: &'a AtomicBool, watch: &'a (dyn Fn(Event) + Sync)) -> Self {
        let states = jobs.iter().map(|_| State::Open).collect();
        let open = Open { states, free: capacity(limits), going: 0 };
        Board {
            jobs,
            places: jobs.iter().enumerate().map(|(i, job)| (job.id.as_str(), i)).collect(),
            limits,
            stop,
            watch,
            open: Mutex::new(open),
            changed: Condvar::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Open> {
        // A poisoned lock can be used: code that holds the lock cannot panic and leave the data inconsistent.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the index of the next job and its resources, or `None` if no job is left to start. If no job can start
    /// yet, calls `idle` and waits until the state of another job changes.
    fn take(&self, mut idle: impl FnMut()) -> Option<(usize, Share)> {
        let mut open = self.lock();
        loop {
            if self.stop.load(Ordering::SeqCst) {
                return None;
            }
            let failed = self.with_failed_need(&open);
            if !failed.is_empty() {
                failed.iter().for_each(|(i, ending)| open.states[*i] = State::Ended(ending.clone()));
                drop(open);
                failed.iter().for_each(|(i, ending)| self.tell(*i, ending));
                self.changed.notify_all();
                open = self.lock();
                continue;
            }
            let ready: Vec<usize> = (0..self.jobs.len()).filter(|&i| self.is_ready(&open, i)).collect();
            if let Some((i, pixels)) = self.longest(&open, &ready) {
                // If the memory is enough for only one such job at a time, the job may have all cores.
                let fitting = usize::try_from(capacity(self.limits) / pixels.max(1)).unwrap_or(usize::MAX);
                let at_once = (ready.len() + open.going).min(self.limits.jobs).min(fitting).max(1);
                let job = &self.jobs[i];
                let thread = Demand::another_thread((job.width_px, job.height_px));
                let share = Share::of(pixels, thread, open.free, (self.limits.threads / at_once).max(1));
                open.states[i] = State::Going;
                open.free -= share.taken;
                open.going += 1;
                drop(open);
                (self.watch)(Event::Begins(&self.jobs[i]));
                return Some((i, share));
            }
            if !open.states.iter().any(|state| matches!(state, State::Open)) {
                return None;
            }
            idle();
            open = self.changed.wait(open).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Returns the index of the job with the longest estimated time, and the bytes for its pixels. Considers the
    /// `ready` jobs whose pixels fit into the free memory. If several jobs are equally long, returns the first. Long
    /// jobs start first, because a long job that starts last would run alone at the end.
    fn longest(&self, open: &Open, ready: &[usize]) -> Option<(usize, u64)> {
        let sized = ready.iter().map(|&i| (i, pixels(&self.jobs[i]).min(capacity(self.limits))));
        let fitting = sized.filter(|(_, pixels)| *pixels <= open.free);
        fitting.min_by(|(a, _), (b, _)| self.jobs[*b].time_s.total_cmp(&self.jobs[*a].time_s))
    }

    fn is_ready(&self, open: &Open, i: usize) -> bool {
        let is_done = |id: &String| {
            let state = self.places.get(id.as_str()).map(|&i| &open.states[i]);
            matches!(state, Some(State::Ended(Ending::Done(_) | Ending::Unchanged(_))))
        };
        matches!(open.states[i], State::Open) && self.jobs[i].needs.iter().all(is_done)
    }

    /// Returns the open jobs that need a job which failed, was not started, or does not exist; each with the outcome
    /// that it now gets.
    fn with_failed_need(&self, open: &Open) -> Vec<(usize, Ending)> {
        let ending = |id: &String| match self.places.get(id.as_str()).map(|&i| &open.states[i]) {
            None => Some(Ending::Failed(format!("it depends on the job {id}, which is not in the plan"))),
            Some(State::Ended(Ending::Failed(why))) => {
                Some(Ending::Failed(format!("it depends on the job {id}, which failed: {why}")))
            }
            Some(State::Ended(Ending::NotStarted)) => Some(Ending::NotStarted),
            _ => None,
        };
        let is_open = |i: &usize| matches!(open.states[*i], State::Open);
        let open_jobs = (0..self.jobs.len()).filter(is_open);
        let failed = |i: usize| Some((i, self.jobs[i].needs.iter().find_map(ending)?));
        open_jobs.filter_map(failed).collect()
    }

    /// Handles that the disk of job `i` is full: ends the open jobs that write to this disk as
    /// [`Ending::NotStarted`].
    fn fill(&self, i: usize) {
        let full = disk(&self.jobs[i]);
        let mut left = 0;
        let mut open = self.lock();
        for (state, job) in open.states.iter_mut().zip(self.jobs) {
            if matches!(state, State::Open) && disk(job) == full {
                *state = State::Ended(Ending::NotStarted);
                left += 1;
            }
        }
        drop(open);
        if left > 0 {
            (self.watch)(Event::Fills(&self.jobs[i]));
        }
        self.changed.notify_all();
    }

    /// Makes the resources of a computed job available to other jobs.
    fn give_back(&self, share: &Share) {
        let mut open = self.lock();
        open.free += share.taken;
        open.going -= 1;
        self.changed.notify_all();
    }

    fn end(&self, i: usize, ending: Ending) {
        self.tell(i, &ending);
        self.lock().states[i] = State::Ended(ending);
        self.changed.notify_all();
    }

    /// Reports the outcome of job `i`. This may write a file and print, so the board must not be locked.
    fn tell(&self, i: usize, ending: &Ending) {
        if let Ending::Failed(error) = ending {
            job::remember_failure(&self.jobs[i], error);
        }
        (self.watch)(Event::Ends(&self.jobs[i], ending));
    }

    fn endings(self) -> Vec<Ending> {
        let open = self.open.into_inner().unwrap_or_else(PoisonError::into_inner);
        let ending = |state| match state {
            State::Ended(ending) => ending,
            State::Open | State::Going => Ending::NotStarted,
        };
        open.states.into_iter().map(ending).collect()
    }
}

/// Returns the bytes that all running jobs together may use for pixels.
fn capacity(limits: &Limits) -> u64 {
    limits.memory.as_ref().map_or(u64::MAX, MemoryLimit::for_pixels)
}

/// Returns the bytes that `job` needs if all its pixels stay in memory, without the memory of the program itself.
fn pixels(job: &Job) -> u64 {
    (job.memory_mb * 1_000_000).saturating_sub(MemoryLimit::PROGRAM)
}

#[cfg(test)]
mod tests;
