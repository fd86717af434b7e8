//! The tags of a DNG file.
//!
//! In: the bytes of a file. Out: the values of tags, from the directory of the raw data, or else from the first one.
//! Cost: negligible. Source: TIFF 6.0; TIFF/EP; DNG, chapter 4.

use crate::bracket::raw::Reason;
use crate::tiff_file::{Directories, Directory};
use std::io::{Read, Seek};

/// Numbers of the tags that are read.
pub(super) mod tag {
    pub(in crate::bracket::raw) const SUBFILE: u16 = 254;
    pub(in crate::bracket::raw) const WIDTH: u16 = 256;
    pub(in crate::bracket::raw) const HEIGHT: u16 = 257;
    pub(in crate::bracket::raw) const BITS: u16 = 258;
    pub(in crate::bracket::raw) const COMPRESSION: u16 = 259;
    pub(in crate::bracket::raw) const PHOTOMETRIC: u16 = 262;
    pub(in crate::bracket::raw) const STRIPS: u16 = 273;
    pub(in crate::bracket::raw) const SAMPLES_PER_PIXEL: u16 = 277;
    pub(in crate::bracket::raw) const ROWS_PER_STRIP: u16 = 278;
    pub(in crate::bracket::raw) const STRIP_LENGTHS: u16 = 279;
    pub(in crate::bracket::raw) const PLANAR: u16 = 284;
    pub(in crate::bracket::raw) const PREDICTOR: u16 = 317;
    pub(in crate::bracket::raw) const TILE_WIDTH: u16 = 322;
    pub(in crate::bracket::raw) const TILE_HEIGHT: u16 = 323;
    pub(in crate::bracket::raw) const TILES: u16 = 324;
    pub(in crate::bracket::raw) const TILE_LENGTHS: u16 = 325;
    pub(in crate::bracket::raw) const SUB_DIRECTORIES: u16 = 330;
    pub(in crate::bracket::raw) const SAMPLE_FORMAT: u16 = 339;
    pub(in crate::bracket::raw) const PATTERN_SIZE: u16 = 33421;
    pub(in crate::bracket::raw) const PATTERN: u16 = 33422;
    pub(in crate::bracket::raw) const LINEARISATION: u16 = 50712;
    pub(in crate::bracket::raw) const BLACK_SIZE: u16 = 50713;
    pub(in crate::bracket::raw) const BLACK: u16 = 50714;
    pub(in crate::bracket::raw) const BLACK_OF_COLUMNS: u16 = 50715;
    pub(in crate::bracket::raw) const BLACK_OF_ROWS: u16 = 50716;
    pub(in crate::bracket::raw) const WHITE: u16 = 50717;
    pub(in crate::bracket::raw) const CROP_ORIGIN: u16 = 50719;
    pub(in crate::bracket::raw) const CROP_SIZE: u16 = 50720;
    pub(in crate::bracket::raw) const MATRICES: [u16; 2] = [50721, 50722];
    pub(in crate::bracket::raw) const CALIBRATIONS: [u16; 2] = [50723, 50724];
    pub(in crate::bracket::raw) const ANALOG_BALANCE: u16 = 50727;
    pub(in crate::bracket::raw) const NEUTRAL: u16 = 50728;
    pub(in crate::bracket::raw) const WHITE_XY: u16 = 50729;
    pub(in crate::bracket::raw) const ILLUMINANTS: [u16; 2] = [50778, 50779];
    pub(in crate::bracket::raw) const ACTIVE_AREA: u16 = 50829;
    /// The lists 2, for the mosaic, and 3, for the colours.
    pub(in crate::bracket::raw) const OPCODES: [u16; 2] = [51009, 51022];
}

/// The values of PhotometricInterpretation of raw data: a mosaic, and linear pixels.
pub(super) const MOSAIC: u64 = 32803;
pub(super) const LINEAR: u64 = 34892;

pub(super) fn damaged() -> Reason {
    "its list of tags is damaged; copy the file again".into()
}

/// The directories of a DNG file that are used.
pub(super) struct Tags<R> {
    file: Directories<R>,
    /// The directory of the raw data.
    raw: Directory,
    /// The first directory, which has what holds for the whole file; none if it is that of the raw data.
    main: Option<Directory>,
}

impl<R: Read + Seek> Tags<R> {
    /// The tags of the file `reader`; none if its directories are damaged. The raw data is the largest picture that is
    /// neither a thumbnail nor processed.
    pub(super) fn of(reader: R) -> Option<Self> {
        let mut file = Directories::of(reader)?;
        let mut all = file.pictures();
        for i in 0..all.len() {
            let below = file.numbers(&all[i], tag::SUB_DIRECTORIES).unwrap_or_default();
            all.extend(below.into_iter().take(64).filter_map(|at| file.directory(at)));
        }
        let mut best = (0, 0);
        for (i, directory) in all.iter().enumerate() {
            let number = |file: &mut Directories<R>, tag| file.first_number(directory, tag).unwrap_or(0);
            let is_raw = matches!(number(&mut file, tag::PHOTOMETRIC), MOSAIC | LINEAR);
            let is_full = number(&mut file, tag::SUBFILE) == 0;
            let pixels = number(&mut file, tag::WIDTH).saturating_mul(number(&mut file, tag::HEIGHT));
            if is_raw && is_full && pixels > best.1 {
                best = (i, pixels);
            }
        }
        let raw = if best.0 < all.len() { all.swap_remove(best.0) } else { return None };
        let main = if best.0 == 0 { None } else { Some(all.swap_remove(0)) };
        Some(Tags { file, raw, main })
    }

    /// Whether the samples of the file have their lower byte first.
    pub(super) fn is_little(&self) -> bool {
        self.file.is_little
    }

    /// Width and height of the raw data.
    pub(super) fn size(&mut self) -> Result<(usize, usize), Reason> {
        Ok((self.number(tag::WIDTH)? as usize, self.number(tag::HEIGHT)? as usize))
    }

    /// The integers of `tag`; none if there are none.
    pub(super) fn numbers(&mut self, tag: u16) -> Option<Vec<u64>> {
        self.file.numbers(&self.raw, tag).or_else(|| self.file.numbers(self.main.as_ref()?, tag))
    }

    /// The bytes of `tag` in the directory of the raw data; none if there are none.
    pub(super) fn bytes(&mut self, tag: u16) -> Option<Vec<u8>> {
        self.file.opaque(&self.raw, tag)
    }

    /// The real numbers of `tag`; none if there are none, or if one is not finite.
    pub(super) fn reals(&mut self, tag: u16) -> Option<Vec<f64>> {
        let found = self.file.reals(&self.raw, tag).or_else(|| self.file.reals(self.main.as_ref()?, tag));
        found.filter(|values| values.iter().all(|v| v.is_finite()))
    }

    /// The first integer of `tag`.
    ///
    /// # Errors
    /// The reason, if there is none.
    pub(super) fn number(&mut self, tag: u16) -> Result<u64, Reason> {
        self.numbers(tag).and_then(|values| values.first().copied()).ok_or_else(damaged)
    }

    /// The first integer of `tag`; `default` if the file has no such tag.
    pub(super) fn number_or(&mut self, tag: u16, default: u64) -> Result<u64, Reason> {
        Ok(self.numbers(tag).and_then(|values| values.first().copied()).unwrap_or(default))
    }
}
