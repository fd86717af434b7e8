//! Time of the whole pipeline relative to its codecs: `cargo bench --bench codecs`.
//!
//! It alternates between the pipeline from three frames of 15 MP to `.exr` and `.png`, and only decoding the same frames
//! and encoding the same results with the library's readers and writers, on one and on two threads. It prints the medians
//! of the wall time and their ratio.
//!
//! The frames are those of `testdata/window`, enlarged. They are not tiled with mirror images, because mirrored tiles
//! move against each other, unlike the frames of a hand-held camera, and take many times as long to align. Enlarged
//! frames are smoother than photographs, which makes the codecs faster. To use other photographs, list them in
//! HDRALIGN_BENCH_IMAGES, separated by spaces.

use hdralign::bracket::{LoadOptions, load};
use hdralign::pipeline::{self, Options, Outcome};
use hdralign::write::{self, Metadata};
use image::codecs::jpeg::JpegEncoder;
use image::imageops;
use img_parts::jpeg::Jpeg;
use img_parts::{Bytes, ImageEXIF};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Number of measured rounds, after one to warm up.
const ROUNDS: usize = 7;
/// Numbers of threads that are measured.
const THREADS: [usize; 2] = [1, 2];

/// Returns frame `i` of `testdata/window` at four times its width and height, as a JPEG with its EXIF data.
fn enlarged(i: usize) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("testdata/window/window_{i}.jpg"));
    let small = image::open(&path).expect("a frame of testdata/window").to_rgb8();
    let whole = imageops::resize(&small, 4 * small.width(), 4 * small.height(), imageops::FilterType::Triangle);
    let mut plain = Vec::new();
    JpegEncoder::new_with_quality(&mut plain, 92).encode_image(&whole).expect("a JPEG");
    let exif = Jpeg::from_bytes(std::fs::read(&path).expect("the frame").into()).expect("a JPEG").exif();
    let mut file = Jpeg::from_bytes(Bytes::from(plain)).expect("a JPEG");
    file.set_exif(exif);
    file.encoder().bytes().to_vec()
}

/// Returns the photographs of HDRALIGN_BENCH_IMAGES, or enlarged frames written to `folder`.
fn photographs(folder: &Path) -> Vec<PathBuf> {
    if let Ok(names) = std::env::var("HDRALIGN_BENCH_IMAGES") {
        return names.split_whitespace().map(PathBuf::from).collect();
    }
    let make = |i: usize| {
        let path = folder.join(format!("w{i}.jpg"));
        std::fs::write(&path, enlarged(i)).expect("space in the temporary folder");
        path
    };
    (2..=4).map(make).collect()
}

/// Decodes `images` and encodes the results in `outcome` to the same files.
fn codecs(images: &[PathBuf], options: &Options, outcome: &Outcome) {
    let (bracket, _) = load(images, &LoadOptions::default()).expect("photographs that were merged");
    let metadata = Metadata::of(bracket.reference());
    let written = write::write(&options.outputs, &outcome.radiance, &outcome.display, &metadata, &options.write);
    let files = written.expect("space in the temporary folder").into_iter().map(|w| w.file).collect();
    write::commit(files, true).expect("names that can be replaced");
}

/// Returns the seconds that `work` takes.
fn seconds<R>(work: impl FnOnce() -> R) -> f64 {
    let began = Instant::now();
    work();
    began.elapsed().as_secs_f64()
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn main() {
    // Like criterion: a name on the command line selects benches, and `cargo test --benches` only checks that they
    // run.
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if arguments.iter().any(|a| !a.starts_with('-') && !"codecs".contains(a.as_str())) {
        return;
    }
    let rounds = if arguments.iter().any(|a| a == "--test") { 0 } else { ROUNDS };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let images = photographs(folder.path());
    let options = |threads| Options {
        outputs: vec![folder.path().join("a.exr"), folder.path().join("a.png")],
        write: write::Options { overwrite: true, ..write::Options::default() },
        threads: Some(threads),
        ..Options::default()
    };
    let run = |threads| pipeline::run(&images, &options(threads), &pipeline::unwatched).expect("a bracket that merges");
    for threads in THREADS {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        let outcome =
            pipeline::develop(&images, &options(threads), &pipeline::unwatched).expect("a bracket that merges");
        let (mut whole, mut alone) = (Vec::new(), Vec::new());
        for round in 0..=rounds {
            let times =
                (seconds(|| run(threads)), seconds(|| pool.install(|| codecs(&images, &options(threads), &outcome))));
            if round > 0 || rounds == 0 {
                whole.push(times.0);
                alone.push(times.1);
            }
        }
        let (whole, alone) = (median(whole), median(alone));
        let (width, height) = (outcome.report.width_px, outcome.report.height_px);
        println!(
            "codecs/{} frames of {width} x {height}, {threads} thread(s): pipeline {whole:.3} s, codecs alone {alone:.3} s, ratio {:.2}",
            images.len(),
            whole / alone
        );
    }
}
