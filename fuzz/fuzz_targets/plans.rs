//! Files of transforms, plans, reports that a batch reads, and name templates.
//!
//! In: the kind of file in the first byte, and the file. Checked: a file that is read and written again is the same;
//! accepted homographies give finite radiance or an error for a small bracket; the brackets of a job have its inputs;
//! names are inside their folder.
#![no_main]

use hdralign::align::preset::Preset;
use hdralign::align::transforms_file::SavedAlignment;
use hdralign::align::{AlignMode, AlignOptions};
use hdralign::batch::name::{Template, Values, plain};
use hdralign::batch::plan::Job;
use hdralign::batch::record::Record;
use hdralign::batch::job::{Brief, Failure};
use hdralign::batch::summary::Summary;
use hdralign::bracket::LoadOptions;
use hdralign::pipeline::{self, Crop, Options};
use hdralign::response::ResponseModel;
use hdralign_fuzz::{check_error, folder, held, put, set_up};
use libfuzzer_sys::fuzz_target;
use std::path::{Component, Path, PathBuf};
use std::sync::OnceLock;

fuzz_target!(init: set_up(), |data: &[u8]| held(|| plans(data)));

fn plans(data: &[u8]) {
    let Some((&kind, content)) = data.split_first() else { return };
    match kind % 4 {
        0 => transforms(content),
        1 => plan(content),
        2 => report(content),
        _ => template(content),
    }
}

fn transforms(content: &[u8]) {
    let path = put("t.json", content);
    let saved = match SavedAlignment::read(&path) {
        Ok(saved) => saved,
        Err(e) => return check_error(&e, "t.json"),
    };
    let again = SavedAlignment::from_json(&saved.to_json(), &path).unwrap_or_else(|e| panic!("what was saved: {e}"));
    assert_eq!(again, saved);
    // The saved transforms are applied to a bracket of three frames, whatever photographs they were saved for.
    let frames = bracket();
    let places = saved.frames.into_iter().zip([&frames[0], &frames[2]]);
    let given = places.map(|(given, path)| Preset { path: path.clone(), ..given }).collect();
    let options = Options {
        load: LoadOptions {
            ev: Some(vec![-1.0, 0.0, 1.0]),
            reference: hdralign::bracket::ReferenceChoice::Number(2),
            ..LoadOptions::default()
        },
        align: AlignOptions { mode: AlignMode::None, given, ..AlignOptions::default() },
        response: ResponseModel::Srgb,
        crop: if content.len() % 2 == 0 { Crop::None } else { Crop::Common },
        ..Options::default()
    };
    match pipeline::develop(frames, &options, &pipeline::unwatched) {
        Ok(outcome) => {
            let values = outcome.radiance.pixels.as_slice().as_flattened();
            assert!(!values.is_empty() && values.iter().all(|v| v.is_finite() && *v > 0.0));
        }
        Err(e) => check_error(&e, "hdralign-fuzz-"),
    }
}

/// Returns the paths of three photographs of 16 x 12 pixels.
fn bracket() -> &'static [PathBuf] {
    static FRAMES: OnceLock<Vec<PathBuf>> = OnceLock::new();
    FRAMES.get_or_init(|| {
        let frame = |i: u32| {
            let code = |x: u32, y: u32, c: u32| ((x * 13 + y * 29 + c * 50) % 120 * (i + 1) / 2) as u8;
            let picture = image::RgbImage::from_fn(16, 12, |x, y| image::Rgb([0, 1, 2].map(|c| code(x, y, c))));
            let path = folder().join(format!("frame-{i}.png"));
            picture.save(&path).expect("room for a small file");
            path
        };
        (0..3).map(frame).collect()
    })
}

fn plan(content: &[u8]) {
    let path = put("plan.jsonl", content);
    let mut jobs = match Job::read_all(&path) {
        Ok(jobs) => jobs,
        Err(e) => return check_error(&e, "plan.jsonl"),
    };
    let lines: Vec<String> = jobs.iter().map(|job| job.to_line().expect("UTF-8 as it was read")).collect();
    let again = Job::read_all(&put("again.jsonl", (lines.join("\n") + "\n").as_bytes()));
    assert_eq!(again.unwrap_or_else(|e| panic!("what was written: {e}")), jobs);
    for job in &mut jobs {
        assert_eq!(job.by_bracket().concat(), job.inputs);
        if let Err(e) = Job::read(&path, std::slice::from_ref(&job.id)) {
            check_error(&e, "plan.jsonl");
        }
        // No file outside of this process's folder may be read.
        let named = |path: &Path| folder().join(plain(&path.to_string_lossy()));
        (job.report, job.failure) = (path.clone(), named(&job.failure));
        job.outputs.iter_mut().for_each(|path| *path = named(path));
        job.page = None;
    }
    let summary = Summary::collected(&jobs);
    assert!(serde_json::from_str::<serde_json::Value>(&summary.to_json()).is_ok());
    assert_eq!(summary.jobs.len(), jobs.len());
    let _ = (summary.to_csv(), summary.outcome());
}

fn report(content: &[u8]) {
    let path = put("r.json", content);
    if let Some(brief) = Brief::read(&path) {
        assert!(brief.time_s.is_none_or(f64::is_finite) && brief.least_confidence.is_none_or(f64::is_finite));
    }
    if let Some(record) = Record::read(&path) {
        let there = [path.clone(), folder().join("none.exr")];
        assert!(!record.is_whole(&there), "one of them is not there");
        let _ = (record.is_whole(&[]), record.is_of(&record.inputs), record.made(&path).expect("it is there"));
    }
    let job = serde_json::from_str::<Job>(STEP).map(|job| Job { failure: path, ..job });
    let _ = Failure::read(&job.expect("a job"));
}

const STEP: &str = r#"{"schema":"hdralign-plan/1","software":"x","kind":"merge","id":"a","needs":[],"inputs":[],"brackets":[],
    "set":null,"outputs":[],"page":null,"report":"r","failure":"f","response":null,"unit_exposure_s":null,"options":[],
    "width_px":1,"height_px":1,"threads":1,"memory_mb":1,"time_s":1,"summary":"s"}"#;

fn template(content: &[u8]) {
    let text = String::from_utf8_lossy(content);
    let (template, rest) = text.split_once('\n').unwrap_or((&text, ""));
    let template = match Template::parse(template) {
        Ok(template) => template,
        Err(e) => return check_error(&e, "--name"),
    };
    let mut words = rest.split('\n');
    let mut word = || words.next().unwrap_or_default().to_owned();
    let values = Values {
        folder: word().into(),
        first: word().into(),
        last: word().into(),
        camera: Some(word()),
        date_time: Some(word()),
        number: 1,
        count: rest.len(),
        set: 1,
    };
    let path = template.path(&values);
    assert!(path.components().all(|part| matches!(part, Component::Normal(_))), "{path:?}");
}
