//! Pictures as photographers ask for them: bits, formats, colours, capture data, parts and sizes. What was written is read by others' decoders.

use crate::support::Folder;
use image::DynamicImage;

const MERGE: &str = "merge w2.jpg w3.jpg w4.jpg --align none -q --force";

/// The codes of a picture of 16 bits, and its size.
fn sixteen(folder: &Folder, name: &str) -> (Vec<u16>, (u32, u32)) {
    match image::open(folder.at(name)).unwrap_or_else(|e| panic!("{name}: {e}")) {
        DynamicImage::ImageRgb16(picture) => {
            let size = picture.dimensions();
            (picture.into_raw(), size)
        }
        other => panic!("{name}: {:?}", other.color()),
    }
}

/// The codes of a picture of 8 bits, and its size.
fn eight(folder: &Folder, name: &str) -> (Vec<u8>, (u32, u32)) {
    match image::open(folder.at(name)).unwrap_or_else(|e| panic!("{name}: {e}")) {
        DynamicImage::ImageRgb8(picture) => {
            let size = picture.dimensions();
            (picture.into_raw(), size)
        }
        other => panic!("{name}: {:?}", other.color()),
    }
}

/// That `line` is wrong usage, and says all of `said`.
fn refused(folder: &Folder, line: &str, said: &[&str]) {
    let before = folder.listing();
    let run = folder.line(line);
    assert_eq!((run.code, folder.listing()), (2, before), "{line}: {run:?}");
    assert!(said.iter().all(|part| run.stderr.contains(part)), "{line}: {}", run.stderr);
}

/// 8 bits are rounded from the same floats: half an 8-bit code is 128.5 codes of 16 bits, and the tables add 0.05. Codes that were stretched would all be
/// multiples of 257; of floats one in 257 is.
#[test]
fn codes_of_16_bits_are_of_the_floats() {
    let folder = Folder::with_bracket();
    folder.line(&format!("{MERGE} -o a.exr --exr-type float")).done();
    for line in [MERGE, &format!("{MERGE} --tmo mertens"), &format!("{MERGE} --tmo drago"), "tonemap a.exr -q --force"]
    {
        folder.line(&format!("{line} -o a.png")).done();
        folder.line(&format!("{line} --bit-depth 16 -o b.png")).done();
        let ((coarse, size), (fine, fine_size)) = (eight(&folder, "a.png"), sixteen(&folder, "b.png"));
        assert_eq!(size, fine_size, "{line}");
        let off = coarse.iter().zip(&fine).map(|(&a, &b)| (257 * i32::from(a) - i32::from(b)).abs()).max();
        assert!(off <= Some(129), "{line}: {off:?}");
        let stretched = fine.iter().filter(|&&code| code % 65535 != 0 && code.is_multiple_of(257)).count();
        assert!(stretched * 50 < fine.len(), "{line}: {stretched} of {}", fine.len());
    }
}

#[test]
fn bits_that_a_file_does_not_hold_are_refused() {
    let folder = Folder::with_bracket();
    for line in [MERGE, "tonemap gone.exr"] {
        refused(&folder, &format!("{line} --bit-depth 16 -o a.png -o b.jpg"), &["--bit-depth", "b.jpg", "8 bits"]);
        refused(&folder, &format!("{line} --bit-depth 16 -o a.exr"), &["--bit-depth", "no picture is written"]);
        refused(&folder, &format!("{line} --bit-depth 12 -o a.png"), &["--bit-depth", "12", "16"]);
    }
}
