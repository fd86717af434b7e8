//! Radiance `.hdr` files of any writer: RGBE and XYZE.
//!
//! In: a file. Out: its radiance and its metadata. New and old run-length encoding, uncompressed pixels, and all
//! eight scanline orders are supported. Cost: 10 ns per pixel. Source: see [`crate::write::hdr`];
//! `src/common/resolu.c` (orders).

use super::Contents;
use super::orientation::Turn;
use crate::bracket::colour::{NeutralXyz, Primaries};
use crate::limits::{self, Limits};
use crate::merge::radiance::calibration::Factor;
use crate::pixel::rgbe::{self, Rgbe};
use crate::plane::Plane;
use crate::write::Metadata;
use crate::write::hdr::WHITE_EFFICACY;

/// Reads the picture in the `bytes` of a `.hdr` file as stored, and its [`exposure_scale`](Metadata::exposure_scale):
/// the product of its EXPOSURE lines, and for XYZE also of 179. Pixels divided by this scale are in W/sr/m2. XYZE is
/// converted to RGB of BT.2020. RGBE without PRIMARIES is assumed to be BT.709, because nearly every writer except
/// Radiance uses BT.709. Channels are divided by the product of the COLORCORR lines. Values may be 0, and in XYZE also
/// negative.
///
/// # Errors
/// The reason, for other formats, damaged or truncated files, and files that exceed `limits`.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<Contents, String> {
    let mut rest = bytes;
    if !take_line(&mut rest).is_some_and(|l| l.starts_with("#?")) {
        return Err("it does not begin with a complete line such as `#?RADIANCE`; copy it again".into());
    }
    let mut metadata = Metadata::default();
    let mut xyze = false;
    // Factors by which the stored red, green and blue, or X, Y and Z, were multiplied.
    let mut corrections = [Factor::ONE; 3];
    loop {
        let line = take_line(&mut rest).ok_or("it ends within its header; copy it again")?;
        if line.is_empty() {
            break;
        }
        if let Some(comment) = line.strip_prefix("# ") {
            metadata.comments.push(comment.to_owned());
            continue;
        }
        // Lines that begin with a tab belong to the pictures from which this one was made. Their keys match none of
        // the keys below.
        let Some((key, value)) = line.split_once('=') else {
            continue;
        };
        let value = value.trim();
        match key {
            "EXPOSURE" => {
                let factor = value.parse().ok().and_then(Factor::new);
                let all = factor.and_then(|factor| metadata.exposure_scale.times(factor));
                metadata.exposure_scale = all.ok_or_else(|| {
                    format!(
                        "its header has `EXPOSURE={value}`; each EXPOSURE, and its product with those of earlier lines, must be \
                         from 1e-20 to 1e20; correct the header, or write the file again"
                    )
                })?;
            }
            "COLORCORR" => {
                corrections = corrected(corrections, value).ok_or_else(|| {
                    format!(
                        "its header has `COLORCORR={value}`; each COLORCORR must be three numbers, one for each channel; \
                         each, and its product with those of earlier lines, must be from 1e-20 to 1e20; correct the header, \
                         or write the file again"
                    )
                })?;
            }
            "PRIMARIES" => metadata.primaries = primaries(value).ok_or("its PRIMARIES are not eight numbers")?,
            "LENS" => metadata.capture.lens = Some(value.into()),
            "FOCAL_LENGTH_MM" => metadata.capture.focal_length_mm = value.parse().ok(),
            "SHUTTER_S" => metadata.time_s = value.parse().ok(),
            "F_NUMBER" => metadata.f_number = value.parse().ok(),
            "ISO" => metadata.iso = value.parse().ok(),
            "CAMERA" => metadata.capture.model = Some(value.into()),
            "CAPDATE" => metadata.capture.date = Some(value.into()),
            "SOFTWARE" => metadata.software = value.into(),
            "FORMAT" => {
                xyze = value == "32-bit_rle_xyze";
                if !xyze && value != "32-bit_rle_rgbe" {
                    return Err(format!(
                        "its format is {value}; supported are RGBE and XYZE: convert it, for example with `ra_xyze -r`"
                    ));
                }
            }
            _ => {}
        }
    }
    let scan = take_line(&mut rest).and_then(|l| Scan::parse(&l)).ok_or(
        "its resolution line is missing, or not of the form `-Y height +X width` with valid sizes (either sign, in \
         either order)",
    )?;
    // Every scanline takes at least 4 bytes, so the claimed size is checked before memory is reserved.
    if scan.lines.checked_mul(4).is_none_or(|least| least > rest.len()) || scan.length > 1 << 24 {
        return Err(format!("it is too short for {} lines of {} pixels; copy it again", scan.lines, scan.length));
    }
    // Old run lengths can encode millions of pixels in a few bytes, so the limits are checked, too.
    limits.check_size(scan.length, scan.lines)?;
    let count = scan.length * scan.lines;
    limits.check_memory((scan.length, scan.lines), 12 * count as u64 + bytes.len() as u64)?;
    let mut pixels = limits::reserved(count)?;
    let mut row: Vec<Rgbe> = limits::room(scan.length)?;
    let scales = corrections.map(|factor| (1.0 / factor.get()) as f32);
    for y in 0..scan.lines {
        rgbe::take_row(&mut rest, &mut row).ok_or_else(|| format!("it is damaged or truncated at row {y}"))?;
        pixels.extend(row.iter().map(|&p| {
            let [a, b, c] = rgbe::decode(p);
            [a * scales[0], b * scales[1], c * scales[2]]
        }));
    }
    if xyze {
        // XYZ is in cd/m2, so the scale is multiplied by 179. XYZ is converted to RGB of BT.2020, because BT.2020
        // contains nearly all colours that a camera sees.
        let scale = Factor::new(WHITE_EFFICACY).and_then(|white| metadata.exposure_scale.times(white));
        metadata.exposure_scale = scale.ok_or("its EXPOSURE is too large for XYZE")?;
        metadata.primaries = Primaries::BT2020;
        let neutral = NeutralXyz::of(&metadata.primaries);
        pixels.iter_mut().for_each(|p| *p = neutral.to_rgb(*p));
    }
    let pixels = scan.turn.upright(Plane::from_vec(scan.length, scan.lines, pixels));
    Ok(Contents::new(pixels, metadata))
}

/// Returns the next line, without its end, or `None` if there is no complete line.
fn take_line(bytes: &mut &[u8]) -> Option<String> {
    let end = bytes.iter().position(|&b| b == b'\n')?;
    let line = String::from_utf8_lossy(&bytes[..end]).trim_end_matches('\r').to_owned();
    *bytes = &bytes[end + 1..];
    Some(line)
}

/// Returns `factors`, each multiplied by the factor at the same place in `text`; `None` if `text` does not have three
/// valid factors.
fn corrected(factors: [Factor; 3], text: &str) -> Option<[Factor; 3]> {
    let mut words = text.split_whitespace();
    let mut next = |factor: Factor| factor.times(Factor::new(words.next()?.parse().ok()?)?);
    let [a, b, c] = factors;
    let corrected = [next(a)?, next(b)?, next(c)?];
    words.next().is_none().then_some(corrected)
}

fn primaries(text: &str) -> Option<Primaries> {
    let numbers: Vec<f64> = text.split_whitespace().map(str::parse).collect::<Result<_, _>>().ok()?;
    let &[rx, ry, gx, gy, bx, by, wx, wy] = numbers.as_slice() else {
        return None;
    };
    Some(Primaries { red: [rx, ry], green: [gx, gy], blue: [bx, by], white: [wx, wy] })
}

/// Number, length and order of the scanlines.
struct Scan {
    lines: usize,
    length: usize,
    turn: Turn,
}

impl Scan {
    /// Parses the resolution: first the axis from line to line, then the axis along a line. +X points to the right, +Y
    /// up.
    fn parse(line: &str) -> Option<Self> {
        let mut words = line.split_whitespace();
        let words = [words.next()?, words.next()?, words.next()?, words.next()?];
        let (lines, length) = (words[1].parse().ok()?, words[3].parse().ok()?);
        let turn = match (words[0], words[2]) {
            (y @ ("-Y" | "+Y"), x @ ("-X" | "+X")) => {
                Turn { transposed: false, mirrored: x == "-X", flipped: y == "+Y" }
            }
            (x @ ("-X" | "+X"), y @ ("-Y" | "+Y")) => {
                Turn { transposed: true, mirrored: x == "-X", flipped: y == "+Y" }
            }
            _ => return None,
        };
        (lines > 0 && length > 0).then_some(Scan { lines, length, turn })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::merge::RadianceMap;
    use crate::write::hdr::{Encoding, Writer};
    use crate::write::{Pending, commit, push_all};

    fn parsed(bytes: &[u8]) -> Result<(RadianceMap, Metadata), String> {
        parse(bytes, &Limits::default()).map(|Contents { map, metadata, .. }| (map, metadata))
    }

    fn written(picture: &Plane<[f32; 3]>, encoding: Encoding) -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.hdr");
        let size = (picture.width(), picture.height());
        let writer = Writer::new(Pending::create(&path).unwrap(), size, &Metadata::default(), encoding).unwrap();
        commit(vec![push_all(Box::new(writer), picture).unwrap().file], false).unwrap();
        std::fs::read(&path).unwrap()
    }

    /// Reads a file of six pixels, each with its position (x, y) as its value; `line(i, j)` returns the position of
    /// pixel j of line i.
    fn flat(scan: &str, line: impl Fn(usize, usize) -> (u8, u8)) -> Plane<[f32; 3]> {
        let mut bytes = format!("#?RADIANCE\n# a = b\nEXPOSURE=2\n\tEXPOSURE=9\nEXPOSURE= 4 \n\n{scan}\n").into_bytes();
        for i in 0..6 {
            let (x, y) = line(i / 3, i % 3);
            bytes.extend([128 + 10 * x, 128 + 10 * y, 0, 136]);
        }
        let (map, metadata) = parsed(&bytes).unwrap();
        assert_eq!(metadata.exposure_scale.get(), 8.0, "a tab makes it another picture's");
        map.pixels
    }

    #[test]
    fn every_order_of_scanlines_comes_out_upright() {
        type Order = fn(usize, usize) -> (usize, usize);
        let across: [(&str, Order); 4] = [
            ("-Y 2 +X 3", |i, j| (j, i)),
            ("+Y 2 +X 3", |i, j| (j, 1 - i)),
            ("-Y 2 -X 3", |i, j| (2 - j, i)),
            ("+Y 2 -X 3", |i, j| (2 - j, 1 - i)),
        ];
        let down: [(&str, Order); 4] = [
            ("+X 2 -Y 3", |i, j| (i, j)),
            ("-X 2 -Y 3", |i, j| (1 - i, j)),
            ("+X 2 +Y 3", |i, j| (i, 2 - j)),
            ("-X 2 +Y 3", |i, j| (1 - i, 2 - j)),
        ];
        for (orders, width, height) in [(across, 3, 2), (down, 2, 3)] {
            for (scan, place) in orders {
                let plane = flat(scan, |i, j| {
                    let (x, y) = place(i, j);
                    (x as u8, y as u8)
                });
                assert_eq!((plane.width(), plane.height()), (width, height), "{scan}");
                for y in 0..height {
                    for x in 0..width {
                        let [a, b, _] = plane.at(x, y);
                        assert_eq!((a, b), (128.5 + 10.0 * x as f32, 128.5 + 10.0 * y as f32), "{scan} {x} {y}");
                    }
                }
            }
        }
    }

    #[test]
    fn channels_are_divided_by_their_corrections() {
        let pixels = |lines: &str, format: &str| {
            let text = format!("#?RADIANCE\n{lines}FORMAT=32-bit_rle_{format}\n\n-Y 1 +X 2\n");
            let bytes = [text.as_bytes(), &[128, 64, 32, 136, 8, 16, 128, 136]].concat();
            parsed(&bytes).map(|(map, metadata)| (map.pixels, metadata.exposure_scale.get()))
        };
        let [[a, b, c], _] = [0, 1].map(|x| pixels("", "rgbe").unwrap().0.at(x, 0));
        let (corrected, scale) =
            pixels("COLORCORR= 2 1 .5\nEXPOSURE=4\nCOLORCORR=2 2 1\n\tCOLORCORR=9 9 9\n", "rgbe").unwrap();
        assert_eq!((corrected.at(0, 0), scale), ([a / 4.0, b / 2.0, c * 2.0], 4.0));
        // X, Y and Z are divided before the conversion to RGB; three factors of 2 halve the light.
        let (plain, halved) = (pixels("", "xyze").unwrap().0, pixels("COLORCORR=2 2 2\n", "xyze").unwrap().0);
        assert_eq!(halved.as_slice(), plain.as_slice().iter().map(|p| p.map(|v| v / 2.0)).collect::<Vec<_>>());
        for wrong in ["1 2", "1 2 3 4", "1 0 1", "1 nan 1", "1e15 1 1\nCOLORCORR=1e15 1 1", "red"] {
            assert!(pixels(&format!("COLORCORR={wrong}\n"), "rgbe").unwrap_err().contains("COLORCORR"), "{wrong}");
        }
    }

    /// X, Y and Z of about 1 are decoded with errors of at most 1/256, half a step of the mantissa. The three terms of
    /// each row of the matrix to RGB are up to 1.7, so the errors of RGB are at most 3 * 1.7 / 256 = 0.02.
    #[test]
    fn xyze_is_the_same_light() {
        let picture = Plane::filled(40, 3, [0.3, 1.2, 0.7]);
        let (map, metadata) = parsed(&written(&picture, Encoding::Xyze)).unwrap();
        let back = crate::bracket::colour::Conversion::between(&map.primaries, &Primaries::SRGB).unwrap();
        assert!((metadata.exposure_scale.get() - 1.0).abs() < 1e-9);
        for (a, b) in back.apply(map.pixels.at(39, 2)).iter().zip([0.3, 1.2, 0.7]) {
            assert!((a - b).abs() < 0.02, "{a} {b}");
        }
    }

    #[test]
    fn damaged_files_are_refused() {
        let picture = Plane::from_rows(50, 9, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                *p = [0.2, x as f32 * 7.3, (x * y) as f32];
            }
        });
        let bytes = written(&picture, Encoding::Rgbe);
        let start = bytes.windows(6).position(|w| w == b"+X 50\n").unwrap() + 6;
        let text = String::from_utf8_lossy(&bytes[..250]).into_owned();
        let with = |from: &str, to: &str| {
            let mut changed = text.replace(from, to).split("+X 50\n").next().unwrap().as_bytes().to_vec();
            changed.extend_from_slice(b"+X 50\n");
            changed.extend_from_slice(&bytes[start..]);
            parsed(&changed).map(|_| ()).unwrap_err()
        };
        assert!(with("#?RADIANCE", "PF").contains("#?RADIANCE"));
        for beyond in ["0", "-1", "nan", "inf", "1e-300", "1e15\nEXPOSURE=1e15", "bright"] {
            assert!(with("EXPOSURE=1e0", &format!("EXPOSURE={beyond}")).contains("EXPOSURE"), "{beyond}");
        }
        assert!(with("rle_rgbe", "rle_spec").contains("rle_spec"));
        assert!(with("-Y 9", "-Z 9").contains("resolution"));
        assert!(with("-Y 9", "-Y 10").contains("row 9"));
        assert!(with("-Y 9", "-Y 4000000000").contains("too short"));
        assert!(parsed(&bytes[..bytes.len() - 1]).unwrap_err().contains("row 8"));
        assert!(parsed(&bytes[..40]).unwrap_err().contains("header"));
        assert!(parsed(b"#?RADIANCE").unwrap_err().contains("complete line"));
    }
}
