//! Pictures in reports: PNG and JPEG files in memory, and as `data:` URLs.
//!
//! In: pixels. Out: files, and [`Picture`]s for a page. Cost: about 30 ns per pixel; for JPEG, 30 ns for each quality
//! that is tried. JPEG files are encoded by the `jpeg-encoder` crate, with chroma at half the resolution and with
//! optimised Huffman tables, which make files a fourth smaller. Source: ITU-T T.81 (JPEG); RFC 2397 (data URLs), RFC
//! 4648 section 4 (base64).

use crate::plane::Plane;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use jpeg_encoder::{ColorType as JpegColour, Encoder as Jpeg, SamplingFactor};
use png::{BitDepth, ColorType, Compression, Encoder, EncodingError};
use rayon::prelude::*;

/// JPEG qualities that are tried in this order until the pictures are small enough.
const QUALITIES: [u8; 6] = [86, 80, 74, 66, 58, 48];

/// A picture that is embedded in a page.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// The file as a `data:` URL.
    pub address: String,
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
}

/// A photograph to be encoded, with its ICC profile.
pub struct Photograph {
    /// The pixels.
    pub pixels: Plane<[u8; 3]>,
    /// The ICC profile; `None` for sRGB.
    pub icc: Option<Vec<u8>>,
}

/// Encodes `pixels` as JPEG of `quality` 1..=100, with the profile `icc`; `None` for sRGB.
pub fn jpeg(pixels: &Plane<[u8; 3]>, quality: u8, icc: Option<&[u8]>) -> Result<Picture, String> {
    let bytes = pixels.as_slice().as_flattened();
    encode((pixels.width(), pixels.height()), bytes, JpegColour::Rgb, quality, icc)
}

/// Encodes `grey` as JPEG of `quality` 1..=100.
pub fn grey_jpeg(grey: &Plane<u8>, quality: u8) -> Result<Picture, String> {
    encode((grey.width(), grey.height()), grey.as_slice(), JpegColour::Luma, quality, None)
}

/// Encodes `photographs` as JPEG, with the best of [`QUALITIES`] at which all photographs together take at most
/// `most` bytes of the page, or with the lowest quality if none is small enough.
pub fn jpegs_within(most: usize, photographs: &[Photograph]) -> Result<Vec<Picture>, String> {
    let mut encoded = Vec::new();
    for quality in QUALITIES {
        let all = photographs.par_iter().map(|one| jpeg(&one.pixels, quality, one.icc.as_deref()));
        encoded = all.collect::<Result<Vec<_>, _>>()?;
        if encoded.iter().map(|picture| picture.address.len()).sum::<usize>() <= most {
            break;
        }
    }
    Ok(encoded)
}

fn encode(
    size: (usize, usize),
    bytes: &[u8],
    colour: JpegColour,
    quality: u8,
    icc: Option<&[u8]>,
) -> Result<Picture, String> {
    let mut file = Vec::new();
    let mut encoder = Jpeg::new(&mut file, quality);
    encoder.set_sampling_factor(SamplingFactor::F_2_2);
    encoder.set_optimized_huffman_tables(true);
    if let Some(icc) = icc {
        encoder.add_icc_profile(icc).map_err(|e| e.to_string())?;
    }
    let side = |pixels: usize| u16::try_from(pixels).map_err(|e| e.to_string());
    encoder.encode(bytes, side(size.0)?, side(size.1)?, colour).map_err(|e| e.to_string())?;
    Ok(picture("jpeg", size, &file))
}

/// Encodes a picture with the colours of `palette` (red, green, blue and opacity) as PNG, with two bits per pixel for
/// up to four colours and four bits per pixel for up to 16 colours.
pub fn paletted(indices: &Plane<u8>, palette: &[[u8; 4]]) -> Result<Picture, String> {
    let size = (indices.width(), indices.height());
    let (depth, bits) = if palette.len() <= 4 { (BitDepth::Two, 2) } else { (BitDepth::Four, 4) };
    let rows = (0..size.1).map(|y| indices.row(y).iter().copied());
    let file = png(size, ColorType::Indexed, depth, &packed(rows, bits), |encoder| {
        encoder.set_palette(palette.iter().flat_map(|[r, g, b, _]| [*r, *g, *b]).collect::<Vec<u8>>());
        if palette.iter().any(|colour| colour[3] < u8::MAX) {
            encoder.set_trns(palette.iter().map(|colour| colour[3]).collect::<Vec<u8>>());
        }
        encoder.set_compression(Compression::High);
        Ok(())
    })?;
    Ok(picture("png", size, &file))
}

/// Encodes `plane` as a PNG file in grey.
pub fn png_grey(plane: &Plane<u8>) -> Result<Vec<u8>, String> {
    png((plane.width(), plane.height()), ColorType::Grayscale, BitDepth::Eight, plane.as_slice(), drawn)
}

/// Encodes `plane` as a PNG file in colour.
pub fn png_rgb(plane: &Plane<[u8; 3]>) -> Result<Vec<u8>, String> {
    png((plane.width(), plane.height()), ColorType::Rgb, BitDepth::Eight, plane.as_slice().as_flattened(), drawn)
}

/// Encodes a bitmap of `size` pixels as a PNG file with one bit per pixel: white where `is_set`.
pub fn png_bits(size: (usize, usize), is_set: impl Fn(usize, usize) -> bool) -> Result<Vec<u8>, String> {
    let rows = (0..size.1).map(|y| (0..size.0).map(move |x| (x, y)).map(|(x, y)| u8::from(is_set(x, y))));
    png(size, ColorType::Grayscale, BitDepth::One, &packed(rows, 1), drawn)
}

/// Packs rows of values of `bits` bits each; the first value is in the highest bits of a byte, and every row starts
/// with a new byte.
fn packed<R: Iterator<Item = u8>>(rows: impl Iterator<Item = R>, bits: usize) -> Vec<u8> {
    let byte = |values: &[u8]| {
        values.iter().zip((0..8).step_by(bits)).fold(0, |byte, (value, from)| byte | value << (8 - bits - from))
    };
    rows.flat_map(|row| row.collect::<Vec<u8>>().chunks(8 / bits).map(byte).collect::<Vec<u8>>()).collect()
}

/// Sets the options for drawings: fast compression, and the name of the program in the file. By this name, `batch`
/// recognises that the drawing is not a photograph.
fn drawn(encoder: &mut Encoder<&mut Vec<u8>>) -> Result<(), EncodingError> {
    encoder.set_compression(Compression::Fast);
    encoder.add_text_chunk("Software".into(), concat!("hdralign ", env!("CARGO_PKG_VERSION")).into())
}

fn png(
    size: (usize, usize),
    colour: ColorType,
    depth: BitDepth,
    data: &[u8],
    set: impl FnOnce(&mut Encoder<&mut Vec<u8>>) -> Result<(), EncodingError>,
) -> Result<Vec<u8>, String> {
    let side = |n: usize| u32::try_from(n).map_err(|e| e.to_string());
    let (width, height) = (side(size.0)?, side(size.1)?);
    let mut file = Vec::new();
    let encode = |file| -> Result<(), EncodingError> {
        let mut encoder = Encoder::new(file, width, height);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        set(&mut encoder)?;
        let mut writer = encoder.write_header()?;
        writer.write_image_data(data)?;
        writer.finish()
    };
    encode(&mut file).map_err(|e| e.to_string())?;
    Ok(file)
}

fn picture(format: &str, (width, height): (usize, usize), file: &[u8]) -> Picture {
    Picture { address: data_url(format, file), width, height }
}

/// Returns a file of the image `format` as a `data:` URL.
pub(super) fn data_url(format: &str, file: &[u8]) -> String {
    format!("data:image/{format};base64,{}", STANDARD.encode(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoded(picture: &Picture) -> image::DynamicImage {
        let (_, data) = picture.address.split_once(";base64,").unwrap();
        image::load_from_memory(&STANDARD.decode(data).unwrap()).unwrap()
    }

    /// Returns colours that change slowly, with some noise.
    fn ramp((width, height): (usize, usize)) -> Plane<[u8; 3]> {
        Plane::from_rows(width, height, |y, row: &mut [[u8; 3]]| {
            row.iter_mut().enumerate().for_each(|(x, p)| {
                let grain = (x * 37 + y * 91) % 5;
                *p = [(x * 190 / width + grain) as u8, (y * 200 / height + grain) as u8, 90];
            });
        })
    }

    #[test]
    fn pictures_are_read_back() {
        let ramp = ramp((41, 30));
        let encoded = jpeg(&ramp, 90, Some(b"a profile")).unwrap();
        assert_eq!((encoded.width, encoded.height), (41, 30));
        // The crate `image` is not used here: in small pictures of odd size, it decodes half-resolution chroma
        // wrongly.
        let file = STANDARD.decode(encoded.address.split_once(";base64,").unwrap().1).unwrap();
        let back = jpeg_decoder::Decoder::new(&file[..]).decode().unwrap();
        // The tolerance is 20 code values, because JPEG at this quality with half-resolution chroma changes a ramp a
        // little.
        let worst = back.iter().zip(ramp.as_slice().as_flattened()).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst.unwrap() < 20, "{worst:?}");
        let grey = Plane::from_rows(9, 4, |_, row| row.iter_mut().enumerate().for_each(|(x, v)| *v = 20 * x as u8));
        assert_eq!(decoded(&grey_jpeg(&grey, 80).unwrap()).color(), image::ColorType::L8);
    }

    #[test]
    fn quality_is_the_best_that_has_room() {
        let pictures = [(120, 80), (60, 60)].map(|size| Photograph { pixels: ramp(size), icc: None });
        let size = |pictures: &[Picture]| pictures.iter().map(|p| p.address.len()).sum::<usize>();
        let best = size(&jpegs_within(usize::MAX, &pictures).unwrap());
        let fits = jpegs_within(best - 1, &pictures).unwrap();
        assert!(size(&fits) < best && fits.iter().map(|p| p.width).eq([120, 60]));
        let least = size(&jpegs_within(0, &pictures).unwrap());
        assert!(least < size(&fits), "{least}");
    }

    #[test]
    fn palettes_are_exact_and_may_be_clear() {
        for count in [4u8, 15] {
            let opacity = |i: u8| if count == 4 { 255 } else { 17 * i };
            let palette: Vec<[u8; 4]> = (0..count).map(|i| [10 * i, 255 - i, 7, opacity(i)]).collect();
            let indices = Plane::from_rows(11, 3, |y, row| {
                (0..11).for_each(|x| row[x] = ((x + y) % usize::from(count)) as u8);
            });
            let back = decoded(&paletted(&indices, &palette).unwrap()).to_rgba8();
            let wanted: Vec<u8> = indices.as_slice().iter().flat_map(|&i| palette[usize::from(i)]).collect();
            assert_eq!(back.as_raw(), &wanted);
        }
    }

    #[test]
    fn bits_are_packed_from_the_left() {
        let is_set = |x: usize, y: usize| (x + y).is_multiple_of(3);
        let mut decoder = png::Decoder::new(std::io::Cursor::new(png_bits((11, 3), is_set).unwrap()));
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut back = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut back).unwrap();
        assert!(back.iter().enumerate().all(|(i, b)| *b == 255 * u8::from(is_set(i % 11, i / 11))));
    }
}
