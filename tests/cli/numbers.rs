//! Extreme numbers: options at the ends of their ranges give finite results or an error, and values that a format does
//! not support are reported.

use crate::support::{Folder, jpeg, small};
use hdralign::read::read;
use serde_json::Value;

const MERGE: &str = "merge w2.jpg w3.jpg w4.jpg --align none --force";

/// Returns the smallest and the largest value in the radiance map `name`; checks that all are finite.
fn range(folder: &Folder, name: &str) -> (f32, f32) {
    let (map, _) = read(&folder.at(name)).expect("a radiance map");
    let values = map.pixels.as_slice().as_flattened();
    assert!(values.iter().all(|v| v.is_finite()), "{name}");
    values.iter().fold((f32::MAX, 0.0), |(least, most), v| (v.min(least), v.max(most)))
}

/// Every writer is tested with the smallest and the largest factor: values that are limited are counted and reported,
/// and all values that are written are finite.
#[test]
fn values_out_of_range_are_limited_and_reported() {
    let folder = Folder::with_bracket();
    for (factor, at_half) in [("1e20", 65504.0), ("1e-20", 1.0)] {
        let outputs =
            "-o h.exr -o a.hdr -o l24.tif -o a.png -o a.jpg --exr-type half --tiff-encoding logluv24 --report r.json";
        let run = folder.line(&format!("{MERGE} {outputs} --calibration-factor {factor}")).done();
        let (_, most) = range(&folder, "h.exr");
        assert!(most <= at_half, "{factor}: {most}");
        if factor == "1e20" {
            assert!(run.stderr.contains("h.exr: ") && run.stderr.contains("above 65504"), "{}", run.stderr);
            assert_eq!(most, at_half);
        }
        // LogLuv files have a scale in addition to the pixels, so the values must be finite after scaling.
        range(&folder, "l24.tif");
        range(&folder, "a.hdr");
        let report: Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
        let numbers = ["min", "max"].map(|key| report["radiance"]["radiance"][key].as_f64().expect("a number"));
        assert!(numbers[0] > 0.0 && numbers[1] >= numbers[0], "{numbers:?}");
        // The 126 stops of LogLuv32 contain both extremes.
        folder.line(&format!("{MERGE} -o l32.tif --tiff-encoding logluv32 --calibration-factor {factor}")).done();
        range(&folder, "l32.tif");
        folder.line(&format!("{MERGE} -o f.exr -o f.tif --exr-type float --calibration-factor {factor}")).done();
        assert!(range(&folder, "f.exr") == range(&folder, "f.tif") && range(&folder, "f.exr").0 > 0.0, "{factor}");
    }
}

#[test]
fn invalid_factors_are_rejected() {
    let folder = Folder::with_bracket();
    for factor in ["0", "-1", "nan", "inf", "1e21", "1e-21", "1e400", "1e-400"] {
        let run = folder.line(&format!("{MERGE} -o a.exr --calibration-factor={factor}"));
        assert!(run.code == 2 && run.stderr.contains("--calibration-factor"), "{factor}: {run:?}");
    }
}

#[test]
fn invalid_exposures_are_rejected() {
    let folder = Folder::with_bracket();
    for ev in ["nan,0,1", "0,inf,1", "-inf,0,1", "-1000,0,1", "0,41,1", "0,1e400,2"] {
        let run = folder.line(&format!("{MERGE} -o a.exr -e={ev}"));
        assert!(run.code == 2 && run.stderr.contains("-e"), "{ev}: {run:?}");
    }
    // With the largest accepted difference of exposures every pixel is finite, although it is wrong for this scene.
    folder.line(&format!("{MERGE} -o a.exr -o a.hdr -o a.png --exr-type float -e=-40,0,40")).done();
    assert!(range(&folder, "a.exr").0 > 0.0);
    range(&folder, "a.hdr");
}

/// An EXIF exposure that is 0, infinite, or impossible for a camera counts as missing.
#[test]
fn impossible_exposures_in_exif_are_estimated() {
    let folder = Folder::empty();
    for i in 2..=4 {
        let mut bytes = jpeg(&small(i), Some(i));
        // The exposure time is a rational in the EXIF block: its bytes are replaced by those of 0/1, 1/0 or
        // 4294967295/1, in the byte order of the file.
        let exif = exif::Reader::new().read_from_container(&mut std::io::Cursor::new(&bytes)).expect("EXIF");
        let field = exif.get_field(exif::Tag::ExposureTime, exif::In::PRIMARY).expect("a time");
        let exif::Value::Rational(time) = &field.value else { panic!("a rational") };
        let is_little = exif.little_endian();
        let word = |v: u32| if is_little { v.to_le_bytes() } else { v.to_be_bytes() };
        let pair = |a: u32, b: u32| [word(a), word(b)].concat();
        let (old, new) = (pair(time[0].num, time[0].denom), [pair(0, 1), pair(1, 0), pair(u32::MAX, 1)][i - 2].clone());
        let at = bytes.windows(8).position(|w| w == old).expect("the time");
        bytes[at..at + 8].copy_from_slice(&new);
        folder.put(&format!("w{i}.jpg"), &bytes);
    }
    let run = folder.line(&format!("{MERGE} -o a.exr -o a.png --report r.json")).done();
    assert!(run.stderr.contains("estimated from the pixels"), "{}", run.stderr);
    assert!(range(&folder, "a.exr").0 > 0.0);
    let report: Value = serde_json::from_slice(&folder.bytes("r.json")).expect("JSON");
    for frame in report["frames"].as_array().expect("a list") {
        let exposure = frame["relative_exposure"].as_f64().expect("a number");
        assert!(exposure.is_finite() && exposure > 0.0, "{frame}");
    }
}
