//! Pictures in the page: JPEG and PNG files as `data:` addresses.
//!
//! In: pixels. Out: [`Picture`]s. Cost: some 30 ns a pixel. Source: RFC 2397 (data URLs), RFC 4648 section 4 (base64).

use crate::plane::Plane;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};
use png::{BitDepth, ColorType, Compression, Encoder};

/// A picture that a page can show without asking anybody.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Picture {
    pub address: String,
    pub width: usize,
    pub height: usize,
}

/// `pixels` as JPEG of `quality` 1..=100, in the colours of the profile `icc`; of sRGB where there is none.
pub(super) fn jpeg(pixels: &Plane<[u8; 3]>, quality: u8, icc: Option<&[u8]>) -> Result<Picture, String> {
    let bytes = pixels.as_slice().as_flattened();
    encode((pixels.width(), pixels.height()), bytes, ExtendedColorType::Rgb8, quality, icc)
}

/// `grey` as JPEG of `quality` 1..=100.
pub(super) fn grey_jpeg(grey: &Plane<u8>, quality: u8) -> Result<Picture, String> {
    encode((grey.width(), grey.height()), grey.as_slice(), ExtendedColorType::L8, quality, None)
}

fn encode(
    size: (usize, usize),
    bytes: &[u8],
    colour: ExtendedColorType,
    quality: u8,
    icc: Option<&[u8]>,
) -> Result<Picture, String> {
    let mut file = Vec::new();
    let mut encoder = JpegEncoder::new_with_quality(&mut file, quality);
    if let Some(icc) = icc {
        encoder.set_icc_profile(icc.to_vec()).map_err(|e| e.to_string())?;
    }
    let (width, height) = (side(size.0)?, side(size.1)?);
    encoder.write_image(bytes, width, height, colour).map_err(|e| e.to_string())?;
    Ok(picture("jpeg", size, &file))
}

/// A picture in at most four colours, two bits a pixel, as PNG.
pub(super) fn four_colours(indices: &Plane<u8>, palette: &[[u8; 3]; 4]) -> Result<Picture, String> {
    let (width, height) = (indices.width(), indices.height());
    let mut packed = vec![0u8; width.div_ceil(4) * height];
    for (y, row) in packed.chunks_exact_mut(width.div_ceil(4)).enumerate() {
        for (x, &index) in indices.row(y).iter().enumerate() {
            row[x / 4] |= (index & 3) << (6 - 2 * (x % 4));
        }
    }
    let mut file = Vec::new();
    let mut encoder = Encoder::new(&mut file, side(width)?, side(height)?);
    encoder.set_color(ColorType::Indexed);
    encoder.set_depth(BitDepth::Two);
    encoder.set_palette(palette.as_flattened().to_vec());
    encoder.set_compression(Compression::High);
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    writer.write_image_data(&packed).map_err(|e| e.to_string())?;
    writer.finish().map_err(|e| e.to_string())?;
    Ok(picture("png", (width, height), &file))
}

fn side(pixels: usize) -> Result<u32, String> {
    u32::try_from(pixels).map_err(|e| e.to_string())
}

fn picture(format: &str, (width, height): (usize, usize), file: &[u8]) -> Picture {
    Picture { address: format!("data:image/{format};base64,{}", STANDARD.encode(file)), width, height }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(picture: &Picture) -> image::DynamicImage {
        let (_, data) = picture.address.split_once(";base64,").unwrap();
        image::load_from_memory(&STANDARD.decode(data).unwrap()).unwrap()
    }

    #[test]
    fn pictures_are_read_back() {
        let ramp = Plane::from_rows(40, 30, |y, row: &mut [[u8; 3]]| {
            row.iter_mut().enumerate().for_each(|(x, p)| *p = [(5 * x) as u8, (7 * y) as u8, 90]);
        });
        let back = decoded(&jpeg(&ramp, 90, Some(b"a profile")).unwrap()).to_rgb8();
        // JPEG at this quality is within some codes on a ramp.
        let worst = back.as_raw().iter().zip(ramp.as_slice().as_flattened()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst.unwrap() < 16, "{worst:?}");
        let grey = Plane::from_rows(9, 4, |_, row| row.iter_mut().enumerate().for_each(|(x, v)| *v = 20 * x as u8));
        assert_eq!(decoded(&grey_jpeg(&grey, 80).unwrap()).color(), image::ColorType::L8);
    }

    #[test]
    fn four_colours_are_exact() {
        let palette = [[1, 2, 3], [250, 251, 252], [200, 100, 0], [0, 0, 255]];
        let indices = Plane::from_rows(11, 3, |y, row| (0..11).for_each(|x| row[x] = ((x + y) % 4) as u8));
        let back = decoded(&four_colours(&indices, &palette).unwrap()).to_rgb8();
        let wanted: Vec<u8> = indices.as_slice().iter().flat_map(|&i| palette[usize::from(i)]).collect();
        assert_eq!(back.as_raw(), &wanted);
    }
}
