//! The PNG writer: bands of rows, filtered and compressed in parallel.
//!
//! In: display-encoded RGB by rows. Out: a `.png` file. Cost and source: see [`super`].

use crate::error::Result;
use crate::simd::{Loops, vectorised};
use crate::tonemap::display::codes::Colours;
use crate::write::bands::Bands;
use crate::write::deflate::{Adler, HEADER, deflate};
use crate::write::exif;
use crate::write::metadata::{Metadata, one_line};
use crate::write::row_writer::RowWriter;
use crate::write::staging::{Pending, Written};
use flate2::write::ZlibEncoder;
use flate2::{Compression, Crc};
use std::io::{self, Write};

/// Type of code values that PNG supports.
pub trait Sample: crate::write::tiff::Sample {
    /// Returns the bytes of `pixels`, high bytes first; in `buffer` if they have to be converted.
    fn bytes<'a>(pixels: &'a [[Self; 3]], buffer: &'a mut Vec<u8>) -> &'a [u8];
}

impl Sample for u8 {
    fn bytes<'a>(pixels: &'a [[u8; 3]], _: &'a mut Vec<u8>) -> &'a [u8] {
        pixels.as_flattened()
    }
}

impl Sample for u16 {
    fn bytes<'a>(pixels: &'a [[u16; 3]], buffer: &'a mut Vec<u8>) -> &'a [u8] {
        buffer.clear();
        buffer.extend(pixels.as_flattened().iter().flat_map(|code| code.to_be_bytes()));
        buffer
    }
}

/// Buffers of an encoder: the bytes of the code values, and the filtered rows.
type Buffers = (Vec<u8>, Vec<u8>);

/// The `.png` writer for pixels `[T; 3]`.
#[derive(Debug)]
pub struct Writer<T> {
    file: Pending,
    bands: Bands<[T; 3], Buffers>,
    adler: Adler,
}

impl<T: Sample> Writer<T> {
    /// Writes the header of a picture of `size` pixels with `colours`, described by the [`profile`](Metadata::profile);
    /// without a profile the picture is sRGB and marked as such. Rows follow.
    ///
    /// # Errors
    /// [`Error::Write`](crate::error::Error::Write).
    pub fn new(mut file: Pending, size: (usize, usize), metadata: &Metadata, colours: Colours) -> Result<Self> {
        let start = header(size, T::BITS as u8, metadata, colours).map_err(|e| file.error(e))?;
        file.put(&start)?;
        Ok(Writer { file, bands: Bands::new(size), adler: Adler::default() })
    }
}

impl<T: Sample> RowWriter<[T; 3]> for Writer<T> {
    fn push(&mut self, rows: &[[T; 3]]) -> Result<()> {
        let Writer { file, bands, adler } = self;
        let (width, height) = (bands.width, bands.height);
        bands.push(
            rows,
            |first, pixels, (bytes, raw), out| {
                let last = first + pixels.len() / width == height;
                encode_band(T::bytes(pixels, bytes), size_of::<[T; 3]>(), width, (first == 0, last), raw, out)
            },
            |chunk, of_band| {
                *adler = adler.followed_by(of_band.map_err(|e| file.error(e))?);
                file.put(chunk)
            },
        )
    }

    fn finish(mut self: Box<Self>) -> Result<Written> {
        self.bands.complete().map_err(|e| self.file.error(e))?;
        // All bands form one zlib stream, which ends with the checksum of all bands.
        let mut end = Vec::new();
        put_chunk(b"IDAT", &self.adler.sum().to_be_bytes(), &mut end);
        put_chunk(b"IEND", &[], &mut end);
        self.file.put(&end)?;
        Written::ended(self.file, Vec::new())
    }
}

/// Returns everything before the pixels.
fn header((width, height): (usize, usize), bits: u8, metadata: &Metadata, colours: Colours) -> io::Result<Vec<u8>> {
    let side = |n: usize| {
        u32::try_from(n)
            .map_err(|_| {
                io::Error::other("the picture is too large: each side of a PNG must have fewer than 2^32 pixels")
            })
            .map(u32::to_be_bytes)
    };
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    // RGB, deflate, adaptive filters, not interlaced.
    put_chunk(b"IHDR", &[&side(width)?[..], &side(height)?, &[bits, 2, 0, 0, 0]].concat(), &mut out);
    if colours == Colours::DisplayP3 {
        // The four bytes mean (ITU-T H.273): primaries of SMPTE EG 432-1, sRGB's transfer function, RGB, full range.
        // Readers that do not know cICP use the profile.
        put_chunk(b"cICP", &[12, 13, 0, 1], &mut out);
    }
    match &metadata.profile {
        // 0 is the perceptual intent, which is for photographs.
        None => put_chunk(b"sRGB", &[0], &mut out),
        Some(profile) => {
            let mut icc = ZlibEncoder::new(b"ICC\0\0".to_vec(), Compression::default());
            icc.write_all(&profile.icc)?;
            put_chunk(b"iCCP", &icc.finish()?, &mut out);
        }
    }
    if let Some(exif) = exif::block((width, height), metadata).filter(|_| exif::tells(metadata)) {
        put_chunk(b"eXIf", &exif, &mut out);
    }
    let software = [b"Software\0", one_line(&metadata.software).as_bytes()].concat();
    put_chunk(b"tEXt", &software, &mut out);
    Ok(out)
}

fn put_chunk(name: &[u8; 4], data: &[u8], out: &mut Vec<u8>) {
    let start = out.len();
    out.extend_from_slice(&[0; 4]);
    out.extend_from_slice(name);
    out.extend_from_slice(data);
    end_chunk(start, out);
}

/// Ends the chunk that begins at `start`: writes its length, and appends the checksum.
fn end_chunk(start: usize, out: &mut Vec<u8>) {
    let mut crc = Crc::new();
    crc.update(&out[start + 4..]);
    // A band of 64 rows is far below the limit of 2 GB for a chunk.
    let length = (out.len() - start - 8) as u32;
    out[start..start + 4].copy_from_slice(&length.to_be_bytes());
    out.extend_from_slice(&crc.sum().to_be_bytes());
}

/// Appends a chunk with the filtered rows of `bytes`, which have `pixel` bytes per pixel, as deflate blocks that end at
/// a byte boundary. Returns the checksum of the filtered rows. The first band begins the stream, the last one ends it.
fn encode_band(
    bytes: &[u8],
    pixel: usize,
    width: usize,
    (first, last): (bool, bool),
    raw: &mut Vec<u8>,
    out: &mut Vec<u8>,
) -> io::Result<Adler> {
    let stride = pixel * width;
    raw.resize(bytes.len() + bytes.len() / stride, 0);
    match pixel {
        3 => vectorised(Filter::<3> { bytes, stride, out: raw }),
        _ => vectorised(Filter::<6> { bytes, stride, out: raw }),
    }
    let start = out.len();
    out.extend_from_slice(b"\0\0\0\0IDAT");
    if first {
        out.extend_from_slice(&HEADER);
    }
    deflate(raw, last, out)?;
    end_chunk(start, out);
    Ok(Adler::of(raw))
}

/// Filters rows of `stride` bytes with `PIXEL` bytes per pixel: writes the number of the filter and the filtered bytes
/// of each row. The filter is Paeth, or Sub for the first row of a band, because the row above belongs to another band.
struct Filter<'a, const PIXEL: usize> {
    bytes: &'a [u8],
    stride: usize,
    out: &'a mut [u8],
}

impl<const PIXEL: usize> Loops for Filter<'_, PIXEL> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let mut above: Option<&[u8]> = None;
        for (row, out) in self.bytes.chunks_exact(self.stride).zip(self.out.chunks_exact_mut(self.stride + 1)) {
            let (kind, out) = out.split_at_mut(1);
            let (out_first, out) = out.split_at_mut(PIXEL);
            let (first, rest) = row.split_at(PIXEL);
            match above {
                None => {
                    kind[0] = 1;
                    out_first.copy_from_slice(first);
                    for ((to, &v), &left) in out.iter_mut().zip(rest).zip(row) {
                        *to = v.wrapping_sub(left);
                    }
                }
                Some(above) => {
                    kind[0] = 4;
                    // There is no pixel left of the first, so Paeth predicts from the pixel above.
                    for ((to, &v), &up) in out_first.iter_mut().zip(first).zip(above) {
                        *to = v.wrapping_sub(up);
                    }
                    let neighbours = row.iter().zip(&above[PIXEL..]).zip(above);
                    for ((to, &v), ((&left, &up), &above_left)) in out.iter_mut().zip(rest).zip(neighbours) {
                        *to = v.wrapping_sub(paeth(left, up, above_left));
                    }
                }
            }
            above = Some(row);
        }
    }
}

/// Returns `a` (the byte on the left), `b` (above) or `c` (above left), whichever is closest to a + b - c (section
/// 9.4).
#[inline(always)]
fn paeth(a: u8, b: u8, c: u8) -> u8 {
    let [i, j, k] = [a, b, c].map(i16::from);
    let (pa, pb, pc) = ((j - k).abs(), (i - k).abs(), (i + j - 2 * k).abs());
    let b_or_c = if pb <= pc { b } else { c };
    if (pa <= pb) & (pa <= pc) { a } else { b_or_c }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::colour::Profile;
    use crate::plane::Plane;
    use crate::write::{commit, push_all};

    fn picture(width: usize, height: usize) -> Plane<[u8; 3]> {
        Plane::from_rows(width, height, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                let noise = ((x * 7919 + y * 104_729) % 1009 % 23) as u8;
                *p = [(x / 3) as u8 ^ noise, (y as u8).wrapping_add(noise), noise];
            }
        })
    }

    fn written<T: Sample>(picture: &Plane<[T; 3]>, metadata: &Metadata) -> Vec<u8> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.png");
        let size = (picture.width(), picture.height());
        let writer = Writer::<T>::new(Pending::create(&path).unwrap(), size, metadata, Colours::Srgb).unwrap();
        let whole = push_all(Box::new(writer), picture).unwrap();
        commit(vec![whole.file], false).unwrap();
        std::fs::read(&path).unwrap()
    }

    /// The decoder checks every CRC and, on request, the Adler checksum.
    #[test]
    fn another_decoder_reads_the_same_pixels() {
        for (width, height) in [(1, 1), (3, 64), (200, 65), (61, 64 * 18 + 7)] {
            let picture = picture(width, height);
            let bytes = written(&picture, &Metadata::default());
            let mut decoder = png::Decoder::new(io::Cursor::new(&bytes));
            decoder.ignore_checksums(false);
            let mut reader = decoder.read_info().unwrap();
            assert_eq!(reader.info().srgb, Some(png::SrgbRenderingIntent::Perceptual));
            let mut back = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut back).unwrap();
            reader.finish().unwrap();
            assert!(back == picture.as_slice().as_flattened(), "{width}x{height}");
        }
    }

    #[test]
    fn another_decoder_reads_the_same_codes_of_16_bits() {
        for (width, height) in [(1, 1), (200, 65), (61, 64 * 3 + 7)] {
            let picture = Plane::from_rows(width, height, |y, row| {
                for (x, p) in row.iter_mut().enumerate() {
                    *p = [0, 1, 2].map(|c| ((x * 263 + y * 1009 + c * 20_011) ^ (x * y)) as u16);
                }
            });
            let back = image::load_from_memory(&written(&picture, &Metadata::default())).unwrap();
            let image::DynamicImage::ImageRgb16(back) = back else { panic!("16 bits") };
            assert!(back.as_raw() == picture.as_slice().as_flattened(), "{width}x{height}");
        }
    }

    /// The expected bytes are computed byte by byte, as in section 9.2 of the PNG standard.
    #[test]
    fn rows_are_filtered_by_the_standard() {
        for width in [1, 2, 21, 200] {
            let picture = picture(2 * width, 9);
            for (pixel, bytes) in [(3, &picture.as_slice()[..9 * width]), (6, picture.as_slice())] {
                let (bytes, stride) = (bytes.as_flattened(), pixel * width);
                let at = |x: Option<usize>, y: Option<usize>| match (x, y) {
                    (Some(x), Some(y)) => i32::from(bytes[y * stride + x]),
                    _ => 0,
                };
                let mut expected = Vec::new();
                for y in 0..9usize {
                    expected.push(if y == 0 { 1 } else { 4 });
                    for x in 0..stride {
                        let (left, above) = (x.checked_sub(pixel), y.checked_sub(1));
                        let (a, b, c) = (at(left, Some(y)), at(Some(x), above), at(left, above));
                        let p = a + b - c;
                        let nearest = [a, b, c].into_iter().min_by_key(|v| (p - v).abs()).unwrap();
                        expected.push((at(Some(x), Some(y)) - if y == 0 { a } else { nearest }) as u8);
                    }
                }
                let mut ours = vec![0; expected.len()];
                match pixel {
                    3 => vectorised(Filter::<3> { bytes, stride, out: &mut ours }),
                    _ => vectorised(Filter::<6> { bytes, stride, out: &mut ours }),
                }
                assert_eq!(ours, expected, "width {width}, {pixel} bytes a pixel");
            }
        }
    }

    #[test]
    fn the_header_is_to_the_letter() {
        let metadata = Metadata { software: "hdralign 1.2.3".into(), ..Metadata::default() };
        let bytes = header((258, 3), 8, &metadata, Colours::Srgb).unwrap();
        let golden = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\x01\x02\0\0\0\x03\x08\x02\0\0\0";
        assert_eq!(bytes[..golden.len()], golden[..]);
        // sRGB, perceptual, with the CRC that libpng writes.
        assert_eq!(bytes[33..46], b"\0\0\0\x01sRGB\0\xae\xce\x1c\xe9"[..]);
        assert_eq!(bytes[46..77], b"\0\0\0\x17tEXtSoftware\0hdralign 1.2.3"[..]);
    }

    #[test]
    fn a_profile_takes_the_place_of_srgb() {
        let icc: Vec<u8> = (0..500).map(|i| (i / 7) as u8).collect();
        let metadata = Metadata {
            profile: Some(Profile { icc: icc.clone(), description: String::new(), primaries: None }),
            ..Metadata::default()
        };
        let bytes = written(&picture(4, 4), &metadata);
        let reader = png::Decoder::new(io::Cursor::new(&bytes)).read_info().unwrap();
        assert_eq!(reader.info().icc_profile.as_deref(), Some(&icc[..]));
        assert_eq!(reader.info().srgb, None);
    }

    #[test]
    fn the_bytes_are_the_same_on_any_number_of_threads() {
        let picture = picture(90, 64 * 18 + 1);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| written(&picture, &Metadata::default()))
        };
        assert!(on(1) == on(2) && on(1) == on(7));
    }
}
