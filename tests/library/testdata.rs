//! The project's own bracket, `testdata/window/`: the program that renders it, and tests that the program and the files
//! agree.
//!
//! To render it again (a few minutes on two cores; see `testdata/window/README.md`):
//!
//!     cargo test --release --test library -- --ignored render_the_bracket
//!
//! `WINDOW_PREVIEW=scale,samples` renders only a picture for viewing, `target/window-preview.png`, while the scene is
//! being changed.

mod window;

use std::fs;
use std::io::Cursor;

use serde_json::Value;
use window::camera;
use window::denoise::develop;
use window::motion::{HANDS, Plate, apply, homography, inverse, product};
use window::scene::{HEIGHT, Scene, WIDTH};
use window::trace::{View, render};
use window::truth;
use window::vec3::V3;

/// Number of light paths per pixel of the large picture; so few are enough, because the picture is denoised.
const SAMPLES: u32 = 14;

/// Margin of the large picture around the reference frame on every side, as a fraction of the frame's width or height.
const MARGIN: f64 = 0.1;

fn view(scale: f64, margin: f64, samples: u32) -> View {
    let side = |n: usize| (n as f64 * (1.0 + 2.0 * margin) * scale).round() as usize;
    View {
        left: -margin * WIDTH as f64,
        top: -margin * HEIGHT as f64,
        scale,
        width: side(WIDTH),
        height: side(HEIGHT),
        samples,
    }
}

/// Writes `pixels` to the file `path` with a simple tone curve, only for viewing.
fn preview(pixels: &[V3], width: usize, path: &std::path::Path) {
    let show = |l: f32| {
        let x = l / 260.0;
        let y = x * (1.0 + x / 900.0) / (1.0 + x);
        (255.0 * y.clamp(0.0, 1.0).powf(1.0 / 2.2)) as u8
    };
    let bytes: Vec<u8> = pixels
        .iter()
        .flat_map(|p| {
            // Only the luminance is compressed, so that colours are kept.
            let l = p.luminance().max(1e-6);
            let k = (l / 120.0).powf(-0.42);
            [show(p.x * k), show(p.y * k), show(p.z * k)]
        })
        .collect();
    image::save_buffer(path, &bytes, width as u32, (pixels.len() / width) as u32, image::ColorType::Rgb8)
        .expect("the preview");
}

#[test]
#[ignore = "renders for minutes and writes testdata/"]
fn render_the_bracket() {
    let scene = Scene::new();
    let target = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("target");
    println!("{} triangles", scene.bvh.triangles.len());
    if let Ok(wish) = std::env::var("WINDOW_PREVIEW") {
        let (scale, samples) = wish.split_once(',').expect("WINDOW_PREVIEW=scale,samples");
        let v = view(scale.parse().expect("a scale"), 0.0, samples.parse().expect("samples"));
        let picture = develop(&scene, &render(&scene, v), v.width);
        preview(&picture, v.width, &target.join("window-preview.png"));
        let mut l: Vec<f32> = picture.iter().map(|p| p.luminance()).collect();
        l.sort_by(f32::total_cmp);
        for part in [0.0, 0.001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999, 1.0] {
            println!("{part}: {:.2} cd/m2", l[((l.len() - 1) as f64 * part) as usize]);
        }
        return;
    }
    let v = view(1.25, MARGIN, SAMPLES);
    let pixels = develop(&scene, &render(&scene, v), v.width);
    let plate = Plate { pixels, width: v.width, height: v.height, left: v.left, top: v.top, scale: v.scale };
    let folder = truth::folder();
    fs::create_dir_all(&folder).expect("testdata/window");
    for (i, hands) in HANDS.iter().enumerate() {
        let radiance = plate.frame(&homography(hands));
        let file = camera::jpeg(&camera::expose(&radiance, i), i);
        println!("{}: {} kB", camera::file_name(i), file.len() / 1000);
        fs::write(folder.join(camera::file_name(i)), file).expect("a frame");
        if i == camera::REFERENCE {
            preview(&radiance, WIDTH, &target.join("window-preview.png"));
            let small = truth::shrink(&radiance, WIDTH, truth::QUARTER);
            fs::write(folder.join("truth.hdr"), truth::write_hdr(&small, WIDTH / truth::QUARTER)).expect("the truth");
        }
    }
    let text = serde_json::to_string_pretty(&truth::describe()).expect("JSON") + "\n";
    fs::write(folder.join("truth.json"), text).expect("truth.json");
}

fn shipped(name: &str) -> Vec<u8> {
    let path = truth::folder().join(name);
    fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn shipped_truth() -> Value {
    serde_json::from_slice(&shipped("truth.json")).expect("truth.json")
}

/// Checks that values are equal except for the last digits of numbers, which depend on the sines of the platform.
fn assert_same(a: &Value, b: &Value, place: &str) {
    match (a, b) {
        (Value::Number(x), Value::Number(y)) => {
            let (x, y) = (x.as_f64().expect("a number"), y.as_f64().expect("a number"));
            assert!((x - y).abs() <= 1e-9 * x.abs().max(1.0), "{place}: {x} and {y}");
        }
        (Value::Array(x), Value::Array(y)) => {
            assert_eq!(x.len(), y.len(), "{place}");
            x.iter().zip(y).enumerate().for_each(|(i, (x, y))| assert_same(x, y, &format!("{place}[{i}]")));
        }
        (Value::Object(x), Value::Object(y)) => {
            assert_eq!(x.keys().collect::<Vec<_>>(), y.keys().collect::<Vec<_>>(), "{place}");
            x.iter().for_each(|(k, x)| assert_same(x, &y[k], &format!("{place}.{k}")));
        }
        _ => assert_eq!(a, b, "{place}"),
    }
}

#[test]
fn truth_json_matches_the_renderer() {
    assert_same(&shipped_truth(), &truth::describe(), "truth");
}

#[test]
fn camera_motion_is_small_and_inside_the_scene() {
    let shipped = shipped_truth();
    let (w, h) = (WIDTH as f64 - 1.0, HEIGHT as f64 - 1.0);
    for (i, hands) in HANDS.iter().enumerate() {
        let m = truth::matrix(&shipped["frames"][i]["homography"]);
        let back = product(&m, &inverse(&m));
        for (r, row) in back.iter().enumerate() {
            for (c, v) in row.iter().enumerate() {
                assert!((v - f64::from(u8::from(r == c))).abs() < 1e-9, "frame {i}: {back:?}");
            }
        }
        for [x, y] in [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h], [w / 2.0, h / 2.0]] {
            let [u, v] = apply(&m, x, y);
            let moved = (u - x).hypot(v - y);
            let still = i == camera::REFERENCE;
            assert!(if still { moved < 1e-9 } else { (1.0..60.0).contains(&moved) }, "frame {i}: {moved} px");
            let [u, v] = apply(&inverse(&homography(hands)), x, y);
            let (mx, my) = (MARGIN * w - 2.0, MARGIN * h - 2.0);
            assert!(u > -mx && u < w + mx && v > -my && v < h + my, "frame {i} looks past the plate: {u}, {v}");
        }
    }
}

#[test]
fn frames_carry_their_exif_and_are_small() {
    let mut total = 0;
    for i in 0..HANDS.len() {
        let bytes = shipped(&camera::file_name(i));
        total += bytes.len();
        let found = exif::Reader::new().read_from_container(&mut Cursor::new(bytes)).expect("EXIF");
        for wanted in camera::exif_fields(i) {
            let field = found.get_field(wanted.tag, wanted.ifd_num).unwrap_or_else(|| panic!("no {}", wanted.tag));
            assert_eq!(format!("{:?}", field.value), format!("{:?}", wanted.value), "frame {i}: {}", wanted.tag);
        }
    }
    total += shipped("truth.hdr").len() + shipped("truth.json").len();
    assert!(total < 1_750_000, "testdata/window has grown to {total} bytes");
}

#[test]
fn the_response_is_monotone_and_its_inverse_is_its_inverse() {
    for v in 0..256 {
        let y = f64::from(v) / 255.0;
        assert!((camera::response(camera::inverse_response(y)) - y).abs() < 1e-12);
    }
    assert_eq!((camera::response(0.0), camera::response(1.0)), (0.0, 1.0));
}

/// The frames contain the true light on the sensor, transformed by the camera model.
///
/// Where the truth is uniform, the quarter-size truth shows the light of each pixel. Over 5 x 5 pixels of a frame, the
/// noise of about 2 code values and the JPEG error of about 1 average to less than 1; the RGBE step of the truth is at
/// most 1/256, which is below half a code value; variations inside a block add as much. With another response the
/// frames would differ by several code values. Where the truth has texture, a position a few pixels beside the true one
/// must fit worse.
#[test]
fn frames_are_the_truth_through_the_camera() {
    let (truth, w) = truth::read_hdr(&shipped("truth.hdr"));
    assert_eq!((w, truth.len() / w), (WIDTH / truth::QUARTER, HEIGHT / truth::QUARTER));
    for (i, hands) in HANDS.iter().enumerate() {
        let picture = image::load_from_memory(&shipped(&camera::file_name(i))).expect("a JPEG").to_rgb8();
        assert_eq!(picture.dimensions(), (WIDTH as u32, HEIGHT as u32));
        let code = |l: f32| 255.0 * camera::response(f64::from(l) * camera::seconds(i) / camera::SATURATION);
        let codes: Vec<[f64; 3]> = truth.iter().map(|p| [code(p.x), code(p.y), code(p.z)]).collect();
        let seen = |u: f64, v: f64, c: usize, r: u32| {
            let (u, v, side) = (u.round() as u32 - r, v.round() as u32 - r, 2 * r + 1);
            let sum: u32 = (0..side * side).map(|q| u32::from(picture.get_pixel(u + q % side, v + q / side)[c])).sum();
            f64::from(sum) / f64::from(side * side)
        };
        let to_frame = homography(hands);
        let (mut errors, mut misfit) = (Vec::new(), [0.0; 5]);
        for (k, wanted) in codes.iter().enumerate() {
            let (x, y) = (k % w, k / w);
            let side = truth::QUARTER as f64;
            let [u, v] = apply(&to_frame, (x as f64 + 0.5) * side - 0.5, (y as f64 + 0.5) * side - 0.5);
            let inside = u > 8.0 && v > 8.0 && u < WIDTH as f64 - 9.0 && v < HEIGHT as f64 - 9.0;
            if x < 1 || y < 1 || x + 1 >= w || (y + 2) * w > codes.len() || !inside {
                continue;
            }
            let near = |q: usize| &codes[(y + q / 3 - 1) * w + x + q % 3 - 1];
            let flat = (0..9).all(|q| near(q).iter().zip(wanted).all(|(a, b)| (a - b).abs() < 5.0));
            if flat && wanted.iter().all(|b| (6.0..250.0).contains(b)) {
                errors.extend((0..3).map(|c| seen(u, v, c, 2) - wanted[c]));
            }
            for (fit, [dx, dy]) in misfit.iter_mut().zip([[0.0, 0.0], [3.0, 0.0], [-3.0, 0.0], [0.0, 3.0], [0.0, -3.0]])
            {
                *fit += (seen(u + dx, v + dy, 1, 1) - wanted[1]).abs() / codes.len() as f64;
            }
        }
        errors.sort_by(f64::total_cmp);
        let at = |part: f64| errors[((errors.len() - 1) as f64 * part) as usize];
        println!("frame {i}: {} values, {:.2} {:.2} {:.2}; {misfit:.2?}", errors.len(), at(0.05), at(0.5), at(0.95));
        assert!(errors.len() > 300, "frame {i}: only {} flat values", errors.len());
        assert!(at(0.5).abs() < 0.5, "frame {i}: the median error is {:.2} values", at(0.5));
        assert!(at(0.95).max(-at(0.05)) < 3.0, "frame {i}: errors reach from {:.2} to {:.2}", at(0.05), at(0.95));
        assert!(misfit[1..].iter().all(|m| *m > 1.3 * misfit[0]), "frame {i} is not where it should be: {misfit:?}");
    }
}

/// The scene, rendered very small without denoising, matches the stored truth, so that a changed lamp, wall or chair is
/// detected.
#[test]
fn the_scene_still_renders_to_the_truth() {
    let (truth, w) = truth::read_hdr(&shipped("truth.hdr"));
    let v = view(1.0 / 16.0, 0.0, 24);
    let pixels = render(&Scene::new(), v);
    let mine: Vec<V3> = pixels.iter().map(|p| p.direct + p.mirror + p.albedo * (p.sun + p.rest)).collect();
    let (mine, truth) = (truth::shrink(&mine, v.width, 5), truth::shrink(&truth, w, 20));
    assert_eq!(mine.len(), truth.len());
    let mut stops: Vec<f32> = mine.iter().zip(&truth).map(|(a, b)| (a.luminance() / b.luminance()).log2()).collect();
    stops.sort_by(f32::total_cmp);
    let at = |part: f32| stops[((stops.len() - 1) as f32 * part) as usize];
    println!("stops: {:.3} {:.3} {:.3}", at(0.05), at(0.5), at(0.95));
    assert!(at(0.5).abs() < 0.15, "the whole picture is {:.2} stops off", at(0.5));
    assert!(at(0.95).max(-at(0.05)) < 0.6, "parts are from {:.2} to {:.2} stops off", at(0.05), at(0.95));
}
