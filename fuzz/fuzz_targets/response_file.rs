//! Response files: `.json`, `.rsp` and `.csv`.
//!
//! In: the kind of file in the first byte, and the file. Checked: curves that are read are finite and increase, also as
//! 32-bit floats. A curve that is saved and read again is equal to the original if saved as JSON, and otherwise to the
//! curve that saving returned.
#![no_main]

use hdralign::response::file::SavedResponse;
use hdralign::response::{CODES, ResponseCurve};
use hdralign_fuzz::{check_error, folder, held, put, set_up};
use libfuzzer_sys::fuzz_target;

const NAMES: [&str; 3] = ["c.json", "c.rsp", "c.csv"];

fuzz_target!(init: set_up(), |data: &[u8]| held(|| response(data)));

fn response(data: &[u8]) {
    let Some((&kind, content)) = data.split_first() else { return };
    let name = NAMES[usize::from(kind) % NAMES.len()];
    let saved = match SavedResponse::read(&put(name, content)) {
        Ok(saved) => saved,
        Err(e) => return check_error(&e, name),
    };
    check(&saved.curve);
    let _ = saved.camera();
    for name in NAMES {
        let path = folder().join(format!("again-{name}"));
        let encoded = match saved.encode(&path) {
            Ok(encoded) => encoded,
            Err(e) => {
                // JSON saves every curve exactly.
                assert!(!name.ends_with("json"), "{e}");
                check_error(&e, name);
                continue;
            }
        };
        std::fs::write(&path, &encoded.text).expect("room for a small file");
        let again = SavedResponse::read(&path).unwrap_or_else(|e| panic!("what was saved is refused: {e}"));
        check(&again.curve);
        if name.ends_with("json") {
            assert_eq!(again, saved);
        }
        assert_eq!(again.curve, encoded.curve, "{name}: what is read is not what was said to be");
    }
}

/// Checks the guarantees of a curve.
fn check(curve: &ResponseCurve) {
    for c in 0..3 {
        assert!(curve.ln_exposure(c).windows(2).all(|w| w[0] < w[1]) && curve.ln_exposure(c).iter().all(|v| v.is_finite()));
        let exposures = curve.exposures(c);
        assert!(exposures.iter().all(|v| v.is_finite() && *v > 0.0), "{exposures:?}");
        assert!(exposures.windows(2).all(|w| w[0] <= w[1]));
        let mut last = 0.0;
        for i in 0..4 * CODES {
            let exposure = curve.exposure(c, i as f32 / 4.0);
            assert!(exposure.is_finite() && exposure >= last, "{exposure} after {last}");
            last = exposure;
        }
        assert!((0.0..128.0).contains(&curve.black(c)));
    }
}
