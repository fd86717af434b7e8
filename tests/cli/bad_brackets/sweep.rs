//! Degenerate brackets with every option: no crash, no hang, valid results.

use super::*;

const OPERATORS: [&str; 9] =
    ["natural", "reinhard02", "reinhard02-local", "drago", "durand", "fattal", "mantiuk06", "mantiuk08", "mertens"];

const OPTIONS: [&str; 14] = [
    "--align mtb",
    "--align sift",
    "--align none",
    "--deghost",
    "--flare",
    "--response-model robertson",
    "--response-model mitsunaga-nayar",
    "--response-model linear",
    "--response-model srgb",
    "--crop none --deghost --flare",
    "--weight noise",
    "--weight uniform",
    "--robust lmeds --align sift",
    "--colour acescg --exposures as-given",
];

/// Returns degenerate brackets, each with its name.
fn brackets() -> Vec<(&'static str, Vec<RgbImage>)> {
    let piece = |i: usize, width, height| image::imageops::crop_imm(&frame(i), 120, 60, width, height).to_image();
    let mut random = Random(3);
    let mut noise = || RgbImage::from_fn(40, 33, |_, _| Rgb([0; 3].map(|_| (256.0 * random.next()) as u8)));
    let plain = |c: u8| RgbImage::from_pixel(40, 33, Rgb([c; 3]));
    let checks =
        |most: u8| RgbImage::from_fn(40, 33, |x, y| Rgb([if (x + y).is_multiple_of(2) { 0 } else { most }; 3]));
    vec![
        ("black", vec![plain(0); 2]),
        ("white", vec![plain(255); 2]),
        ("black and white", vec![plain(0), plain(255)]),
        ("grey", vec![plain(70), plain(140)]),
        ("one pixel", vec![piece(2, 1, 1), piece(3, 1, 1)]),
        ("one column", vec![piece(2, 1, 40), piece(3, 1, 40)]),
        ("one row", vec![piece(2, 40, 1), piece(3, 40, 1)]),
        ("three pixels", vec![piece(2, 3, 3), piece(3, 3, 3)]),
        ("noise", vec![noise(), noise()]),
        ("checks", vec![checks(100), checks(250)]),
    ]
}

/// Checks that a merge gives exit code 0 with complete and valid results, or 1 with a message and no files.
fn done_or_refused(name: &str, frames: &[RgbImage], options: &str) {
    let folder = Folder::empty();
    let names = lossless(&folder, &frames.iter().collect::<Vec<_>>());
    let before = folder.listing();
    let line = format!("{names} -e=-1,1 {options}");
    let run = folder.line(&format!("merge {line} -o a.exr -o a.png -o a.jpg -o a.hdr"));
    match run.code {
        0 => {
            assert_eq!(run.stdout, "a.exr\na.png\na.jpg\na.hdr\n", "{name} {options}");
            let (map, _) = read::read(&folder.at("a.exr")).unwrap_or_else(|e| panic!("{name} {options}: {e}"));
            let is_light = map.pixels.as_slice().iter().flatten().all(|v| v.is_finite() && *v >= 0.0);
            assert!(is_light, "{name} {options}");
            for file in ["a.png", "a.jpg"] {
                image::open(folder.at(file)).unwrap_or_else(|e| panic!("{name} {options} {file}: {e}"));
            }
        }
        1 => {
            assert!(run.stderr.contains("hdralign: ") && run.stdout.is_empty(), "{name} {options}: {run:?}");
            assert_eq!(folder.listing(), before, "{name} {options}");
        }
        code => panic!("{name} {options}: exit code {code}\n{}", run.stderr),
    }
    assert!(!run.stderr.contains("panicked"), "{name} {options}: {}", run.stderr);
}

#[test]
fn degenerate_brackets_under_every_option() {
    for (name, frames) in brackets() {
        for options in OPTIONS {
            done_or_refused(name, &frames, options);
        }
    }
}

#[test]
fn degenerate_brackets_by_every_operator() {
    for (name, frames) in brackets() {
        for operator in OPERATORS {
            done_or_refused(name, &frames, &format!("--align none --tmo {operator}"));
        }
    }
}

/// Black frames give a black picture and white frames a white one, with every operator.
#[test]
fn black_and_white_are_kept_by_every_operator() {
    for operator in OPERATORS {
        for code in [0, 255] {
            let folder = Folder::empty();
            let plain = RgbImage::from_pixel(40, 33, Rgb([code; 3]));
            let names = lossless(&folder, &[&plain, &plain]);
            let merged = merged(&folder, &format!("{names} -e=-1,1 --tmo {operator}"));
            assert!(
                merged.picture.pixels().all(|p| p.0 == [code; 3]),
                "{operator} {code}: {:?}",
                merged.picture.get_pixel(0, 0)
            );
        }
    }
}

/// The other commands with the degenerate brackets.
#[test]
fn align_inspect_and_response_meet_them_too() {
    for (name, frames) in brackets() {
        let folder = Folder::empty();
        let names = lossless(&folder, &frames.iter().collect::<Vec<_>>());
        for line in [
            format!("align {names} -e=-1,1 --json"),
            format!("align {names} -e=-1,1 --save-aligned out/a --displacements out/b --json"),
            format!("inspect {names} -e=-1,1 -d seen"),
            format!("response {names} -e=-1,1 -o camera.json"),
            format!("merge {names} -e=-1,1 --align none -o b.exr --report b.html"),
        ] {
            std::fs::create_dir_all(folder.at("out")).expect("a folder");
            let run = folder.line(&line);
            assert!(matches!(run.code, 0 | 1) && !run.stderr.contains("panicked"), "{name}: {line}: {run:?}");
            assert_eq!(run.code == 1, run.stderr.contains("hdralign: "), "{name}: {line}: {run:?}");
        }
    }
}
