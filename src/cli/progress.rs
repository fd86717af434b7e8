//! The progress bar: on a terminal only, and on stderr.

use hdralign::pipeline::{Progress, Stage};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// A bar over the frames to decode and the stages that follow.
pub struct Bar {
    bar: ProgressBar,
    frames: u64,
}

/// Stages after loading.
const STAGES: u64 = 5;

impl Bar {
    /// A bar for `frames` frames; nothing is shown when `quiet`, or when stderr is no terminal.
    pub fn new(frames: usize, quiet: bool) -> Self {
        let frames = frames as u64;
        let target = if quiet { ProgressDrawTarget::hidden() } else { ProgressDrawTarget::stderr() };
        let bar = ProgressBar::with_draw_target(Some(frames + STAGES), target);
        if let Ok(style) = ProgressStyle::with_template("{msg:12} [{bar:30}] {elapsed}") {
            bar.set_style(style.progress_chars("=> "));
        }
        Bar { bar, frames }
    }

    /// Shows how far the work is.
    pub fn show(&self, progress: Progress) {
        let (words, done) = match progress {
            Progress::Begins(Stage::Load) => ("reading", 0),
            Progress::Decoded(_) => {
                self.bar.inc(1);
                return;
            }
            Progress::Begins(Stage::Align) => ("aligning", 0),
            Progress::Begins(Stage::Response) => ("response", 1),
            Progress::Begins(Stage::Merge) => ("merging", 2),
            Progress::Begins(Stage::Tonemap) => ("tone mapping", 3),
            Progress::Begins(Stage::Inspect) => ("drawing", 1),
            Progress::Begins(Stage::Write) => ("writing", 4),
        };
        self.bar.set_message(words);
        if words != "reading" {
            self.bar.set_position(self.frames + done);
        }
    }

    /// Takes the bar off the screen.
    pub fn clear(&self) {
        self.bar.finish_and_clear();
    }
}
