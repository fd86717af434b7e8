//! File names: default names of results, and unusual names.

use crate::support::{Folder, small, small_jpeg};
use std::io::Cursor;

fn names(folder: &Folder) -> Vec<String> {
    folder.listing().into_iter().map(|(name, _)| name).collect()
}

#[test]
fn results_go_beside_the_photographs_named_for_the_first_and_the_last() {
    let folder = Folder::empty();
    std::fs::create_dir(folder.at("night")).expect("a folder");
    for (i, name) in [(2, "IMG_9.jpg"), (3, "IMG_10.jpg"), (4, "IMG_11.jpg")] {
        folder.put(&format!("night/{name}"), small_jpeg(i));
    }
    let run = folder.line("merge night/IMG_11.jpg night/IMG_9.jpg night/IMG_10.jpg").done();
    assert_eq!(run.stdout, "night/IMG_9-IMG_11.exr\nnight/IMG_9-IMG_11.png\n");
    assert!(run.stdout.lines().all(|path| folder.at(path).is_file()));
    assert_eq!(names(&folder), ["night"]);
    let again = folder.line("merge night/IMG_11.jpg night/IMG_9.jpg night/IMG_10.jpg");
    assert!(again.code == 1 && again.stderr.contains("--force"), "{again:?}");
}

#[test]
fn aligned_frames_have_one_size_and_open_elsewhere() {
    let folder = Folder::with_bracket();
    let run = folder.line("align w2.jpg w3.jpg w4.jpg --save-aligned on_ --reference 2").done();
    assert_eq!(run.stdout, "on_w2.tif\non_w3.tif\non_w4.tif\n");
    let pictures: Vec<_> =
        run.stdout.lines().map(|p| image::open(folder.at(p)).expect("a TIFF that opens").to_rgb8()).collect();
    let (w, h) = pictures[0].dimensions();
    assert!(pictures.iter().all(|p| p.dimensions() == (w, h)));
    // Rotations under a degree and shifts under 6 of 300 pixels leave most of the picture.
    assert!((250..300).contains(&w) && (160..200).contains(&h), "{w} x {h}");
    // The reference is only cropped, never resampled.
    let reference = small_jpeg(3);
    let whole = image::load_from_memory(reference).expect("a JPEG").to_rgb8();
    let cut = |x, y| image::imageops::crop_imm(&whole, x, y, w, h).to_image();
    // Two JPEG decoders may differ by one or two code values.
    let near = |p: &image::RgbImage| p.as_raw().iter().zip(pictures[1].as_raw()).all(|(a, b)| a.abs_diff(*b) <= 3);
    assert!((0..=300 - w).any(|x| (0..=200 - h).any(|y| near(&cut(x, y)))), "the reference was changed");
    // Other programs need the exposure of each frame.
    let exposure = |name: &str| {
        let bytes = std::fs::read(folder.at(name)).expect("a file");
        let tags = exif::Reader::new().read_from_container(&mut Cursor::new(bytes)).expect("EXIF");
        let time = tags.get_field(exif::Tag::ExposureTime, exif::In::PRIMARY).expect("an exposure time");
        time.display_value().to_string()
    };
    for i in 2..=4 {
        assert_eq!(exposure(&format!("on_w{i}.tif")), exposure(&format!("w{i}.jpg")), "{i}");
    }
}

#[test]
fn displacements_are_those_of_the_transforms_where_nothing_else_is_known() {
    let folder = Folder::with_bracket();
    let run = folder.line("align w2.jpg w3.jpg w4.jpg --displacements by_ --reference 2 --transforms t.json").done();
    assert_eq!(run.stdout, "t.json\nby_w2.tif\nby_w4.tif\n");
    let saved: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.at("t.json")).expect("a file")).expect("JSON");
    let frames = saved["frames"].as_array().expect("frames");
    for name in ["w2", "w4"] {
        let frame =
            frames.iter().find(|f| f["file"].as_str().is_some_and(|file| file.contains(name))).expect("the frame");
        let h: Vec<f64> =
            frame["homography"].as_array().expect("nine numbers").iter().map(|v| v.as_f64().expect("one")).collect();
        let file = std::fs::File::open(folder.at(format!("by_{name}.tif"))).expect("a file");
        let mut decoder = tiff::decoder::Decoder::new(file).expect("a TIFF");
        assert_eq!(decoder.dimensions().expect("a size"), (300, 200));
        let decoded = decoder.read_image().expect("its pixels");
        let tiff::decoder::DecodingResult::F32(values) = decoded else { panic!("floats") };
        assert_eq!(values.len(), 2 * 300 * 200);
        for (i, d) in values.chunks_exact(2).enumerate() {
            let (x, y) = ((i % 300) as f64, (i / 300) as f64);
            let w = h[6] * x + h[7] * y + h[8];
            let (u, v) = ((h[0] * x + h[1] * y + h[2]) / w, (h[3] * x + h[4] * y + h[5]) / w);
            if u < 0.0 || v < 0.0 || u > 299.0 || v > 199.0 {
                assert!(d[0].is_nan() && d[1].is_nan(), "({x}, {y}) is outside of {name}");
            } else {
                // The file of transforms is rounded; a float has an error of 1e-5 at 100 pixels.
                let error = (f64::from(d[0]) - (u - x)).abs().max((f64::from(d[1]) - (v - y)).abs());
                assert!(error < 1e-3, "({x}, {y}): {d:?} in {name}");
            }
        }
    }
}

#[test]
fn without_a_crop_results_have_the_size_of_the_reference() {
    let folder = Folder::with_bracket();
    folder.line("merge w2.jpg w3.jpg w4.jpg --crop none -o a.png -o a.exr --save-aligned on_").done();
    for name in ["a.png", "on_w2.tif", "on_w3.tif", "on_w4.tif"] {
        let picture = image::open(folder.at(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!((picture.width(), picture.height()), (300, 200), "{name}");
    }
    folder.line("merge w2.jpg w3.jpg w4.jpg -C common -o b.png").done();
    assert!(image::open(folder.at("b.png")).expect("a picture").width() < 300);
}

#[test]
fn names_that_are_hard_to_handle_work() {
    let folder = Folder::empty();
    let given = ["a room with a view.jpg", "Aussicht für Zwölf 窓.jpg", "-lead.jpg"];
    for (i, name) in given.iter().enumerate() {
        folder.put(name, small_jpeg(i + 2));
    }
    let arguments = ["merge", "-o", "to the end é.exr", "-o", "./-dash.png", "--"];
    let run = folder.run(arguments.into_iter().chain(given)).done();
    assert_eq!(run.stdout, "to the end é.exr\n./-dash.png\n");
    assert!(run.stdout.lines().all(|path| folder.at(path).is_file()));
    assert_eq!(names(&folder).len(), 5);
}

#[test]
fn the_content_counts_not_the_extension() {
    let folder = Folder::empty();
    folder.put("really-a-jpeg.tif", small_jpeg(2));
    folder.put("no-extension", small_jpeg(3));
    let run = folder.line("merge really-a-jpeg.tif no-extension -o a.exr").done();
    assert_eq!(run.stdout, "a.exr\n");
    let png = small(3);
    png.save_with_format(folder.at("really-a-png.jpg"), image::ImageFormat::Png).expect("a PNG");
    folder.line("merge -e=-2,0 really-a-jpeg.tif really-a-png.jpg -o b.exr").done();
}

#[test]
fn a_saved_response_gives_the_same_radiance() {
    let folder = Folder::with_bracket();
    let line = "merge w1.jpg w2.jpg w3.jpg w4.jpg w5.jpg";
    folder.line(&format!("{line} -o a.exr --save-response r.json")).done();
    folder.line(&format!("{line} -o b.exr --response r.json")).done();
    assert!(folder.bytes("a.exr") == folder.bytes("b.exr"), "the .exr differ");
    // The bytes are not equal because the response has no influence: another one gives other bytes.
    folder.line(&format!("{line} -o c.exr --response-model linear")).done();
    assert!(folder.bytes("a.exr") != folder.bytes("c.exr"));
}
