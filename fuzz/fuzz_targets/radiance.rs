//! Radiance maps of any writer: `.hdr`, `.exr`, floating-point and LogLuv TIFF.
//!
//! In: a file. Checked: no panic, no hang, no allocation out of proportion to its bytes; a map has as many pixels as
//! its size says; repaired values are positive and finite; a small map can be tone-mapped, written in every format, and
//! read again with the same size.
#![no_main]

use hdralign::bracket::colour::Space;
use hdralign::limits::Limits;
use hdralign::merge::FLOOR;
use hdralign::pipeline::{TonemapOptions, tonemap_file, unwatched};
use hdralign::read;
use hdralign::write::exr::{Options as ExrOptions, Sample};
use hdralign_fuzz::{check_error, folder, hash, held, put, set_up};
use libfuzzer_sys::fuzz_target;

/// Largest number of pixels that are decoded.
const MOST_PIXELS: u64 = 1 << 20;
/// Largest number of pixels of maps that are written again.
const SMALL: usize = 2048;

fuzz_target!(init: set_up(), |data: &[u8]| held(|| radiance(data)));

fn radiance(data: &[u8]) {
    let path = put("r.any", data);
    let kind = read::holds_radiance(&path, &Limits::default());
    let limits = Limits { max_pixels: MOST_PIXELS, ..Limits::default() };
    let map = match read::read_within(&path, &limits) {
        Ok(read) => read.map,
        Err(e) => return check_error(&e, "r.any"),
    };
    assert!(matches!(kind, Ok(true)), "it was read, and is said to hold no radiance: {kind:?}");
    let (width, height) = (map.pixels.width(), map.pixels.height());
    assert!(width > 0 && height > 0 && map.pixels.as_slice().len() == width * height);
    let (repaired, _) = read::repair(map);
    assert!(repaired.pixels.as_slice().as_flattened().iter().all(|v| v.is_finite() && *v >= FLOOR));
    if width * height > SMALL {
        return;
    }
    let outputs: Vec<_> = ["o.exr", "o.hdr", "o.tif", "o.jpg", "o.png"].map(|name| folder().join(name)).into();
    let colour = [None, None, Some(Space::Rec2020), Some(Space::Prophoto)][hash(data) as usize % 4];
    let mut options = TonemapOptions { outputs, colour, ..TonemapOptions::default() };
    options.write.overwrite = true;
    options.write.exr = ExrOptions { sample: Sample::Float, ..ExrOptions::default() };
    let report = tonemap_file(&path, &options, &unwatched).unwrap_or_else(|e| panic!("it was read, and not shown: {e}"));
    let text = serde_json::to_string(&report).expect("JSON");
    assert!(serde_json::from_str::<serde_json::Value>(&text).is_ok());
    for output in &options.outputs[..3] {
        let (again, _) = read::read(output).unwrap_or_else(|e| panic!("what was written is refused: {e}"));
        assert_eq!((again.pixels.width(), again.pixels.height()), (width, height));
        assert!(again.pixels.as_slice().as_flattened().iter().all(|v| v.is_finite()), "{output:?}");
        if output.extension().is_some_and(|e| e == "exr" || e == "tif") {
            assert!(colour.is_some() || again.pixels == repaired.pixels, "floats come back to the bit: {output:?}");
        }
    }
}
