//! Units and colour spaces of the files that `merge` writes, tested with the program.

use crate::support::{FRAMES, Folder, jpeg_with, ratio, small};
use exif::{Tag, Value as Exif};
use hdralign::bracket::colour::{Conversion, Primaries};
use hdralign::merge::radiance::calibration::Factor;
use hdralign::read::read;
use serde_json::Value;

const MERGE: &str = "merge w2.jpg w3.jpg w4.jpg --align none --exr-type float --json -q --force";

fn report(folder: &Folder, options: &str) -> Value {
    serde_json::from_str(&folder.line(&format!("{MERGE} {options}")).done().stdout).expect("JSON")
}

#[test]
fn a_factor_makes_cd_m2_in_every_format() {
    let folder = Folder::with_bracket();
    let relative = report(&folder, "-o r.exr -o r.hdr");
    let outputs = "-o a.exr -o a.hdr -o a.tif";
    let calibrated = report(&folder, &format!("--calibration-factor 250 {outputs}"));
    let part = |json: &Value, key: &str| json["radiance"]["radiance"][key].clone();
    assert_eq!([part(&relative, "unit"), part(&calibrated, "unit")], ["relative", "cd/m2"]);
    assert_eq!((&relative["calibration"], &calibrated["calibration"]["cd_m2_per_unit"]), (&Value::Null, &250.0.into()));
    let number = |json: &Value, key| part(json, key).as_f64().expect("a number");
    assert!((number(&calibrated, "max") / number(&relative, "max") - 250.0).abs() < 1e-3);
    assert!((number(&calibrated, "contrast") / number(&relative, "contrast") - 1.0).abs() < 1e-5);

    let map = |name: &str| read(&folder.at(name)).unwrap();
    let (radiance, header) = map("a.exr");
    assert_eq!(header.cd_m2_per_unit, Some(Factor::ONE));
    assert_eq!(map("r.exr").1.cd_m2_per_unit, None);
    assert_eq!(map("a.tif").1.cd_m2_per_unit, Some(Factor::ONE));
    assert!(map("a.tif").0.pixels == radiance.pixels);
    let luminance = |p: [f32; 3]| f64::from(0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2]);
    // A mantissa is truncated by at most 1/128 of the largest channel; the middle of its step is wrong by at most half
    // of that.
    let watts = map("a.hdr").0;
    for (cd, w) in radiance.pixels.as_slice().iter().zip(watts.pixels.as_slice()) {
        assert!((179.0 * luminance(*w) / luminance(*cd) - 1.0).abs() < 0.02, "{cd:?} {w:?}");
    }
    for name in ["a.hdr", "r.hdr"] {
        let text = String::from_utf8_lossy(&folder.bytes(name)).into_owned();
        let header = text.split("\n\n").next().unwrap();
        let lines: Vec<&str> = header.lines().filter(|l| l.contains("EXPOSURE")).collect();
        assert!(lines == ["EXPOSURE=1e0"] && !header.contains('\t'), "{header}");
    }
}

#[test]
fn absolute_luminance_is_computed_from_exif() {
    let folder = Folder::with_bracket();
    let json = report(&folder, "--absolute -o a.exr");
    let frames = json["frames"].as_array().unwrap();
    let reference = frames.iter().find(|f| f["path"] == json["reference"]).unwrap();
    let of = |key: &str| reference[key].as_f64().unwrap();
    let expected = 87.0 / of("relative_exposure");
    let reported = json["calibration"]["camera_top_code_cd_m2"].as_f64().unwrap();
    assert!((reported / expected - 1.0).abs() < 1e-9, "{reported} {expected}");
    let corrected = report(&folder, "--absolute --calibration-factor 1.1 -o a.exr");
    let per_unit = |json: &Value| json["calibration"]["cd_m2_per_unit"].as_f64().unwrap();
    assert!((per_unit(&corrected) / per_unit(&json) - 1.1).abs() < 1e-9);

    // These PNGs have no EXIF.
    for i in 1..=FRAMES {
        small(i).save(folder.at(format!("p{i}.png"))).unwrap();
    }
    let run = folder.line("merge -e=-2,0,2 p2.png p3.png p4.png --absolute -o b.exr");
    assert!(run.code == 2 && run.stderr.contains("does not have all of exposure time, f-number and ISO"), "{run:?}");
    // The error is reported before alignment, which would fail because the rotated picture looks like another scene.
    image::imageops::rotate180(&small(3)).save(folder.at("turned.png")).unwrap();
    let run = folder.line("merge -e=-2,0 p2.png turned.png --absolute -o b.exr");
    assert!(run.code == 2 && run.stderr.contains("--absolute"), "{run:?}");
    let run = folder.line(&format!("{MERGE} --calibration-factor -3 -o b.exr"));
    assert!(run.code == 2 && run.stderr.contains("--calibration-factor"), "{run:?}");
    assert!(!folder.at("b.exr").exists());
}

/// A camera records 1/30 s for 1/32 s, or its shutter has an error of a tenth of a stop: the luminance of the scene is
/// the same for any reference.
#[test]
fn luminance_is_the_same_whichever_frame_is_the_reference() {
    let folder = Folder::empty();
    let shot = |name: &str, i: usize, num: u32, denom: u32| {
        let exif = [
            (Tag::ExposureTime, ratio(num, denom)),
            (Tag::FNumber, ratio(8, 1)),
            (Tag::PhotographicSensitivity, Exif::Short(vec![100])),
        ];
        folder.put(name, &jpeg_with(&small(i), &exif));
    };
    // The times are 1/`printed` s, as cameras record 1/128, 1/32 and 1/8 s, or 1000/`measured` s, of which the middle
    // one is wrong: 1/34.3 s for 1/32 s.
    for (i, printed, measured) in [(2, 125, 128_000), (3, 30, 34_300), (4, 8, 8_000)] {
        shot(&format!("printed{i}.jpg"), i, 1, printed);
        shot(&format!("measured{i}.jpg"), i, 1000, measured);
    }
    for set in ["printed", "measured"] {
        for exposures in ["fine-tuned", "as-given"] {
            let luminance = |reference: usize| {
                let images = [2, 3, 4].map(|i| format!("{set}{i}.jpg")).join(" ");
                let options =
                    "--align none --deghost=off --response-model srgb --absolute --exr-type float --json -q --force";
                let reference = format!("--reference {set}{reference}.jpg --exposures {exposures}");
                folder.line(&format!("merge {images} {options} {reference} -o a.exr")).done();
                let mut all: Vec<f32> =
                    read(&folder.at("a.exr")).unwrap().0.pixels.as_slice().iter().map(|p| p[1]).collect();
                all.sort_by(f32::total_cmp);
                [0.2, 0.5, 0.8].map(|share| f64::from(all[(share * all.len() as f64) as usize]))
            };
            let first = luminance(2);
            for reference in [3, 4] {
                for (a, b) in first.iter().zip(luminance(reference)) {
                    assert!(
                        (b / a - 1.0).abs() < 0.005,
                        "{set}, {exposures}, reference {reference}: {a} and {b} cd/m2"
                    );
                }
            }
        }
    }
}

#[test]
fn other_colour_spaces_have_the_same_light_and_their_primaries() {
    let folder = Folder::with_bracket();
    report(&folder, "-o keep.exr -o keep.png");
    let keep = read(&folder.at("keep.exr")).unwrap().0;
    for (name, primaries, id) in [
        ("srgb", Primaries::SRGB, "lin_rec709_scene"),
        ("display-p3", Primaries::DISPLAY_P3, "lin_p3d65_scene"),
        ("adobe-rgb", Primaries::ADOBE_RGB, "lin_adobergb_scene"),
        ("rec2020", Primaries::BT2020, "lin_rec2020_scene"),
        ("prophoto", Primaries::PROPHOTO, ""),
        ("acescg", Primaries::ACES_AP1, "lin_ap1_scene"),
    ] {
        let json = report(&folder, &format!("--colour {name} -o c.exr -o c.hdr -o c.tif -o c.png"));
        assert_eq!(json["colour"]["space"], name);
        let back = Conversion::between(&primaries, &Primaries::SRGB).unwrap();
        for file in ["c.exr", "c.tif"] {
            let (map, _) = read(&folder.at(file)).unwrap();
            assert_eq!(map.primaries.nearest_standard(), Some(primaries), "{file}");
            for (a, b) in keep.pixels.as_slice().iter().zip(map.pixels.as_slice()) {
                let b = if name == "srgb" { *b } else { back.apply(*b) };
                let near = 1e-5 * a[0].max(a[1]).max(a[2]);
                assert!((0..3).all(|c| (a[c] - b[c]).abs() <= near), "{name} {file}: {a:?} {b:?}");
            }
        }
        let bytes = folder.bytes("c.exr");
        let has = |text: &str| bytes.windows(text.len()).any(|w| w == text.as_bytes());
        assert_eq!(has("colorInteropID"), !id.is_empty());
        assert!((id.is_empty() || has(id)) && has("chromaticities"), "{name}");
        let header = String::from_utf8_lossy(&folder.bytes("c.hdr")[..600]).into_owned();
        assert!(header.contains(&format!("PRIMARIES= {:.4} {:.4}", primaries.red[0], primaries.red[1])), "{header}");
        // The picture is in sRGB whatever the colour space of the radiance is.
        let picture = |name: &str| image::open(folder.at(name)).unwrap().to_rgb8();
        let (kept, converted) = (picture("keep.png"), picture("c.png"));
        let far = kept.as_raw().iter().zip(converted.as_raw()).filter(|(a, b)| a.abs_diff(**b) > 1);
        assert_eq!(far.count(), 0, "{name}");
    }
}
