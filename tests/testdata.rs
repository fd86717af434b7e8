//! The project's own bracket, `testdata/window/`: the program that renders it, and tests that the two agree.
//!
//! To render it all again (about ten minutes on two cores; `testdata/window/README.md` says more):
//!
//!     cargo test --release --test testdata -- --ignored render_the_bracket
//!
//! `WINDOW_PREVIEW=scale,samples` renders only a picture to look at, `target/window-preview.png`, while the scene is
//! being changed.

#![allow(missing_docs)]

mod window;

use std::fs;

use window::camera;
use window::denoise::develop;
use window::motion::{HANDS, Plate, apply, homography, inverse, product};
use window::scene::{HEIGHT, Scene, WIDTH};
use window::trace::{View, render};
use window::truth;
use window::vec3::V3;

/// The large picture reaches this part of a frame beyond it, on every side.
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

/// A plain tone curve, for previews only: local detail and the eye's logarithm are other people's work.
fn preview(pixels: &[V3], width: usize, path: &std::path::Path) {
    let show = |l: f32| {
        let x = l / 260.0;
        let y = x * (1.0 + x / 900.0) / (1.0 + x);
        (255.0 * y.clamp(0.0, 1.0).powf(1.0 / 2.2)) as u8
    };
    let bytes: Vec<u8> = pixels
        .iter()
        .flat_map(|p| {
            // Compressed by luminance, so that colours survive.
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
    let v = view(1.5, MARGIN, 56);
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
