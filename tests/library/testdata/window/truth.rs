//! The truth about the bracket, written and read: `truth.json`, and `truth.hdr`, the radiance of the reference frame at
//! a quarter of its size as a Radiance picture.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::camera;
use super::motion::{HANDS, Matrix, homography};
use super::scene::{HEIGHT, WIDTH};
use super::vec3::{V3, v3};

/// Number of frame pixels per pixel of `truth.hdr`, along each side.
pub const QUARTER: usize = 4;

/// Returns the folder of the bracket.
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/window")
}

/// Returns the content of `truth.json`.
pub fn describe() -> Value {
    let inverse: Vec<f64> = (0..256).map(|v| camera::inverse_response(f64::from(v) / 255.0)).collect();
    let frames: Vec<Value> = (0..camera::TIMES.len())
        .map(|i| {
            json!({
                "file": camera::file_name(i),
                "exposure": camera::seconds(i),
                "homography": homography(&HANDS[i]),
                "is_reference": i == camera::REFERENCE,
            })
        })
        .collect();
    json!({
        "kind": "handheld",
        "scene": "window",
        "width": WIDTH,
        "height": HEIGHT,
        "ev_step": 2.0,
        "f_number": camera::F_NUMBER,
        "iso": camera::ISO,
        "frames": frames,
        "homography_convention": "reference pixel -> frame pixel; x right, y down, (0, 0) the centre of the top-left pixel",
        "response": camera::FORMULA,
        "inverse_response": inverse,
        "full_well": camera::FULL_WELL,
        "read_noise": camera::READ_NOISE,
        "saturation_cd_s_per_m2": camera::SATURATION,
        "radiance": {
            "file": "truth.hdr",
            "units": "cd/m2 for each of linear Rec. 709 R, G, B: 0.2126 R + 0.7152 G + 0.0722 B is the luminance",
            "exposure": "X = L * exposure / saturation_cd_s_per_m2",
            "frame_pixels_per_pixel": QUARTER,
        },
    })
}

/// Reads a homography from a value of `truth.json`.
pub fn matrix(v: &Value) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| v[i][j].as_f64().expect("a number in the homography")))
}

/// Returns the means of blocks of `side` x `side` pixels.
pub fn shrink(pixels: &[V3], width: usize, side: usize) -> Vec<V3> {
    let (w, h) = (width / side, pixels.len() / width / side);
    (0..w * h)
        .map(|k| {
            let (x, y) = (k % w * side, k / w * side);
            let sum = (0..side * side).fold(V3::ZERO, |s, q| s + pixels[(y + q / side) * width + x + q % side]);
            sum / (side * side) as f32
        })
        .collect()
}

/// Returns a Radiance picture (RGBE, run-length coded), whose EXPOSURE declares that the values are in cd/m2.
pub fn write_hdr(pixels: &[V3], width: usize) -> Vec<u8> {
    // The unit of Radiance is W/(sr m2); 1 in each channel is 179 cd/m2. EXPOSURE=179 declares that the values are 179
    // times those in W/(sr m2).
    let mut out = format!(
        "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=179\nSOFTWARE=hdralign tests/window\n\n-Y {} +X {width}\n",
        pixels.len() / width
    )
    .into_bytes();
    for row in pixels.chunks(width) {
        out.extend([2, 2, (width >> 8) as u8, width as u8]);
        let coded: Vec<[u8; 4]> = row.iter().map(|&p| rgbe(p)).collect();
        for channel in 0..4 {
            let bytes: Vec<u8> = coded.iter().map(|c| c[channel]).collect();
            let mut i = 0;
            while i < bytes.len() {
                let run = |k: usize| bytes[k..].iter().take(127).take_while(|&&b| b == bytes[k]).count();
                if run(i) >= 4 {
                    out.extend([128 + run(i) as u8, bytes[i]]);
                    i += run(i);
                } else {
                    let from = i;
                    while i < bytes.len() && i - from < 128 && run(i) < 4 {
                        i += 1;
                    }
                    out.push((i - from) as u8);
                    out.extend(&bytes[from..i]);
                }
            }
        }
    }
    out
}

fn rgbe(p: V3) -> [u8; 4] {
    let top = p.x.max(p.y).max(p.z);
    if top < 1e-30 {
        return [0; 4];
    }
    // Mantissas are rounded half up; if the largest would round to 256, the exponent is one more.
    let mut e = top.log2().floor() as i32 + 1;
    if (top * 2f32.powi(8 - e) + 0.5) as i32 > 255 {
        e += 1;
    }
    let scale = 2f32.powi(8 - e);
    let byte = |v: f32| (v * scale + 0.5) as u8;
    [byte(p.x), byte(p.y), byte(p.z), (e + 128) as u8]
}

/// Reads the pixels and the width of a picture that [`write_hdr`] wrote.
pub fn read_hdr(bytes: &[u8]) -> (Vec<V3>, usize) {
    let end = bytes.windows(2).position(|w| w == b"\n\n").expect("the end of the header") + 2;
    let line = end + bytes[end..].iter().position(|&b| b == b'\n').expect("a resolution line");
    let words: Vec<&str> = std::str::from_utf8(&bytes[end..line]).expect("ASCII").split(' ').collect();
    let (height, width): (usize, usize) = (words[1].parse().expect("height"), words[3].parse().expect("width"));
    let mut rest = bytes[line + 1..].iter().copied();
    let mut take = || rest.next().expect("more of the picture");
    let mut pixels = Vec::with_capacity(width * height);
    for _ in 0..height {
        assert_eq!([take(), take()], [2, 2], "a run-length coded row");
        assert_eq!(usize::from(take()) << 8 | usize::from(take()), width);
        let mut row = vec![[0u8; 4]; width];
        for channel in 0..4 {
            let mut i = 0;
            while i < width {
                let n = take();
                let (count, same) = if n > 128 { (n - 128, Some(take())) } else { (n, None) };
                for _ in 0..count {
                    row[i][channel] = same.unwrap_or_else(&mut take);
                    i += 1;
                }
            }
        }
        pixels.extend(row.iter().map(|c| {
            let scale = 2f32.powi(i32::from(c[3]) - 136);
            v3(f32::from(c[0]), f32::from(c[1]), f32::from(c[2])) * if c[3] == 0 { 0.0 } else { scale }
        }));
    }
    (pixels, width)
}
