use super::super::plan::tests::job;
use super::super::plan::{Job, Kind};
use super::*;
use crate::error::Error;
use std::path::Path;
use std::sync::atomic::AtomicUsize;

/// Returns jobs with the given ids, each with the ids of the jobs that it needs. All of them fail, because their
/// photographs do not exist.
fn jobs(ids: &[(&str, &[&str])], folder: &Path) -> Vec<Job> {
    let named = |(id, needs): &(&str, &[&str])| Job {
        id: (*id).into(),
        needs: needs.iter().map(|n| (*n).into()).collect(),
        report: folder.join(format!("{id}.json")),
        failure: folder.join(format!("{id}.failed.json")),
        ..job()
    };
    ids.iter().map(named).collect()
}

fn limits(jobs: usize, bytes: Option<u64>) -> Limits {
    let memory = bytes.map(|bytes| MemoryLimit { bytes, folder: std::env::temp_dir() });
    Limits { jobs, threads: jobs, memory }
}

#[test]
fn failed_job_stops_only_jobs_that_need_it() {
    let dir = tempfile::tempdir().unwrap();
    let all = jobs(&[("b", &["a"]), ("a", &[]), ("c", &[]), ("d", &["none"])], dir.path());
    for jobs in [1, 3] {
        let stop = AtomicBool::new(false);
        let ended = AtomicUsize::new(0);
        let count = |event: Event| {
            if let Event::Ends(..) = event {
                ended.fetch_add(1, Ordering::SeqCst);
            }
        };
        let endings = run(&all, &Options::default(), &limits(jobs, Some(1 << 27)), false, &stop, &count);
        let failed = |i: usize| match &endings[i] {
            Ending::Failed(error) => error.clone(),
            other => panic!("{other:?}"),
        };
        assert!(
            failed(0).contains("depends on the job a, which failed") && failed(1).contains("IMG_1.JPG"),
            "{endings:?}"
        );
        assert!(failed(2).contains("cannot be read") && failed(3).contains("not in the plan"), "{endings:?}");
        assert_eq!(ended.load(Ordering::SeqCst), 4);
        assert!(all.iter().all(|s| job::Failure::read(s).is_some_and(|f| f.id == s.id)));
    }
}

#[test]
fn full_disk_stops_further_jobs_and_is_reported_once() {
    let dir = tempfile::tempdir().unwrap();
    let jobs = jobs(&[("a", &[]), ("b", &[]), ("c", &["b"])], dir.path());
    let (stop, limits) = (AtomicBool::new(false), limits(2, None));
    let (reports, ended) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let watch = |event: Event| match event {
        Event::Fills(job) => assert_eq!((job.id.as_str(), reports.fetch_add(1, Ordering::SeqCst)), ("a", 0)),
        Event::Ends(..) => assert_eq!(ended.fetch_add(1, Ordering::SeqCst), 0),
        Event::Begins(_) => {}
    };
    let full = || std::io::Error::from(std::io::ErrorKind::StorageFull);
    let write = || Error::Write { path: "a.exr".into(), source: full() };
    // A full scratch disk does not stop other jobs, because smaller jobs may have enough space.
    let scratch = || Error::Scratch { folder: "s".into(), source: full() };
    assert!(write().is_disk_full() && !scratch().is_disk_full());
    let board = Board::new(&jobs, &limits, &stop, &watch);
    assert_eq!(board.take(|| ()).unwrap().0, 0);
    let outcome = guarded(|| Err::<(), _>(write()), || board.fill(0));
    board.end(0, Ending::Failed(outcome.unwrap_err()));
    board.fill(0);
    assert!(board.take(|| ()).is_none());
    assert!(matches!(&board.endings()[..], [Ending::Failed(_), Ending::NotStarted, Ending::NotStarted]));
    assert_eq!((reports.into_inner(), ended.into_inner()), (1, 1));
}

/// Job b needs job a, which was not started because its disk is full. `take` does not wait for a, but ends b.
#[test]
fn jobs_that_need_an_unstarted_job_are_not_started() {
    let jobs = jobs(&[("a", &[]), ("b", &["a"])], Path::new("/none"));
    let (stop, limits) = (AtomicBool::new(false), limits(1, None));
    let watch = |_: Event| ();
    let board = Board::new(&jobs, &limits, &stop, &watch);
    board.lock().states[0] = State::Ended(Ending::NotStarted);
    assert!(board.take(|| ()).is_none());
    assert_eq!(board.endings(), [Ending::NotStarted, Ending::NotStarted]);
}

#[test]
fn stopped_batch_starts_no_job() {
    let dir = tempfile::tempdir().unwrap();
    let jobs = jobs(&[("a", &[]), ("b", &[])], dir.path());
    let stop = AtomicBool::new(true);
    let endings = run(&jobs, &Options::default(), &limits(2, None), false, &stop, &|_| ());
    assert_eq!(endings, [Ending::NotStarted, Ending::NotStarted]);
    assert!(std::fs::read_dir(dir.path()).unwrap().next().is_none());
}

/// The running jobs together never get more memory than the limit, and at least one job always gets enough memory to
/// run.
#[test]
fn memory_and_threads_are_shared_out() {
    let mut all = jobs(&[("a", &[]), ("b", &[]), ("c", &[])], Path::new("/none"));
    all.iter_mut().for_each(|job| job.memory_mb = 400);
    let stop = AtomicBool::new(false);
    let of_job = 400_000_000 - MemoryLimit::PROGRAM;
    let watch = |_: Event| ();

    let two = limits(2, Some(MemoryLimit::PROGRAM + 2 * of_job));
    let board = Board::new(&all, &two, &stop, &watch);
    let (first, second) = (board.take(|| ()).unwrap(), board.take(|| ()).unwrap());
    assert_eq!((first.0, second.0), (0, 1));
    assert_eq!(first.1, Share { threads: 1, taken: of_job });
    assert_eq!(board.lock().free, 0);
    board.give_back(&first.1);
    assert_eq!(board.take(|| ()).unwrap().0, 2);

    assert_eq!(workers(&all, &two), 2);

    // Memory is enough for only one job at a time, so this job gets both threads.
    let one = limits(2, Some(MemoryLimit::PROGRAM + of_job + 1));
    assert_eq!(workers(&all, &one), 1);
    let board = Board::new(&all, &one, &stop, &watch);
    let share = board.take(|| ()).unwrap().1;
    assert_eq!(share, Share { threads: 2, taken: of_job + 1 });

    // The pixels need 10 bytes, and a second thread needs 32. So 42 free bytes are enough for two threads, but 41
    // only for one thread, which needs no memory in addition to the 10 bytes.
    let one_thread = |pixels| Share { threads: 1, taken: pixels };
    assert_eq!(Share::of(10, 32, 42, 2), Share { threads: 2, taken: 42 });
    assert_eq!(Share::of(10, 32, 41, 2), one_thread(10));
    assert_eq!(Share::of(10, 32, 10, 1), one_thread(10));

    // A job that needs more memory than the limit gets all memory, so no other job runs at the same time.
    let little = limits(4, Some(MemoryLimit::PROGRAM + 1000));
    let board = Board::new(&all[..1], &little, &stop, &watch);
    let (_, share) = board.take(|| ()).unwrap();
    assert_eq!(share, one_thread(1000));
    let own = share.options(&Options {
        load: crate::bracket::LoadOptions { memory: little.memory.clone(), ..Default::default() },
        ..Options::default()
    });
    assert_eq!((own.threads, own.load.memory.map(|m| m.bytes)), (Some(1), Some(MemoryLimit::PROGRAM + 1000)));
}

#[test]
fn the_longest_comes_first_if_there_is_room_for_it() {
    let mut all = jobs(&[("a", &[]), ("b", &[]), ("c", &[]), ("d", &[])], Path::new("/none"));
    for (job, (time_s, memory_mb)) in all.iter_mut().zip([(1.0, 100), (3.0, 200), (2.0, 100), (2.0, 100)]) {
        (job.time_s, job.memory_mb) = (time_s, memory_mb);
    }
    let stop = AtomicBool::new(false);
    let watch = |_: Event| ();
    let roomy = limits(2, None);
    let board = Board::new(&all, &roomy, &stop, &watch);
    assert_eq!([board.take(|| ()).unwrap().0, board.take(|| ()).unwrap().0], [1, 2]);
    all[0].memory_mb = 150;
    let tight = limits(3, Some(MemoryLimit::PROGRAM + 260_000_000));
    let board = Board::new(&all, &tight, &stop, &watch);
    // 25 MB of `memory_mb` are for the program and not for pixels. So b takes 175 MB of the 260 MB for pixels. The
    // other 85 MB are not enough for a (125 MB), but they are enough for c (75 MB).
    assert_eq!([board.take(|| ()).unwrap().0, board.take(|| ()).unwrap().0], [1, 2]);
}

#[test]
fn response_job_precedes_the_jobs_that_need_it() {
    let dir = tempfile::tempdir().unwrap();
    let mut all = jobs(&[("merge", &["response"]), ("response", &[])], dir.path());
    all[1].kind = Kind::Response;
    let stop = AtomicBool::new(false);
    let limits = limits(2, None);
    let watch = |_: Event| ();
    let board = Board::new(&all, &limits, &stop, &watch);
    let (first, share) = board.take(|| ()).unwrap();
    assert_eq!(first, 1);
    board.end(1, Ending::Done(Brief::default()));
    board.give_back(&share);
    assert_eq!(board.take(|| ()).unwrap().0, 0);
    board.end(0, Ending::Unchanged(Brief::default()));
    assert_eq!(board.take(|| ()).map(|(i, _)| i), None);
}
