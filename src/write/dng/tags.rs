//! The tags of a DNG that a TIFF does not have.
//!
//! In: primaries, size and brightness. Out: entries of its directories. Cost: negligible. Source: DNG, chapter 4.

use crate::bracket::colour::Primaries;
use crate::write::metadata::Metadata;
use crate::write::tiff::directory::{Directory, tag};

const KIND: u16 = 254;
const ORIENTATION: u16 = 274;
const OTHERS: u16 = 330;
const SUBSAMPLING: u16 = 530;
const DNG_VERSION: u16 = 50706;
const OLDEST_READER: u16 = 50707;
const CAMERA: u16 = 50708;
const BLACK: u16 = 50714;
const WHITE: u16 = 50717;
const CROP_ORIGIN: u16 = 50719;
const CROP_SIZE: u16 = 50720;
const MATRIX: u16 = 50721;
const NEUTRAL: u16 = 50728;
const BASELINE_EXPOSURE: u16 = 50730;
const ILLUMINANT: u16 = 50778;
const ACTIVE_AREA: u16 = 50829;
const PREVIEW_COLOURS: u16 = 50970;

/// Kinds of pictures.
const FULL: u64 = 0;
const PREVIEW: u64 = 1;
/// Photometric interpretations.
const YCBCR: u16 = 6;
const LINEAR_RAW: u16 = 34892;
/// Compression of the preview.
const JPEG: u16 = 7;
/// Colours of the preview.
const SRGB: u64 = 2;
/// EXIF's number of the light source D65.
const D65: u16 = 21;
/// The version that introduced floats, and deflate.
const FLOATS: [u8; 4] = [1, 4, 0, 0];
/// The version that introduced linear RGB.
const FIRST: [u8; 4] = [1, 1, 0, 0];

/// Describes the linear picture of `size` pixels, whose samples have this white level.
pub(super) fn linear(directory: &mut Directory, size: (usize, usize), white: u64) {
    let (width, height) = (size.0 as u64, size.1 as u64);
    directory.long(KIND, &[FULL]);
    directory.short(tag::PHOTOMETRIC, &[LINEAR_RAW]);
    directory.short(BLACK, &[0; 3]);
    directory.long(WHITE, &[white; 3]);
    directory.long(CROP_ORIGIN, &[0, 0]);
    directory.long(CROP_SIZE, &[width, height]);
    directory.long(ACTIVE_AREA, &[0, 0, height, width]);
}

/// Describes the preview of `size` pixels, which has `length` bytes at the offset `at`, and the whole file; `linear`
/// is the directory of the linear picture.
pub(super) fn main(
    metadata: &Metadata,
    (size, at, length): ((usize, usize), u64, usize),
    (linear, is_float): (Directory, bool),
    baseline_stops: f64,
) -> Directory {
    let mut directory = Directory::new(linear.big);
    directory.long(KIND, &[PREVIEW]);
    directory.long(tag::WIDTH, &[size.0 as u64]);
    directory.long(tag::HEIGHT, &[size.1 as u64]);
    directory.long(tag::ROWS_PER_STRIP, &[size.1 as u64]);
    directory.long(tag::STRIP_OFFSETS, &[at]);
    directory.long(tag::STRIP_COUNTS, &[length as u64]);
    directory.short(tag::BITS, &[8; 3]);
    directory.short(tag::SAMPLES, &[3]);
    directory.short(tag::PLANAR, &[1]);
    directory.short(tag::COMPRESSION, &[JPEG]);
    directory.short(tag::PHOTOMETRIC, &[YCBCR]);
    directory.short(SUBSAMPLING, &[1, 1]);
    directory.short(ORIENTATION, &[1]);
    directory.long(PREVIEW_COLOURS, &[SRGB]);
    directory.bytes_of(DNG_VERSION, &FLOATS);
    directory.bytes_of(OLDEST_READER, if is_float { &FLOATS } else { &FIRST });
    directory.text(CAMERA, Some(metadata.camera().as_deref().unwrap_or("hdralign")));
    let from_xyz = metadata.primaries.to_xyz().or_else(|| Primaries::SRGB.to_xyz()).and_then(|m| m.try_inverse());
    directory.signed_rational(MATRIX, from_xyz.unwrap_or_default().transpose().as_slice());
    directory.short(ILLUMINANT, &[D65]);
    directory.rational(NEUTRAL, &[1.0; 3]);
    directory.signed_rational(BASELINE_EXPOSURE, &[baseline_stops]);
    directory.other(OTHERS, linear);
    directory
}
