//! Progress: the stages that a run reports to its caller, who may cancel it.

use crate::support::{Folder, jpeg};
use hdralign::align::{AlignMode, AlignOptions};
use hdralign::error::Error;
use hdralign::pipeline::{self, Options, Progress, Stage};
use hdralign::response::ResponseModel;
use image::{Rgb, RgbImage};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::Mutex;

/// The stages of a run that merges frames and writes a report page.
const STAGES: [Stage; 7] =
    [Stage::Load, Stage::Align, Stage::Response, Stage::Merge, Stage::Tonemap, Stage::Inspect, Stage::Write];

/// Returns a folder with a bracket of three frames, the frames, and options for output files of every kind.
fn bracket() -> (Folder, Vec<PathBuf>, Options) {
    let folder = Folder::empty();
    for i in 1..=3 {
        let picture = RgbImage::from_fn(160, 120, |x, y| Rgb([((x + 3 * (y / 8)) as usize * i / 2).min(255) as u8; 3]));
        folder.put(&format!("p{i}.jpg"), &jpeg(&picture, Some(i)));
    }
    let images = (1..=3).map(|i| folder.at(format!("p{i}.jpg"))).collect();
    let options = Options {
        align: AlignOptions { mode: AlignMode::None, ..AlignOptions::default() },
        response: ResponseModel::Srgb,
        outputs: ["a.exr", "a.png"].map(|name| folder.at(name)).to_vec(),
        save_response: Some(folder.at("curve.json")),
        save_aligned: Some(folder.at("aligned-")),
        transforms: Some(folder.at("transforms.json")),
        report: Some(folder.at("report.html")),
        ..Options::default()
    };
    (folder, images, options)
}

#[test]
fn stages_of_a_run_are_announced_once_and_in_order() {
    let (_folder, images, options) = bracket();
    let stages = Mutex::new(Vec::new());
    let watch = |progress| {
        if let Progress::Begins(stage) = progress {
            stages.lock().expect("no panic").push(stage);
        }
        ControlFlow::Continue(())
    };
    pipeline::run(&images, &options, &watch).expect("a result");
    assert_eq!(std::mem::take(&mut *stages.lock().expect("no panic")), STAGES);
    let options = Options { write: hdralign::write::Options { overwrite: true, ..Default::default() }, ..options };
    pipeline::align_only(&images, &options, &watch).expect("an alignment");
    assert_eq!(*stages.lock().expect("no panic"), [Stage::Load, Stage::Align, Stage::Inspect, Stage::Write]);
}

#[test]
fn run_on_files_cancelled_before_any_stage_leaves_no_file() {
    let (folder, images, options) = bracket();
    let before = folder.listing();
    for stage in STAGES {
        let watch = |progress| match progress == Progress::Begins(stage) {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        };
        let cancelled = pipeline::run(&images, &options, &watch);
        assert!(matches!(cancelled, Err(Error::Cancelled)), "{stage:?}: {cancelled:?}");
        assert!(folder.listing() == before, "{stage:?}");
    }
}
