//! Files of other kinds among the photographs, and files with wrong names.

use super::*;
use crate::support::small_jpeg;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::PngEncoder;
use image::{DynamicImage, ExtendedColorType, ImageBuffer, ImageEncoder, ImageFormat};
use img_parts::ImageICC;

/// Writes frames 2 and 3 as JPEGs, and `third` as `name`; returns the names.
fn with_third(third: &[u8], name: &str) -> (Folder, String) {
    let folder = Folder::empty();
    folder.put("f1.jpg", small_jpeg(2));
    folder.put("f2.jpg", small_jpeg(3));
    folder.put(name, third);
    (folder, format!("f1.jpg f2.jpg {name}"))
}

/// Merges frames 2 and 3 with `third`, which must be aligned like frame 4.
fn taken(third: Vec<u8>, name: &str, options: &str) -> Merged {
    let (folder, names) = with_third(&third, name);
    let merged = merged(&folder, &format!("{names} {options} --reference f2.jpg"));
    assert_eq!(merged.status(name), "aligned", "{name}: {:?}", merged.warnings());
    let (folder, names) = with_third(small_jpeg(4), "f3.jpg");
    let plain = super::merged(&folder, &format!("{names} --reference f2.jpg"));
    let (a, b) = (merged.corners(name), plain.corners("f3.jpg"));
    let off = (0..4).map(|i| (a[i][0] - b[i][0]).abs().max((a[i][1] - b[i][1]).abs())).fold(0.0, f64::max);
    assert!(off < 0.5, "{name} is off by {off} px");
    merged
}

fn encoded(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    picture.write_to(&mut bytes, format).expect("encoded");
    bytes.into_inner()
}

fn colour(i: usize) -> DynamicImage {
    DynamicImage::ImageRgb8(frame(i))
}

#[test]
fn grey_frame_is_merged_with_colour_frames() {
    let grey = DynamicImage::ImageLuma8(colour(4).to_luma8());
    let mut file = Vec::new();
    JpegEncoder::new_with_quality(&mut file, 95).encode_image(&grey).expect("a JPEG");
    taken(with_exif_of(4, file), "f3.jpg", "");
    taken(with_exif_of(4, encoded(&grey, ImageFormat::Png)), "f3.png", "");
}

#[test]
fn png_with_any_name_is_merged_with_jpegs() {
    let file = with_exif_of(4, png(&frame(4)));
    let merged = taken(file.clone(), "f3.png", "");
    assert_eq!(merged.frame("f3.png")["exposure_source"], "exif");
    taken(file, "f3.jpg", "");
}

#[test]
fn tiff_is_merged_with_jpegs() {
    let merged = taken(encoded(&colour(4), ImageFormat::Tiff), "f3.tif", "-e=-2,0,2");
    assert!(merged.warnings().is_empty(), "{:?}", merged.warnings());
}

#[test]
fn frame_of_16_bits_is_merged_with_frames_of_8() {
    let wide = DynamicImage::ImageRgb16(colour(4).to_rgb16());
    let merged = taken(encoded(&wide, ImageFormat::Png), "f3.png", "-e=-2,0,2");
    assert!(
        merged.warns(false, &["f1.jpg: it has 8 bits per channel and other frames have 16"]),
        "{:?}",
        merged.warnings()
    );
}

/// A photograph has no background, so alpha is ignored and the colour of transparent pixels is used.
#[test]
fn transparency_is_ignored() {
    let mut holed = colour(4).to_rgba8();
    holed
        .enumerate_pixels_mut()
        .filter(|(x, y, _)| (100..200).contains(x) && (50..150).contains(y))
        .for_each(|(_, _, p)| p.0[3] = 0);
    let opaque = taken(png(&frame(4)), "f3.png", "-e=-2,0,2");
    let holed = taken(encoded(&DynamicImage::ImageRgba8(holed), ImageFormat::Png), "f3.png", "-e=-2,0,2");
    assert_eq!(holed.radiance, opaque.radiance);
}

/// Encodes a PNG with the `png` crate, for kinds of PNG that `image` does not write.
fn packed(
    kind: png::ColorType,
    depth: png::BitDepth,
    palette: Option<Vec<u8>>,
    is_interlaced: bool,
    rows: &[u8],
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut info = png::Info::with_size(300, 200);
    (info.color_type, info.bit_depth, info.interlaced) = (kind, depth, is_interlaced);
    info.palette = palette.map(Into::into);
    let mut writer = png::Encoder::with_info(&mut bytes, info).and_then(png::Encoder::write_header).expect("a header");
    writer.write_image_data(rows).expect("a PNG");
    drop(writer);
    bytes
}

#[test]
fn a_palette_is_looked_up() {
    // The palette has six values of each channel, which is coarse, but enough for alignment.
    let palette: Vec<u8> = (0..216u32).flat_map(|i| [i / 36, i / 6 % 6, i % 6].map(|v| (51 * v) as u8)).collect();
    let level = |v: u8| (u32::from(v) + 25) / 51;
    let rows: Vec<u8> =
        frame(4).pixels().map(|p| (36 * level(p.0[0]) + 6 * level(p.0[1]) + level(p.0[2])) as u8).collect();
    let file = packed(png::ColorType::Indexed, png::BitDepth::Eight, Some(palette), false, &rows);
    taken(file, "f3.png", "-e=-2,0,2");
}

/// Two tones may determine neither the exposure nor the alignment: the frame is aligned or rejected, and the other
/// frames are not affected.
#[test]
fn frame_with_one_bit_per_pixel_does_not_affect_the_others() {
    let grey = colour(4).to_luma8();
    let bit = |x: u32, y: u32| u8::from(x < 300 && grey.get_pixel(x.min(299), y).0[0] > 120);
    let rows: Vec<u8> = (0..200)
        .flat_map(|y| (0..38).map(move |b| (b, y)))
        .map(|(b, y)| (0..8).fold(0, |byte, k| byte << 1 | bit(8 * b + k, y)))
        .collect();
    let file = packed(png::ColorType::Grayscale, png::BitDepth::One, None, false, &rows);
    let (folder, names) = with_third(&file, "f3.png");
    let merged = merged(&folder, &format!("{names} -e=-2,0,2 --reference f2.jpg"));
    assert!(merged.confidence("f1.jpg") > 0.9);
    if merged.status("f3.png") == "rejected" {
        assert!(merged.warns(true, &["f3.png: rejected"]), "{:?}", merged.warnings());
    }
}

/// CMYK without a profile, inverted as Adobe writes it: the colour is the light that the inks do not absorb.
#[test]
fn a_cmyk_jpeg_is_taken_to_rgb() {
    let inks: Vec<u8> = frame(4).pixels().flat_map(|p| [255 - p.0[0], 255 - p.0[1], 255 - p.0[2], 0]).collect();
    let mut file = Vec::new();
    let encoder = jpeg_encoder::Encoder::new(&mut file, 95);
    encoder.encode(&inks, 300, 200, jpeg_encoder::ColorType::Cmyk).expect("a JPEG");
    taken(file, "f3.jpg", "-e=-2,0,2");
}

#[test]
fn different_profile_is_a_warning_and_damaged_one_is_ignored() {
    let with_profile = |profile: Vec<u8>| {
        let mut file = img_parts::jpeg::Jpeg::from_bytes(Bytes::from(small_jpeg(4).to_vec())).expect("a JPEG");
        file.set_icc_profile(Some(profile.into()));
        file.encoder().bytes().to_vec()
    };
    let adobe = moxcms::ColorProfile::new_adobe_rgb().encode().expect("a profile");
    let merged = taken(with_profile(adobe), "f3.jpg", "");
    assert!(
        merged.warns(false, &["f3.jpg: its colour profile", "differs from that of the reference"]),
        "{:?}",
        merged.warnings()
    );
    let merged = taken(with_profile(b"no profile at all".repeat(20)), "f3.jpg", "");
    assert!(merged.warns(false, &["f3.jpg: its colour profile is damaged and was ignored"]), "{:?}", merged.warnings());
}

/// Rotated pixels with the matching EXIF orientation are aligned; unrotated pixels with the same EXIF are not.
#[test]
fn the_exif_orientation_counts() {
    let oriented = |picture: &RgbImage, orientation: u8| {
        let mut exif = img_parts::jpeg::Jpeg::from_bytes(Bytes::from(small_jpeg(4).to_vec()))
            .expect("a JPEG")
            .exif()
            .expect("EXIF")
            .to_vec();
        // The entry of the tag 0x0112: one short integer, in the byte order of the block.
        let is_little = exif.starts_with(b"II");
        let entry: [u8; 8] = if is_little { [0x12, 1, 3, 0, 1, 0, 0, 0] } else { [1, 0x12, 0, 3, 0, 0, 0, 1] };
        let at = exif.windows(8).position(|w| w == entry).expect("an orientation");
        exif[at + if is_little { 8 } else { 9 }] = orientation;
        let mut file = img_parts::jpeg::Jpeg::from_bytes(Bytes::from(jpeg(picture, None))).expect("a JPEG");
        file.set_exif(Some(exif.into()));
        file.encoder().bytes().to_vec()
    };
    taken(oriented(&image::imageops::rotate270(&frame(4)), 6), "f3.jpg", "");
    taken(oriented(&image::imageops::rotate180(&frame(4)), 3), "f3.jpg", "");
    taken(oriented(&frame(4), 77), "f3.jpg", "");
    let (folder, names) = with_third(&oriented(&frame(4), 6), "f3.jpg");
    refused(&folder, &names, &["f3.jpg", "200x300", "EXIF orientation"]);
}

#[test]
fn an_interlaced_png_is_read() {
    // The Adam7 file is written here (seven smaller pictures one after the other), because the `png` crate reads it but
    // does not write it.
    let picture = frame(4);
    let passes = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)];
    let mut rows = Vec::new();
    for (x0, y0, dx, dy) in passes {
        for y in (y0..200).step_by(dy) {
            rows.push(0);
            (x0..300).step_by(dx).for_each(|x| rows.extend(picture.get_pixel(x as u32, y as u32).0));
        }
    }
    let mut data = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    std::io::Write::write_all(&mut data, &rows).expect("deflated");
    let chunk = |kind: &[u8; 4], content: &[u8]| {
        let mut sum = flate2::Crc::new();
        sum.update(kind);
        sum.update(content);
        [&(content.len() as u32).to_be_bytes()[..], kind, content, &sum.sum().to_be_bytes()].concat()
    };
    let header = [&300u32.to_be_bytes()[..], &200u32.to_be_bytes(), &[8, 2, 0, 0, 1]].concat();
    let data = data.finish().expect("deflated");
    let file =
        [b"\x89PNG\r\n\x1a\n".to_vec(), chunk(b"IHDR", &header), chunk(b"IDAT", &data), chunk(b"IEND", b"")].concat();
    let interlaced = taken(file, "f3.png", "-e=-2,0,2");
    let plain = taken(png(&picture), "f3.png", "-e=-2,0,2");
    assert_eq!(interlaced.radiance, plain.radiance);
}

#[test]
fn files_that_are_not_pictures_are_named() {
    let webp = [b"RIFF\x24\0\0\0WEBPVP8L".to_vec(), vec![0; 40]].concat();
    for (content, name, said) in [
        (b"not a photograph".repeat(9), "f3.jpg", "text"),
        (b"<html><body>404 Not Found</body></html>".to_vec(), "f3.jpg", "text"),
        (Vec::new(), "f3.jpg", "empty"),
        (vec![0; 5000], "f3.jpg", "zeros"),
        (webp, "f3.webp", "WebP"),
        (encoded(&colour(4), ImageFormat::Png)[..30_000].to_vec(), "f3.png", "copy the file again"),
        (small_jpeg(4)[..9000].to_vec(), "f3.jpg", "truncated"),
    ] {
        let (folder, names) = with_third(&content, name);
        refused(&folder, &names, &[name, said]);
    }
}

/// Data after the picture, such as thumbnails, videos and notes, have no effect.
#[test]
fn data_after_the_picture_are_ignored() {
    let file = [small_jpeg(4), &b"and a film".repeat(1000)[..]].concat();
    taken(file, "f3.jpg", "");
}

#[test]
fn grey_16_bit_png_with_alpha_is_read() {
    let grey = colour(4).to_luma8();
    let pixels: Vec<u16> = grey.pixels().flat_map(|p| [257 * u16::from(p.0[0]), 30_000]).collect();
    let picture: ImageBuffer<image::LumaA<u16>, Vec<u16>> = ImageBuffer::from_raw(300, 200, pixels).expect("a picture");
    let file = encoded(&DynamicImage::ImageLumaA16(picture), ImageFormat::Png);
    taken(file, "f3.png", "-e=-2,0,2");
    let mut eight = Vec::new();
    PngEncoder::new(&mut eight).write_image(grey.as_raw(), 300, 200, ExtendedColorType::L8).expect("a PNG");
    taken(eight, "f3.png", "-e=-2,0,2");
}
