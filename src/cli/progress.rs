//! The progress bar on stderr. It is shown only if stderr is a terminal.
//!
//! In: the photographs, and the stages as they start. Out: a bar, the name of the stage, and the time left. Stages
//! report only when they start, except that loading also reports the number of decoded frames. So the time of each
//! stage is estimated from the number and size of the photographs and from the speed of earlier stages. A thread
//! moves the bar five times a second. The bar never moves back.

use super::terminal::Terminal;
use hdralign::bracket::header::Header;
use hdralign::limits::Limits;
use hdralign::pipeline::{Progress, Stage};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Number of steps of the bar.
const STEPS: u64 = 1000;
/// Interval between two updates of the bar.
const TICK: Duration = Duration::from_millis(200);
/// Assumed size of a photograph whose header cannot be read, in megapixels.
const USUAL_MEGAPIXELS: f64 = 12.0;

/// A stage, and its estimated time in seconds on a machine with two cores.
type Planned = (Stage, f64);

/// The stages of a command and their estimated times.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    frames: usize,
    stages: Vec<Planned>,
}

impl Plan {
    /// Returns the plan of `merge`, with or without deghosting.
    pub fn merge(images: &[PathBuf], seeks_ghosts: bool) -> Plan {
        let (frames, megapixels) = size(images);
        let all = frames * megapixels;
        let plan = Plan::align(images);
        let merging = if seeks_ghosts { 0.045 } else { 0.035 };
        let more = [
            (Stage::Response, 0.07),
            (Stage::Merge, merging * all),
            (Stage::Tonemap, 0.03 * megapixels),
            (Stage::Write, 0.05 + 0.04 * megapixels),
        ];
        Plan { stages: plan.stages.into_iter().chain(more).collect(), ..plan }
    }

    /// Returns the plan of `align`.
    pub fn align(images: &[PathBuf]) -> Plan {
        let (frames, megapixels) = size(images);
        let all = frames * megapixels;
        let stages = vec![(Stage::Load, 0.01 * all), (Stage::Align, 0.08 * frames + 0.012 * all)];
        Plan { frames: images.len(), stages }
    }

    /// Returns the plan of `inspect`.
    pub fn inspect(images: &[PathBuf]) -> Plan {
        let mut plan = Plan::align(images);
        plan.stages.push((Stage::Inspect, 0.8 * images.len() as f64));
        plan
    }

    /// Returns the plan of `tonemap`. The size of the picture is estimated from the size of the file, at four bytes
    /// per pixel.
    pub fn tonemap(input: &Path) -> Plan {
        let bytes = std::fs::metadata(input).map_or(4e6 * USUAL_MEGAPIXELS, |m| m.len() as f64);
        let megapixels = bytes / 4e6;
        let stages = [(Stage::Load, 0.03), (Stage::Tonemap, 0.03), (Stage::Write, 0.04)];
        Plan { frames: 0, stages: stages.map(|(stage, each)| (stage, each * megapixels)).to_vec() }
    }

    /// Returns an empty plan, for which no time left is shown. `response` uses it, because the number of brackets is
    /// not known.
    pub fn unknown() -> Plan {
        Plan { frames: 0, stages: Vec::new() }
    }
}

/// Returns the number of photographs, and their size in megapixels from the header of the first photograph.
fn size(images: &[PathBuf]) -> (f64, f64) {
    // This reader of headers decompresses no pixels, and it does not read from pipes.
    let header = images.first().and_then(|path| Header::read(path, &Limits::default()).ok());
    let megapixels = header.map_or(USUAL_MEGAPIXELS, |header| header.width as f64 * header.height as f64 / 1e6);
    (images.len() as f64, megapixels)
}

/// The estimated progress of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Estimate {
    /// Estimated fraction of the run that is done, from 0 to 1.
    done: f64,
    /// Time left in seconds; `None` until the speed of the machine is known.
    left_s: Option<f64>,
}

/// Computes the progress of a run from the elapsed time.
#[derive(Debug, Clone)]
struct Course {
    plan: Plan,
    /// The current stage, and its index in the plan.
    stage: Option<(Stage, Option<usize>)>,
    /// Measured time of the earlier stages, in seconds.
    spent: f64,
    /// Estimated time of the same earlier stages, in seconds.
    planned: f64,
    /// Start time of the current stage, in seconds after the start of the run.
    began: f64,
    decoded: usize,
    /// The largest fraction of the run that was shown as done so far. The bar never moves below it.
    shown: f64,
}

impl Course {
    fn new(plan: Plan) -> Course {
        Course { plan, stage: None, spent: 0.0, planned: 0.0, began: 0.0, decoded: 0, shown: 0.0 }
    }

    /// Records that `stage` starts, `now` seconds after the start of the run.
    fn begins(&mut self, stage: Stage, now: f64) {
        if self.stage.is_some_and(|(current, _)| current == stage) {
            return;
        }
        let place = self.plan.stages.iter().position(|(planned, _)| *planned == stage);
        let first = self.stage.and_then(|(_, place)| place).unwrap_or(0);
        // The stage that ends now contributes to the speed. If there are planned stages between it and the new stage,
        // they were skipped and do not contribute.
        if place.is_some_and(|place| place > first) {
            self.spent += now - self.began;
            self.planned += self.plan.stages[first].1;
        }
        (self.stage, self.began) = (Some((stage, place)), now);
    }

    /// Returns the measured time divided by the estimated time; `None` before the first measurement. `in_stage` is
    /// the time since the start of the current stage, in seconds.
    fn speed(&self, in_stage: f64) -> Option<f64> {
        let loads = matches!(self.stage, Some((Stage::Load, _)));
        if loads && self.decoded > 0 && self.plan.frames > 0 {
            let share = self.decoded as f64 / self.plan.frames as f64;
            return Some(in_stage / (share * self.plan.stages[0].1));
        }
        (self.planned > 0.0).then(|| self.spent / self.planned)
    }

    /// Returns the progress `now` seconds after the start of the run.
    fn estimate(&mut self, now: f64) -> Estimate {
        let Some((_, Some(place))) = self.stage else { return Estimate { done: self.shown, left_s: None } };
        let in_stage = now - self.began;
        let Some(speed) = self.speed(in_stage) else { return Estimate { done: self.shown, left_s: None } };
        let speed = speed.clamp(0.02, 50.0);
        let expected = speed * self.plan.stages[place].1;
        // If a stage takes longer than estimated, it is assumed to need another 15 % of the time that it has taken so
        // far.
        let rest = (expected - in_stage).max(0.15 * in_stage);
        let later: f64 = self.plan.stages[place + 1..].iter().map(|(_, planned)| speed * planned).sum();
        let left = rest + later;
        self.shown = self.shown.max(now / (now + left).max(1e-9)).min(0.99);
        Estimate { done: self.shown, left_s: Some(left) }
    }

    /// Returns the name of the current stage and its number, as shown beside the bar.
    fn words(&self) -> String {
        let Some((stage, place)) = self.stage else { return String::new() };
        let doing = match stage {
            Stage::Load if self.decoded > 0 => {
                format!("reading {}/{}", self.decoded, self.plan.frames.max(self.decoded))
            }
            Stage::Load => "reading".into(),
            Stage::Align => "aligning".into(),
            Stage::Response => "response".into(),
            Stage::Merge => "merging".into(),
            Stage::Tonemap => "tone mapping".into(),
            Stage::Inspect => "drawing".into(),
            Stage::Write => "writing".into(),
        };
        match place {
            Some(place) => format!("{}/{} {doing}", place + 1, self.plan.stages.len()),
            None => doing,
        }
    }
}

/// Returns the time left as text. The longer it is, the more it is rounded.
pub fn left(left_s: Option<f64>) -> String {
    match left_s {
        None => String::new(),
        Some(s) if s < 1.0 => "nearly done".into(),
        Some(s) if s < 10.0 => format!("{s:.0} s left"),
        Some(s) if s < 90.0 => format!("{:.0} s left", (s / 5.0).round() * 5.0),
        Some(s) if s < 5400.0 => format!("{:.0} min left", s / 60.0),
        Some(s) => format!("{:.1} h left", s / 3600.0),
    }
}

/// The state shared by two threads: one does the work of the run, the other moves the bar.
struct Shared {
    course: Mutex<Course>,
    is_over: Mutex<bool>,
    wake: Condvar,
}

/// A progress bar over the stages of a run.
pub struct Bar {
    bar: ProgressBar,
    began: Instant,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

/// Locks `mutex`. A poisoned mutex is used too, because the data are only for drawing.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Bar {
    /// Creates a bar for `plan`. It is not shown if `quiet` is true, or if stderr is not a terminal whose cursor can
    /// be moved.
    pub fn new(plan: Plan, quiet: bool) -> Self {
        let terminal = Terminal::of_stderr();
        let is_shown = terminal.can_redraw && !quiet;
        let target = if is_shown { ProgressDrawTarget::stderr() } else { ProgressDrawTarget::hidden() };
        let bar = ProgressBar::with_draw_target(Some(STEPS), target);
        // The line has at most 79 columns. The parts beside the bar take 42 of them: stage 18, brackets and spaces 4,
        // percentage 5, two spaces, time left 13. In a terminal of at least 52 columns, two or more columns stay free.
        let room = terminal.width.min(79).saturating_sub(44).clamp(8, 35);
        if let Ok(style) =
            ProgressStyle::with_template(&format!("{{msg:18!}} [{{bar:{room}}}] {{percent:>3}} %  {{prefix}}"))
        {
            bar.set_style(style.progress_chars("=> "));
        }
        let course = Mutex::new(Course::new(plan));
        let shared = Arc::new(Shared { course, is_over: Mutex::new(false), wake: Condvar::new() });
        let mut bar = Bar { bar, began: Instant::now(), shared, thread: None };
        if !bar.bar.is_hidden() {
            bar.thread = bar.ticker();
        }
        bar
    }

    /// Starts the thread that moves the bar. If the thread cannot be started, the bar moves only when the run reports
    /// progress.
    fn ticker(&self) -> Option<JoinHandle<()>> {
        let (bar, began, shared) = (self.bar.clone(), self.began, Arc::clone(&self.shared));
        let tick = move || {
            let mut is_over = locked(&shared.is_over);
            while !*is_over {
                draw(&bar, &mut locked(&shared.course), began);
                is_over = shared.wake.wait_timeout(is_over, TICK).unwrap_or_else(PoisonError::into_inner).0;
            }
        };
        std::thread::Builder::new().name("hdralign bar".into()).spawn(tick).ok()
    }

    /// Shows `progress`. The returned value always tells the run to continue.
    pub fn show(&self, progress: Progress) -> ControlFlow<()> {
        let mut course = locked(&self.shared.course);
        match progress {
            Progress::Begins(stage) => course.begins(stage, self.began.elapsed().as_secs_f64()),
            Progress::Decoded(frames) => course.decoded = course.decoded.max(frames),
        }
        draw(&self.bar, &mut course, self.began);
        ControlFlow::Continue(())
    }

    /// Removes the bar from the screen.
    pub fn clear(&mut self) {
        *locked(&self.shared.is_over) = true;
        self.shared.wake.notify_all();
        if let Some(thread) = self.thread.take() {
            // The thread only draws, so a panic in it is ignored.
            let _ = thread.join();
        }
        self.bar.finish_and_clear();
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.clear();
    }
}

fn draw(bar: &ProgressBar, course: &mut Course, began: Instant) {
    let estimate = course.estimate(began.elapsed().as_secs_f64());
    bar.set_message(course.words());
    bar.set_prefix(left(estimate.left_s));
    bar.set_position((estimate.done * STEPS as f64) as u64);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan() -> Plan {
        let stages = vec![(Stage::Load, 1.0), (Stage::Align, 2.0), (Stage::Merge, 4.0), (Stage::Write, 1.0)];
        Plan { frames: 4, stages }
    }

    #[test]
    fn a_machine_half_as_fast_is_known_as_soon_as_the_first_photograph_is_read() {
        let mut course = Course::new(plan());
        course.begins(Stage::Load, 0.0);
        assert_eq!(course.estimate(0.2), Estimate { done: 0.0, left_s: None });
        course.decoded = 1;
        // One of four frames is decoded. This is a quarter of the load stage, which is planned as 1 s, and it took
        // 0.5 s instead of 0.25 s. So the whole plan of 8 s will take 16 s, and 15.5 s are left.
        let estimate = course.estimate(0.5);
        assert!((estimate.left_s.unwrap() - 15.5).abs() < 1e-9 && (estimate.done - 0.5 / 16.0).abs() < 1e-9);
        course.begins(Stage::Align, 2.0);
        course.begins(Stage::Merge, 6.0);
        let estimate = course.estimate(10.0);
        assert!((estimate.left_s.unwrap() - 6.0).abs() < 1e-9 && (estimate.done - 10.0 / 16.0).abs() < 1e-9);
        assert_eq!((course.words().as_str(), left(estimate.left_s).as_str()), ("3/4 merging", "6 s left"));
    }

    #[test]
    fn progress_of_a_slow_stage_neither_ends_nor_goes_back() {
        let mut course = Course::new(plan());
        course.begins(Stage::Load, 0.0);
        course.begins(Stage::Align, 1.0);
        let mut last = 0.0;
        for i in 0..200 {
            let estimate = course.estimate(1.0 + f64::from(i));
            assert!(estimate.done >= last && estimate.done < 1.0 && estimate.left_s.unwrap() > 5.0);
            last = estimate.done;
        }
        // Load and align took 201 s instead of the planned 3 s. So merge and write, which are planned as 5 s, will
        // take over 200 s.
        course.begins(Stage::Merge, 201.0);
        assert!(course.estimate(201.0).left_s.unwrap() > 200.0);
        assert!(course.estimate(201.0).done >= last);
    }

    #[test]
    fn stages_may_be_left_out_or_unknown() {
        let mut course = Course::new(plan());
        course.begins(Stage::Load, 0.0);
        course.begins(Stage::Write, 1.0);
        course.begins(Stage::Write, 1.5);
        assert!((course.estimate(1.5).left_s.unwrap() - 0.5).abs() < 1e-9);
        course.begins(Stage::Tonemap, 2.0);
        assert_eq!((course.estimate(2.0).left_s, course.words().as_str()), (None, "tone mapping"));
        let mut course = Course::new(Plan::unknown());
        for stage in [Stage::Load, Stage::Align, Stage::Load, Stage::Response] {
            course.begins(stage, 1.0);
            assert_eq!(course.estimate(2.0), Estimate { done: 0.0, left_s: None });
        }
    }

    #[test]
    fn time_left_is_rounded_to_its_uncertainty() {
        let words = |s| left(Some(s));
        assert_eq!([0.3, 4.4, 33.0, 200.0].map(words), ["nearly done", "4 s left", "35 s left", "3 min left"]);
        assert_eq!((words(9000.0).as_str(), left(None).as_str()), ("2.5 h left", ""));
    }
}
