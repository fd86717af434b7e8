//! Accuracy of alignment and radiance on `testdata/window`, whose motion and radiance are known.

use hdralign::align::{AlignMode, AlignOptions, Status};
use hdralign::bracket::{LoadOptions, ReferenceChoice};
use hdralign::pipeline::{self, Crop, Options, Outcome};
use serde_json::Value;
use std::fs;
use std::path::PathBuf;
use std::sync::OnceLock;

type Matrix = [[f64; 3]; 3];

const WIDTH: usize = 1200;
const HEIGHT: usize = 800;
/// Pixels of the bracket per pixel of `truth.hdr`, along each side.
const QUARTER: usize = 4;

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("testdata/window").join(name)
}

fn truth() -> Value {
    serde_json::from_slice(&fs::read(file("truth.json")).expect("truth.json")).expect("JSON")
}

/// Returns the true homography of the photograph `name`.
fn true_homography(name: &str) -> Matrix {
    let truth = truth();
    let frames = truth["frames"].as_array().expect("frames");
    let frame =
        frames.iter().find(|f| name.ends_with(f["file"].as_str().expect("a name"))).expect("a frame of the truth");
    std::array::from_fn(|i| std::array::from_fn(|j| frame["homography"][i][j].as_f64().expect("a number")))
}

fn merged(mode: AlignMode) -> Outcome {
    let truth = truth();
    let frames = truth["frames"].as_array().expect("frames");
    let images: Vec<PathBuf> = frames.iter().map(|f| file(f["file"].as_str().expect("a name"))).collect();
    let reference = 1 + frames.iter().position(|f| f["is_reference"] == true).expect("a reference");
    let options = Options {
        load: LoadOptions { reference: ReferenceChoice::Number(reference), ..LoadOptions::default() },
        align: AlignOptions { mode, ..AlignOptions::default() },
        crop: Crop::None,
        ..Options::default()
    };
    pipeline::develop(&images, &options, &pipeline::unwatched).expect("a merge")
}

/// Returns the result with default options, except for the reference, which is that of the truth, and without crop; it
/// is computed once.
fn by_default() -> &'static Outcome {
    static OUTCOME: OnceLock<Outcome> = OnceLock::new();
    OUTCOME.get_or_init(|| merged(AlignMode::Auto))
}

fn apply(m: &Matrix, x: f64, y: f64) -> [f64; 2] {
    let row = |r: &[f64; 3]| r[0] * x + r[1] * y + r[2];
    [row(&m[0]) / row(&m[2]), row(&m[1]) / row(&m[2])]
}

/// The alignment error of a frame, in pixels.
#[derive(Debug)]
struct Misplaced {
    name: String,
    /// Mean error over a grid that includes the borders.
    mean: f64,
    /// Root mean square error over that grid.
    rms: f64,
    /// Error at the corner where it is largest.
    corner: f64,
    /// Error at the centre.
    centre: f64,
    /// The root mean square error that the program reports.
    stated: Option<f64>,
}

/// Returns the alignment errors of all frames except the reference.
fn misplaced(outcome: &Outcome) -> Vec<Misplaced> {
    let mut found = Vec::new();
    for frame in &outcome.report.frames {
        let place = &frame.alignment;
        assert_ne!(place.status, Status::Rejected, "{}: {:?}", frame.path, place.reason);
        if place.status == Status::Reference {
            assert!(frame.path.ends_with("window_3.jpg"));
            continue;
        }
        assert_eq!(place.status, Status::Aligned, "{}", frame.path);
        let nine = place.homography.expect("the place of a frame that is not rejected");
        let ours: Matrix = std::array::from_fn(|i| std::array::from_fn(|j| nine[3 * i + j]));
        let wanted = true_homography(&frame.path);
        let off = |x: f64, y: f64| {
            let ([a, b], [c, d]) = (apply(&ours, x, y), apply(&wanted, x, y));
            (a - c).hypot(b - d)
        };
        let (right, below) = (WIDTH as f64 - 1.0, HEIGHT as f64 - 1.0);
        let grid: Vec<f64> =
            (0..13 * 9).map(|k| off(right * f64::from(k % 13) / 12.0, below * f64::from(k / 13) / 8.0)).collect();
        let corners = [off(0.0, 0.0), off(right, 0.0), off(0.0, below), off(right, below)];
        let count = grid.len() as f64;
        let one = Misplaced {
            name: frame.path.rsplit('/').next().unwrap_or_default().to_owned(),
            mean: grid.iter().sum::<f64>() / count,
            rms: (grid.iter().map(|e| e * e).sum::<f64>() / count).sqrt(),
            corner: corners.into_iter().fold(0.0, f64::max),
            centre: off(right / 2.0, below / 2.0),
            stated: place.error_px,
        };
        println!("{one:.3?}");
        found.push(one);
    }
    assert_eq!(found.len(), 4);
    found
}

/// Measured: mean errors of 0.013 to 0.045 px. The limit of 0.06 px allows for another tuning of the search, but not
/// for a missing refinement: bitmaps alone have mean errors above 1 px here, features alone 0.07 to 0.25 px. At the
/// corners, errors up to 0.17 px were measured; a homography with a wrong centre of rotation would have errors above
/// the limit of 0.25 px there.
#[test]
fn every_frame_is_placed_to_well_under_a_tenth_of_a_pixel() {
    for frame in misplaced(by_default()) {
        assert!(frame.mean < 0.06 && frame.corner < 0.25, "{}: {frame:.3?}", frame.name);
    }
}

/// The reported error of a frame is an estimate, which may be smaller or larger than the true error of the frame. On
/// rendered brackets with `--align auto`, the reported error is about 0.5 to 4 times the true error for about 9 of 10
/// frames; measured here: 0.7 to 1.3 times. A reported error that is too small misleads users. A reported error that is
/// too large only makes them check a good picture.
#[test]
fn the_stated_error_is_honest() {
    for frame in misplaced(by_default()) {
        let stated = frame.stated.expect("an estimate for a frame that is aligned");
        assert!(frame.rms < 2.0 * stated && stated < 4.0 * frame.rms, "{frame:.3?}");
    }
}

/// Shift and rotation cannot represent the perspective, which moves the corners by 5 to 10 px, so the bitmaps find a
/// compromise. Measured: errors of 0.2 to 0.6 px at the centre; the limit is about twice the largest.
#[test]
fn bitmaps_alone_find_the_centre() {
    for frame in misplaced(&merged(AlignMode::Mtb)) {
        assert!(frame.centre < 1.2, "{frame:.3?}");
    }
}

/// Measured: mean errors of 0.07 to 0.25 px, because `sift` has no refinement on the pixels, unlike `auto`.
#[test]
fn features_alone_find_the_whole_picture() {
    for frame in misplaced(&merged(AlignMode::Sift)) {
        assert!(frame.mean < 0.4, "{frame:.3?}");
    }
}

/// Returns the pixels of `truth.hdr` by rows.
fn true_radiance() -> Vec<[f32; 3]> {
    let picture = image::open(file("truth.hdr")).expect("truth.hdr").to_rgb32f();
    assert_eq!((picture.width() as usize, picture.height() as usize), (WIDTH / QUARTER, HEIGHT / QUARTER));
    picture.pixels().map(|p| p.0).collect()
}

/// Returns log2 of the ratio of our luminance to the true one, for each block of 4 x 4 pixels that is well exposed in
/// some frame.
fn stops_off() -> Vec<f64> {
    let pixels = &by_default().radiance.pixels;
    assert_eq!((pixels.width(), pixels.height()), (WIDTH, HEIGHT));
    let luminance = |p: [f64; 3]| 0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2];
    let saturation = truth()["saturation_cd_s_per_m2"].as_f64().expect("a number");
    let mut stops = Vec::new();
    for (k, wanted) in true_radiance().iter().enumerate() {
        let (x, y) = (k % (WIDTH / QUARTER), k / (WIDTH / QUARTER));
        // Some frames do not cover the 8 blocks nearest to the border.
        if x < 8 || y < 8 || x + 8 >= WIDTH / QUARTER || y + 8 >= HEIGHT / QUARTER {
            continue;
        }
        let wanted = wanted.map(f64::from);
        // A block is well exposed in some frame if it has at least 2 % of saturation in the longest exposure (1/2 s)
        // and at most 80 % in the shortest (1/512 s).
        let exposure = |seconds: f64| wanted.map(|l| l * seconds / saturation);
        if exposure(0.5).iter().any(|&x| x < 0.02) || exposure(1.0 / 512.0).iter().any(|&x| x > 0.8) {
            continue;
        }
        let mut ours = [0.0; 3];
        for row in 0..QUARTER {
            for column in 0..QUARTER {
                let p = pixels.row(y * QUARTER + row)[x * QUARTER + column];
                (0..3).for_each(|c| ours[c] += f64::from(p[c]) / (QUARTER * QUARTER) as f64);
            }
        }
        stops.push((luminance(ours) / luminance(wanted)).log2());
    }
    stops
}

/// Measured: an rms error of 0.0159 stops over 48 981 blocks, 1 % of them below -0.043 and 1 % above 0.047 stops. The
/// limit of 0.03 stops is nearly twice the measured error, to allow for other noise and another tuning of the response;
/// it is three times stricter than the required 0.1 stops.
#[test]
fn radiance_is_the_truth_but_for_one_scale() {
    let mut stops = stops_off();
    assert!(stops.len() > 20_000, "only {} blocks are well seen", stops.len());
    assert!(stops.iter().all(|s| s.is_finite()));
    stops.sort_by(f64::total_cmp);
    let scale = stops[stops.len() / 2];
    let rms = (stops.iter().map(|s| (s - scale) * (s - scale)).sum::<f64>() / stops.len() as f64).sqrt();
    let at = |part: f64| stops[((stops.len() - 1) as f64 * part) as usize] - scale;
    println!("{} blocks, rms {rms:.4}, {:.3} .. {:.3} stops", stops.len(), at(0.01), at(0.99));
    assert!(rms < 0.03, "{rms:.4} stops");
}
