//! All output files of a run, written in parallel from the same rows.
//!
//! In: rows of the radiance and of the picture, in portions of any size. Out: a complete temporary file for every
//! output. Cost: the encoders, distributed to all threads: bands of one file are encoded while another file is written,
//! and a file is synced after its last row while other files are still encoded. Memory: a few encoded bands for each
//! file.

use super::format::{Format, Output};
use super::jpeg::{self, Rendition, Survey};
use super::metadata::Metadata;
use super::row_writer::RowWriter;
use super::staging::{Pending, Written};
use super::tiff::logluv;
use super::{Options, dng, exr, hdr, png, tiff};
use crate::bracket::colour::Primaries;
use crate::error::{Error, Result};
use crate::merge::RadianceMap;
use crate::plane::fold_bands;
use crate::tonemap::DisplayImage;
use crate::tonemap::display::codes::{Colours, Depth};
use rayon::prelude::*;
use std::io;
use std::path::{Path, PathBuf};

/// Settings that can only be determined from the whole radiance map, but that a file needs before its first row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settled {
    /// Sample type of OpenEXR.
    pub sample: exr::Sample,
    /// Values are multiplied by this factor before they are stored as LogLuv.
    pub logluv_scale: f32,
    /// The brightness of a DNG.
    pub brightness: dng::Brightness,
    /// The white and the range of gains for the gain map of a JPEG.
    pub rendition: Rendition,
}

impl Settled {
    /// Determines the settings for writing `radiance` and its picture `display` to `outputs`.
    pub(super) fn of(
        outputs: &[Output],
        radiance: &RadianceMap,
        display: &DisplayImage,
        options: &Options,
    ) -> Result<Settled> {
        let RadianceMap { pixels, primaries } = radiance;
        let bright = match options.tiff.depth() {
            Some(_) if is_among(outputs, Format::Tiff) => logluv::bright(radiance),
            _ => 0.0,
        };
        let scene = ((pixels.width(), pixels.height()), *primaries);
        let codes = |y: usize, _: &[[f32; 3]], codes: &mut [[u8; 3]]| codes.copy_from_slice(display.pixels.row(y));
        Self::seen(outputs, options, scene, bright, |see| see(0, radiance), codes)
    }

    /// Determines the settings for writing to `outputs` a radiance map of `size` and `primaries`, in which 0.1 % of
    /// the pixels exceed the luminance `bright`. `each` calls its argument for every slab of the radiance map, with
    /// the number of the slab's first row; it is used only if a format needs it. `codes(row number, radiance of the
    /// row, out)` writes the picture's code values of the row to `out`.
    ///
    /// # Errors
    /// Those of `each`.
    pub fn seen(
        outputs: &[Output],
        options: &Options,
        (size, primaries): ((usize, usize), Primaries),
        bright: f32,
        each: impl Fn(&mut dyn FnMut(usize, &RadianceMap) -> Result<()>) -> Result<()>,
        codes: impl Fn(usize, &[[f32; 3]], &mut [[u8; 3]]) + Sync,
    ) -> Result<Settled> {
        let mut fit = exr::Fit::default();
        if options.exr.sample == exr::Sample::Auto && is_among(outputs, Format::Exr) {
            each(&mut |_, map| {
                let of_rows = |rows| exr::Fit::of(map.pixels.rows(rows));
                fit = fit.and(fold_bands(map.pixels.height(), of_rows, exr::Fit::default(), exr::Fit::and));
                Ok(())
            })?;
        }
        let mut brightness = dng::Brightness::default();
        if is_among(outputs, Format::Dng) {
            let mut seen = dng::Survey::new(&primaries);
            each(&mut |_, map| {
                seen.see(&map.pixels);
                Ok(())
            })?;
            brightness = seen.brightness();
        }
        let mut rendition = Rendition::default();
        if is_among(outputs, Format::Jpeg) {
            let mut survey = Survey::new(size, &primaries, options.picture.colours);
            each(&mut |first, map| {
                survey.see(first, &map.pixels, &codes);
                Ok(())
            })?;
            rendition = survey.rendition(None);
        }
        let logluv_scale = options.tiff.depth().map_or(1.0, |depth| logluv::scale_under(depth, bright));
        Ok(Settled { sample: options.exr.sample.settled(fit), logluv_scale, brightness, rendition })
    }
}

/// Whether one of `outputs` has the `format`.
pub fn is_among(outputs: &[Output], format: Format) -> bool {
    outputs.iter().any(|output| output.format == format)
}

/// Code values of rows of a picture.
#[derive(Debug, Clone, Copy)]
pub enum Codes<'a> {
    /// 8 bits per channel.
    Eight(&'a [[u8; 3]]),
    /// 16 bits per channel.
    Sixteen(&'a [[u16; 3]]),
}

/// The state of a file.
enum State<P> {
    /// Started, with the number of missing pixels.
    Started(Box<dyn RowWriter<P>>, usize),
    Ended(Written),
    Failed,
}

/// A file, and its position among the outputs.
struct Slot<P> {
    place: usize,
    path: PathBuf,
    state: State<P>,
}

impl<P: Sync> Slot<P> {
    /// Adds rows; the file ends after the last row of the picture.
    fn push(&mut self, rows: &[P]) -> Result<()> {
        self.state = match std::mem::replace(&mut self.state, State::Failed) {
            State::Started(mut writer, missing) => {
                writer.push(rows)?;
                let missing = missing - rows.len();
                if missing == 0 { State::Ended(writer.finish()?) } else { State::Started(writer, missing) }
            }
            State::Ended(_) => panic!("rows were added after the last row of the picture"),
            State::Failed => return Err(failed(&self.path)),
        };
        Ok(())
    }

    /// Ends the file; if rows are missing, its writer returns an error.
    fn ended(self) -> Result<(usize, Written)> {
        let written = match self.state {
            State::Started(writer, _) => writer.finish()?,
            State::Ended(written) => written,
            State::Failed => return Err(failed(&self.path)),
        };
        Ok((self.place, written))
    }
}

/// A file that contains both radiance and picture, and its position among the outputs.
struct Both {
    place: usize,
    path: PathBuf,
    state: Option<Box<jpeg::Writer>>,
}

impl Both {
    /// Adds rows of radiance, of the picture, or of both.
    fn push(&mut self, radiance: &[[f32; 3]], display: &[[u8; 3]]) -> Result<()> {
        let mut writer = self.state.take().ok_or_else(|| failed(&self.path))?;
        writer.push(radiance, display)?;
        self.state = Some(writer);
        Ok(())
    }

    fn ended(self) -> Result<(usize, Written)> {
        let writer = self.state.ok_or_else(|| failed(&self.path))?;
        Ok((self.place, writer.finish()?))
    }
}

fn failed(path: &Path) -> Error {
    Error::Write { path: path.to_owned(), source: io::Error::other("an earlier write failed") }
}

/// Adds `rows` to all of `slots` in parallel. Returns the first error in the order of `slots`.
fn push_all<P: Sync>(slots: &mut [Slot<P>], rows: &[P]) -> Result<()> {
    if rows.is_empty() {
        return Ok(());
    }
    let outcomes: Vec<Result<()>> = slots.par_iter_mut().with_max_len(1).map(|slot| slot.push(rows)).collect();
    outcomes.into_iter().collect()
}

/// All result files of a run: radiance maps and pictures.
///
/// Push at least four bands of [`BAND_ROWS`](crate::plane::BAND_ROWS) rows at a time, so that several threads have
/// work. The size of the portions does not change the files. No file remains if `Files` is dropped before the end.
pub struct Files {
    radiance: Vec<Slot<[f32; 3]>>,
    eight: Vec<Slot<[u8; 3]>>,
    sixteen: Vec<Slot<[u16; 3]>>,
    /// Files that need both radiance and picture.
    both: Vec<Both>,
}

impl Files {
    /// Starts a file for each of `outputs`; the radiance map has `size` pixels. Radiance files have the
    /// [`primaries`](Metadata::primaries) of `metadata`, pictures have the requested
    /// [`colours`](super::picture::Options::colours).
    ///
    /// # Errors
    /// [`Error::Option`] if the format of a picture does not support an option; [`Error::Write`]. After an error, no
    /// files remain.
    pub fn begin(
        outputs: &[Output],
        size: (usize, usize),
        metadata: &Metadata,
        options: &Options,
        settled: Settled,
    ) -> Result<Files> {
        options.check(outputs)?;
        let mut files = Files { radiance: Vec::new(), eight: Vec::new(), sixteen: Vec::new(), both: Vec::new() };
        let colours = options.picture.colours;
        let shown = Metadata { profile: colours.profile(), ..metadata.clone() };
        let (full, size) = (size, options.picture.size.of(size));
        for (place, output) in outputs.iter().enumerate() {
            let (path, pixels) = (output.path.clone(), size.0 * size.1);
            if output.format == Format::Jpeg {
                let pending = Pending::create(&path)?;
                let writer = jpeg::Writer::new(pending, size, &shown, (&options.jpeg, colours), &settled.rendition)?;
                files.both.push(Both { place, path, state: Some(Box::new(writer)) });
            } else if output.format.holds_radiance() {
                let state = State::Started(radiance_writer(output, full, metadata, options, settled)?, full.0 * full.1);
                files.radiance.push(Slot { place, path, state });
            } else if options.picture.depth == Depth::Eight {
                let state = State::Started(picture_writer(output, size, &shown, colours)?, pixels);
                files.eight.push(Slot { place, path, state });
            } else {
                let state = State::Started(picture_writer(output, size, &shown, colours)?, pixels);
                files.sixteen.push(Slot { place, path, state });
            }
        }
        Ok(files)
    }

    /// Whether one of the files is a JPEG, which needs the radiance besides the picture (for a gain map).
    pub fn hold_gains(&self) -> bool {
        !self.both.is_empty()
    }

    /// Whether there are pictures.
    pub fn hold_pictures(&self) -> bool {
        !self.eight.is_empty() || !self.sixteen.is_empty() || !self.both.is_empty()
    }

    /// Adds the next rows to all files, in parallel. `radiance` is for the radiance maps. `codes` is for the
    /// pictures, and `shown` is the radiance that these codes show, at the size of the picture. Each of the three may
    /// be empty.
    ///
    /// # Errors
    /// [`Error::Write`] of the first file that failed, in the order radiance maps, PNG and TIFF pictures, JPEG. After
    /// an error, no more rows can be added.
    ///
    /// # Panics
    /// As [`RowWriter::push`].
    pub fn push(&mut self, radiance: &[[f32; 3]], shown: &[[f32; 3]], codes: Codes) -> Result<()> {
        let Files { radiance: maps, eight, sixteen, both } = self;
        let (coarse, fine): (&[[u8; 3]], &[[u16; 3]]) = match codes {
            Codes::Eight(codes) => (codes, &[]),
            Codes::Sixteen(codes) => (&[], codes),
        };
        let push_both = || both.iter_mut().try_for_each(|file| file.push(shown, coarse));
        let push_pictures = || push_all(eight, coarse).and(push_all(sixteen, fine));
        let (a, (b, c)) = rayon::join(|| push_all(maps, radiance), || rayon::join(push_pictures, push_both));
        a.and(b).and(c)
    }

    /// Ends all files, and returns them in the order of the outputs.
    ///
    /// # Errors
    /// [`Error::Write`] if rows are missing.
    pub fn finish(self) -> Result<Vec<Written>> {
        let maps = self.radiance.into_iter().map(Slot::ended);
        let (eight, sixteen) = (self.eight.into_iter().map(Slot::ended), self.sixteen.into_iter().map(Slot::ended));
        let both = self.both.into_iter().map(Both::ended);
        let mut files = maps.chain(eight).chain(sixteen).chain(both).collect::<Result<Vec<_>>>()?;
        files.sort_by_key(|(place, _)| *place);
        Ok(files.into_iter().map(|(_, written)| written).collect())
    }
}

/// Creates a writer of linear RGB to `output`.
fn radiance_writer(
    output: &Output,
    size: (usize, usize),
    metadata: &Metadata,
    options: &Options,
    settled: Settled,
) -> Result<Box<dyn RowWriter<[f32; 3]>>> {
    let file = Pending::create(&output.path)?;
    Ok(match (output.format, options.tiff.depth()) {
        (Format::Tiff, None) => Box::new(tiff::Writer::new(file, size, metadata)?),
        (Format::Tiff, Some(depth)) => {
            Box::new(logluv::Writer::new(file, size, metadata, depth, settled.logluv_scale)?)
        }
        (Format::Hdr, _) => Box::new(hdr::Writer::new(file, size, metadata, options.hdr)?),
        (Format::Dng, _) => Box::new(dng::Writer::new(file, size, metadata, options.dng, settled.brightness)?),
        (Format::Png | Format::Jpeg | Format::TiffPicture, _) => {
            let known = ".exr, .hdr, .pic, .tif, .tiff, .dng";
            return Err(Error::UnknownExtension { path: output.path.clone(), known });
        }
        (Format::Exr, _) => {
            let options = exr::Options { sample: settled.sample, ..options.exr.clone() };
            Box::new(exr::Writer::new(file, size, metadata, &options)?)
        }
    })
}

/// Creates a writer of code values to `output`.
fn picture_writer<T: png::Sample>(
    output: &Output,
    size: (usize, usize),
    metadata: &Metadata,
    colours: Colours,
) -> Result<Box<dyn RowWriter<[T; 3]>>> {
    let file = Pending::create(&output.path)?;
    Ok(match output.format {
        Format::TiffPicture => Box::new(tiff::Writer::picture(file, size, metadata)?),
        _ => Box::new(png::Writer::new(file, size, metadata, colours)?),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::Plane;
    use crate::write::{commit, write};

    #[test]
    fn all_formats_are_written_or_no_file() {
        let dir = tempfile::tempdir().unwrap();
        let paths: Vec<PathBuf> =
            ["a.exr", "a.hdr", "a.tif", "a.png", "a.jpg"].iter().map(|n| dir.path().join(n)).collect();
        let radiance = RadianceMap { pixels: Plane::filled(9, 3, [0.5, 1.0, 2.0]), primaries: Primaries::SRGB };
        let picture = DisplayImage { pixels: Plane::filled(9, 3, [10, 20, 30]) };
        let (metadata, options) = (Metadata::default(), Options::default());
        let there = || std::fs::read_dir(dir.path()).unwrap().count();
        // The sixth file cannot be created, after the first five were: no file may remain, not even under a temporary
        // name.
        let mut and_a_wrong_one = paths.clone();
        and_a_wrong_one.push("nowhere/a.exr".into());
        assert!(write(&and_a_wrong_one, &radiance, &picture, &metadata, &options).is_err());
        assert_eq!(there(), 0);
        let pending = |written: Vec<Written>| written.into_iter().map(|w| w.file).collect::<Vec<_>>();
        let written = write(&paths, &radiance, &picture, &metadata, &options).unwrap();
        assert!(written.iter().all(|w| w.warnings.is_empty()));
        commit(pending(written), false).unwrap();
        assert_eq!(there(), 5);
        assert_eq!(crate::read::read(&paths[0]).unwrap().0.pixels, radiance.pixels);
        assert_eq!(image::open(&paths[3]).unwrap().to_rgb8().get_pixel(8, 2).0, [10, 20, 30]);
        let again = commit(pending(write(&paths, &radiance, &picture, &metadata, &options).unwrap()), false);
        assert!(matches!(again, Err(Error::OutputExists { .. })));
        assert_eq!(there(), 5);
    }
    /// Rows may be pushed in portions of any size, and radiance and picture together or one after the other: the
    /// files are the same as for all rows at once. If rows are missing, no file remains.
    #[test]
    fn files_do_not_depend_on_how_they_are_fed() {
        let dir = tempfile::tempdir().unwrap();
        let (width, height) = (37, 64 * 5 + 3);
        let value = |x: usize, y: usize, c: usize| ((x * 31 + y * 17 + c * 7) % 101) as f32;
        let pixels = Plane::from_rows(width, height, |y, row| {
            for (x, p) in row.iter_mut().enumerate() {
                *p = [0, 1, 2].map(|c| value(x, y, c));
            }
        });
        let radiance = RadianceMap { pixels, primaries: Primaries::SRGB };
        let picture = DisplayImage {
            pixels: Plane::from_rows(width, height, |y, row| {
                for (x, p) in row.iter_mut().enumerate() {
                    *p = [0, 1, 2].map(|c| value(x, y, c) as u8);
                }
            }),
        };
        let names = ["a.png", "a.exr", "a.jpg", "a.hdr", "a.tif", "b.png"];
        let (metadata, options) = (Metadata::default(), Options::default());
        let contents = |folder: &str, make: &dyn Fn(&[PathBuf]) -> Vec<Written>| {
            let folder = dir.path().join(folder);
            std::fs::create_dir(&folder).unwrap();
            let paths: Vec<PathBuf> = names.iter().map(|n| folder.join(n)).collect();
            let written = make(&paths);
            let targets: Vec<&Path> = written.iter().map(|w| w.file.target()).collect();
            assert_eq!(targets, paths, "in the order of the outputs");
            commit(written.into_iter().map(|w| w.file).collect(), false).unwrap();
            paths.iter().map(|path| std::fs::read(path).unwrap()).collect::<Vec<_>>()
        };
        let whole = contents("whole", &|paths| write(paths, &radiance, &picture, &metadata, &options).unwrap());
        for (folder, portion, together) in [("some", 128, true), ("few", 50, false)] {
            let fed = contents(folder, &|paths| {
                let outputs = Output::results(paths).unwrap();
                let settled = Settled::of(&outputs, &radiance, &picture, &options).unwrap();
                let mut files = Files::begin(&outputs, (width, height), &metadata, &options, settled).unwrap();
                assert!(files.hold_pictures() && files.hold_gains());
                let maps = radiance.pixels.as_slice().chunks(portion * width);
                for (map, picture) in maps.zip(picture.pixels.as_slice().chunks(portion * width)) {
                    if together {
                        files.push(map, map, Codes::Eight(picture)).unwrap();
                    } else {
                        files.push(map, map, Codes::Eight(&[])).unwrap();
                        files.push(&[], &[], Codes::Eight(picture)).unwrap();
                    }
                }
                files.finish().unwrap()
            });
            assert!(fed == whole, "{portion} rows at a time");
        }
        let outputs = Output::results(&[dir.path().join("short.exr"), dir.path().join("short.png")]).unwrap();
        let settled = Settled::of(&outputs, &radiance, &picture, &options).unwrap();
        let mut files = Files::begin(&outputs, (width, height), &metadata, &options, settled).unwrap();
        files.push(radiance.pixels.as_slice(), &[], Codes::Eight(&[])).unwrap();
        files.push(&[], &[], Codes::Eight(&picture.pixels.as_slice()[..width])).unwrap();
        assert!(files.finish().unwrap_err().to_string().contains("only 1 of the 323 rows"));
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 3, "nothing but the folders");
    }
}
