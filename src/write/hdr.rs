//! Radiance `.hdr`: RGBE pixels under a text header.
//!
//! In: linear RGB by rows. Out: a file that `evalglare`, `pcomb` and `pfilt` read with the right units: pixels are W/sr/m2 times
//! EXPOSURE, so that luminance = 179 (0.2126 R + 0.7152 G + 0.0722 B) / EXPOSURE. [`read`] is the way back. Cost: 25 ns a pixel and core
//! and 3 to 4 bytes. Source: "Radiance File Formats" (Ward, LBNL), "Picture Format"; `src/common/header.c`, `color.c`.

use super::rgbe::{self, Rgbe};
use super::{Bands, Metadata, Pending, RowWriter, Written, clamped, one_line};
use crate::bracket::colour::Primaries;
use crate::error::{Error, Result};
use crate::merge::RadianceMap;
use crate::plane::Plane;
use std::path::Path;

/// Lumens per watt of Radiance's white, by definition.
pub const WHITE_EFFICACY: f64 = 179.0;

/// The `.hdr` writer.
#[derive(Debug)]
pub struct Writer {
    file: Pending,
    bands: Bands<[f32; 3]>,
    over: u64,
}

impl Writer {
    /// Writes the header of a picture of `size` pixels; rows of linear RGB follow.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn new(mut file: Pending, size: (usize, usize), metadata: &Metadata) -> Result<Self> {
        file.put(header(size, metadata).as_bytes())?;
        Ok(Writer { file, bands: Bands::new(size), over: 0 })
    }
}

impl RowWriter<[f32; 3]> for Writer {
    fn push(&mut self, rows: &[[f32; 3]]) -> Result<()> {
        let Writer { file, bands, over } = self;
        let width = bands.width;
        bands.push(
            rows,
            |_, pixels| encode_band(pixels, width),
            |(bytes, beyond)| {
                *over += beyond;
                file.put(&bytes)
            },
        )
    }

    fn finish(self: Box<Self>) -> Result<Written> {
        self.bands.complete().map_err(|e| self.file.error(e))?;
        let warnings = clamped(&self.file, self.over, "are above 1.7e38 and were written as that");
        Ok(Written { file: self.file, warnings })
    }
}

fn encode_band(pixels: &[[f32; 3]], width: usize) -> (Vec<u8>, u64) {
    let mut out = Vec::with_capacity(pixels.len() * 4);
    let mut over = 0;
    let mut row: Vec<Rgbe> = Vec::with_capacity(width);
    for rgb in pixels.chunks_exact(width) {
        row.clear();
        row.extend(rgb.iter().map(|&p| {
            let (rgbe, beyond) = rgbe::encode(p);
            over += beyond;
            rgbe
        }));
        rgbe::put_row(&row, &mut out);
    }
    (out, over)
}

/// The header, the blank line and the resolution.
fn header((width, height): (usize, usize), metadata: &Metadata) -> String {
    let mut lines = vec!["#?RADIANCE".to_owned()];
    lines.extend(metadata.comments.iter().map(|c| format!("# {}", one_line(c))));
    lines.push(format!("SOFTWARE={}", one_line(&metadata.software)));
    lines.extend(metadata.camera().map(|c| format!("CAMERA={c}")));
    let date = metadata.capture.date.as_deref().map(one_line);
    lines.extend(date.map(|d| format!("CAPDATE= {d}")));
    // At column 0 and once: evalglare exits on a tab before it, and every further one would multiply.
    lines.push(format!("EXPOSURE={:e}", exposure(metadata)));
    let Primaries { red, green, blue, white } = metadata.primaries;
    let xy = [red, green, blue, white].map(|[x, y]| format!(" {x:.4} {y:.4}"));
    lines.push(format!("PRIMARIES={}", xy.concat()));
    lines.push("FORMAT=32-bit_rle_rgbe".into());
    format!("{}\n\n-Y {height} +X {width}\n", lines.join("\n"))
}

/// What divides a stored pixel to give W/sr/m2. Radiance (1, 1, 1) is `cd_m2_per_unit` / 179 W/sr/m2 where calibrated, else 1.
fn exposure(metadata: &Metadata) -> f64 {
    let watts_per_unit = metadata.cd_m2_per_unit.map_or(1.0, |l| l / WHITE_EFFICACY);
    metadata.exposure_scale / watts_per_unit
}

/// The picture in a `.hdr` file, as stored, and its [`exposure_scale`](Metadata::exposure_scale): what its EXPOSURE lines multiply to.
/// Without PRIMARIES it is taken for BT.709, as nearly every writer but Radiance means it. Values may be 0.
///
/// # Errors
/// [`Error::Read`]; [`Error::Decode`] for what is no such file, is cut short, or holds XYZE or turned pixels.
pub fn read(path: &Path) -> Result<(RadianceMap, Metadata)> {
    let bytes = std::fs::read(path).map_err(|source| Error::Read { path: path.to_owned(), source })?;
    parse(&bytes).map_err(|reason| Error::Decode { path: path.to_owned(), format: "Radiance HDR", reason })
}

fn parse(bytes: &[u8]) -> std::result::Result<(RadianceMap, Metadata), String> {
    let mut rest = bytes;
    if !take_line(&mut rest).is_some_and(|l| l.starts_with("#?")) {
        return Err("it does not begin with #?RADIANCE; it is some other format".into());
    }
    let mut metadata = Metadata::default();
    loop {
        let line = take_line(&mut rest).ok_or("it ends within its header; copy it again")?;
        if line.is_empty() {
            break;
        }
        // Lines that begin with a tab are those of the pictures this one was made of.
        let Some((key, value)) = line.split_once('=') else {
            continue;
        };
        let value = value.trim();
        match key {
            "EXPOSURE" => {
                let factor: f64 = value.parse().unwrap_or(f64::NAN);
                if !(factor.is_finite() && factor > 0.0) {
                    return Err(format!("its EXPOSURE is `{value}`, not a positive number"));
                }
                metadata.exposure_scale *= factor;
            }
            "PRIMARIES" => metadata.primaries = primaries(value).ok_or("its PRIMARIES are not eight numbers")?,
            "CAMERA" => metadata.capture.model = Some(value.into()),
            "CAPDATE" => metadata.capture.date = Some(value.into()),
            "SOFTWARE" => metadata.software = value.into(),
            "FORMAT" if value != "32-bit_rle_rgbe" => {
                return Err(format!("its format is {value}; make it RGB first, as with `ra_xyze -r`"));
            }
            _ => {}
        }
    }
    let (width, height) = take_line(&mut rest)
        .and_then(|l| resolution(&l))
        .ok_or("its resolution is not of the form `-Y height +X width`; turn it upright first, as with `protate`")?;
    // A scanline takes 4 bytes at least (old repetitions, 8 pixels and more): an absurd size must not be believed before it is filled.
    if height.checked_mul(4).is_none_or(|least| least > rest.len()) || width > 1 << 24 {
        return Err(format!("it is too short for {width}x{height} pixels; copy it again"));
    }
    let mut pixels = Vec::new();
    let mut row: Vec<Rgbe> = vec![[0; 4]; width];
    for y in 0..height {
        rgbe::take_row(&mut rest, &mut row).ok_or_else(|| format!("it is damaged or cut short at row {y}"))?;
        pixels.extend(row.iter().map(|&p| rgbe::decode(p)));
    }
    let map = RadianceMap { pixels: Plane::from_vec(width, height, pixels), primaries: metadata.primaries };
    Ok((map, metadata))
}

/// The next line, without its end; `None` where there is no whole line.
fn take_line(bytes: &mut &[u8]) -> Option<String> {
    let end = bytes.iter().position(|&b| b == b'\n')?;
    let line = String::from_utf8_lossy(&bytes[..end]).trim_end_matches('\r').to_owned();
    *bytes = &bytes[end + 1..];
    Some(line)
}

fn primaries(text: &str) -> Option<Primaries> {
    let numbers: Vec<f64> = text.split_whitespace().map(str::parse).collect::<std::result::Result<_, _>>().ok()?;
    let &[rx, ry, gx, gy, bx, by, wx, wy] = numbers.as_slice() else {
        return None;
    };
    Some(Primaries { red: [rx, ry], green: [gx, gy], blue: [bx, by], white: [wx, wy] })
}

fn resolution(line: &str) -> Option<(usize, usize)> {
    let mut words = line.split_whitespace();
    let words = [words.next()?, words.next()?, words.next()?, words.next()?];
    let (width, height) = (words[3].parse().ok()?, words[1].parse().ok()?);
    ((words[0], words[2]) == ("-Y", "+X") && width > 0 && height > 0).then_some((width, height))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::Capture;
    use crate::error::Warning;
    use crate::write::{commit, push_all};

    fn picture(width: usize, height: usize) -> Plane<[f32; 3]> {
        Plane::from_rows(width, height, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let v = ((x * 7919 + y * 104_729) % 1000) as f32 + 0.25;
                *p = if x / 40 % 2 == 0 { [1.5, 0.75, 0.1] } else { [v, v * v / 50.0, 1.0 / v] };
            }
        })
    }

    fn written(picture: &Plane<[f32; 3]>, metadata: &Metadata) -> (Vec<u8>, Vec<Warning>) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.hdr");
        let size = (picture.width(), picture.height());
        let writer = Writer::new(Pending::create(&path).unwrap(), size, metadata).unwrap();
        let whole = push_all(Box::new(writer), picture).unwrap();
        commit(vec![whole.file], false).unwrap();
        (std::fs::read(&path).unwrap(), whole.warnings)
    }

    #[test]
    fn the_header_is_to_the_letter() {
        let metadata = Metadata {
            software: "hdralign 1.2.3".into(),
            capture: Capture {
                make: Some("Canon".into()),
                model: Some("Canon EOS 5D".into()),
                date: Some("2009:07:11 12:34:56".into()),
                ..Capture::default()
            },
            exposure_scale: 0.5,
            ..Metadata::default()
        };
        let golden = "#?RADIANCE\nSOFTWARE=hdralign 1.2.3\nCAMERA=Canon EOS 5D\nCAPDATE= 2009:07:11 12:34:56\nEXPOSURE=5e-1\n\
            PRIMARIES= 0.6400 0.3300 0.3000 0.6000 0.1500 0.0600 0.3127 0.3290\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 3\n";
        assert_eq!(header((3, 2), &metadata), golden);
        let (bytes, _) = written(&Plane::filled(3, 2, [1.0, 0.5, 0.25]), &metadata);
        assert_eq!(bytes, [golden.as_bytes(), &[128, 64, 32, 129].repeat(6)].concat());
    }

    /// A stored white must mean `cd_m2_per_unit` over the scale: 179 * 1 / EXPOSURE.
    #[test]
    fn calibrated_luminance_is_in_the_exposure() {
        let metadata = Metadata {
            cd_m2_per_unit: Some(358.0),
            exposure_scale: 4.0,
            comments: vec!["one\ntwo".into()],
            ..Metadata::default()
        };
        let (bytes, _) = written(&Plane::filled(8, 1, [1.0; 3]), &metadata);
        let (map, back) = parse(&bytes).unwrap();
        assert_eq!(map.pixels.at(0, 0), [128.5 / 128.0; 3]);
        assert_eq!(WHITE_EFFICACY / back.exposure_scale, 358.0 / 4.0);
        assert!(bytes.starts_with(b"#?RADIANCE\n# one two\nSOFTWARE="));
    }

    /// The `image` crate decodes to mantissa * 2^(exponent - 136), without the half: ours must be that and half a step of the pixel.
    #[test]
    fn another_decoder_reads_the_same_pixels() {
        use image::ImageDecoder;
        for (width, height) in [(7, 3), (8, 70), (513, 130), (32768, 2)] {
            let picture = picture(width, height);
            let (bytes, warnings) = written(&picture, &Metadata::default());
            assert_eq!(warnings, []);
            let decoder = image::codecs::hdr::HdrDecoder::new(std::io::Cursor::new(&bytes)).unwrap();
            let mut theirs = vec![0; decoder.total_bytes() as usize];
            decoder.read_image(&mut theirs).unwrap();
            let ours = parse(&bytes).unwrap().0.pixels;
            for ((p, q), t) in picture.as_slice().iter().zip(ours.as_slice()).zip(theirs.chunks_exact(12)) {
                let (rgbe, _) = rgbe::encode(*p);
                let step = libm::ldexpf(1.0, i32::from(rgbe[3]) - 136);
                for c in 0..3 {
                    let t = f32::from_ne_bytes(t[4 * c..4 * c + 4].try_into().unwrap());
                    assert_eq!((t, q[c]), (f32::from(rgbe[c]) * step, t + 0.5 * step));
                }
            }
        }
    }

    #[test]
    fn the_bytes_are_the_same_on_any_number_of_threads() {
        let picture = picture(100, 64 * 20 + 3);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| written(&picture, &Metadata::default()).0)
        };
        assert!(on(1) == on(2) && on(1) == on(7));
    }

    #[test]
    fn overflow_is_told() {
        let (_, warnings) = written(&Plane::filled(9, 1, [f32::MAX, 1.0, 1.0]), &Metadata::default());
        assert!(matches!(&warnings[..], [Warning::OutOfRange { detail, .. }] if detail.starts_with("9 values")));
    }

    #[test]
    fn damaged_files_are_refused() {
        let (bytes, _) = written(&picture(50, 9), &Metadata::default());
        let text = String::from_utf8_lossy(&bytes[..250]).into_owned();
        let with = |from: &str, to: &str| {
            let mut changed = text.replace(from, to).split("+X 50\n").next().unwrap().as_bytes().to_vec();
            changed.extend_from_slice(b"+X 50\n");
            changed.extend_from_slice(&bytes[header((50, 9), &Metadata::default()).len()..]);
            parse(&changed).map(|_| ()).unwrap_err()
        };
        assert!(with("#?RADIANCE", "PF").contains("#?RADIANCE"));
        assert!(with("EXPOSURE=1e0", "EXPOSURE=0").contains("EXPOSURE"));
        assert!(with("rle_rgbe", "rle_xyze").contains("xyze"));
        assert!(with("-Y 9", "+Y 9").contains("upright"));
        assert!(with("-Y 9", "-Y 10").contains("row 9"));
        assert!(with("-Y 9", "-Y 4000000000").contains("too short"));
        assert!(parse(&bytes[..bytes.len() - 1]).unwrap_err().contains("row 8"));
        assert!(parse(&bytes[..40]).unwrap_err().contains("header"));
    }
}
