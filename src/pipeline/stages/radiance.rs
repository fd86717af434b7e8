//! Merging: radiance in the colour space and the unit of the results.
//!
//! In: aligned frames and the response. Out: [`Radiance`], with rows in memory or, if memory is limited, on disk. Cost:
//! merging, deghosting and the flare estimate; on disk also writing and reading 12 bytes per pixel.

use crate::bracket::Bracket;
use crate::bracket::colour::Primaries;
use crate::bracket::colour::Space;
use crate::error::{Result, Warning};
use crate::merge::deghost::{self, Ghosts};
use crate::merge::local::LocalGain;
use crate::merge::radiance::calibration::{self, CalibrationReport, Unit};
use crate::merge::radiance::flare::{self, Flare, FlareReport};
use crate::merge::radiance::range::Limits;
use crate::merge::radiance::statistics::{Statistics, Tally};
use crate::merge::radiance::{gamut, normalisation};
use crate::merge::{MergeOptions, Merged, Merging, Photographed, RadianceMap};
use crate::pipeline::Options;
use crate::pipeline::stages::reference::Aligned;
use crate::pipeline::stages::response::Camera;
use crate::plane::{BAND_ROWS, Plane};
use crate::scratch::{Kept, Scratch};
use std::ops::Range;
use std::sync::Arc;

/// The radiance of a run, and data about it.
pub(crate) struct Radiance {
    pub rows: RadianceRows,
    /// The range of radiance that the photographs show.
    pub photographed: Option<Photographed>,
    pub merged: Merged,
    /// The radiances between which the frames have a signal; `None` if the frames are locally processed.
    pub limits: Option<Limits>,
    pub ghosts: Option<Ghosts>,
    /// `None` if flare was not requested.
    pub flare: Option<FlareReport>,
    /// The local brightness factors of frames that the camera tone-mapped locally; `None` for other frames.
    pub local: Option<LocalGain>,
    pub tally: Tally,
    pub statistics: Statistics,
    pub calibration: Option<CalibrationReport>,
}

/// Merges the frames, and converts their radiance to the colour space and the unit of the results. The warning is about
/// colours outside of this colour space.
pub(crate) fn merged(
    Aligned { bracket, alignment, region }: &Aligned,
    camera: &Camera,
    calibration: Option<CalibrationReport>,
    options: &Options,
) -> Result<(Radiance, Option<Warning>)> {
    let (curve, region) = (&camera.curve, *region);
    let local = camera.is_local().then(|| LocalGain::find(bracket, alignment, curve, region)).transpose()?;
    let gain = local.as_ref().map(|local| move |layer: usize, rows: Range<usize>| local.at(layer, rows));
    let gain = gain.as_ref().map(|gain| gain as deghost::Gain);
    let ghosts = |strength| deghost::find(bracket, alignment, curve, region, strength, gain);
    let ghosts = options.deghost.strength().map(ghosts).transpose()?;
    let merging = MergeOptions { weight: options.weight_for(bracket), region };
    let merging = Merging::of(bracket, alignment, curve, &merging, ghosts.as_ref())?;
    let merging = merging.with_local_gain(local.as_ref())?;
    let (mut rows, bounds) = RadianceRows::merged(&merging, &Room::of(bracket, merging.size(), options))?;
    let merged = merging.merged(bounds);
    let limits = if local.is_none() { Limits::of(bracket, alignment, curve)? } else { None };
    let mut flare = None;
    if options.flare {
        let found = found(&rows)?;
        flare = Some(found.as_ref().map_or_else(FlareReport::default, Flare::report));
        if let Some(found) = found {
            rows = rows.changed(|first, mut map| {
                found.subtract(first, &mut map.pixels);
                map
            })?;
        }
    }
    // The exposures of rejected frames count too, because they show which brightness the photographer intended.
    let exposures = bracket.frames().iter().map(|frame| frame.exposure.relative());
    let photographed = Photographed::of(exposures, bracket.reference().exposure.relative(), curve);
    let photographed = match &local {
        Some(local) => photographed.map(|photographed| local.photographed(photographed)),
        None => photographed,
    };
    let calibrated = calibration.as_ref().map(|calibration| calibration.cd_m2_per_unit);
    let normalised = |unit| normalisation::factor(unit, merged.reference_exposure);
    let factor = calibrated.or(options.unit_exposure.map(normalised));
    let mut outside = 0;
    // The primaries of a sensor are not those of a space in which pictures are kept.
    let colour = options.colour.or(bracket.reference().is_raw().then_some(Space::Srgb));
    if colour.is_some() || factor.is_some() {
        rows = rows.changed(|_, map| {
            let (mut map, drawn) = match colour {
                Some(space) => gamut::converted(map, space),
                None => (map, 0),
            };
            outside += drawn;
            if let Some(factor) = factor {
                calibration::calibrate(&mut map, factor);
            }
            map
        })?;
    }
    let mut tally = Tally::default();
    rows.each(|_, map| {
        tally.see(&map.pixels, gamut::weights(&map.primaries));
        Ok(())
    })?;
    let statistics = tally.statistics(calibration.as_ref().map_or(Unit::Relative, |_| Unit::CdM2));
    let photographed = photographed.map(|photographed| photographed.times(factor.unwrap_or(1.0)));
    let limits = limits.map(|limits| limits.times(factor.unwrap_or(1.0)));
    let radiance =
        Radiance { rows, photographed, merged, limits, ghosts, flare, local, tally, statistics, calibration };
    Ok((radiance, gamut::warning(outside)))
}

/// Returns the flare in `rows`, or `None` if there is none.
fn found(rows: &RadianceRows) -> Result<Option<Flare>> {
    let mut cells = flare::Cells::new(rows.size().0, rows.size().1);
    rows.each(|_, map| {
        cells.see(&map.pixels);
        Ok(())
    })?;
    Ok(cells.flare())
}

/// The number of rows of radiance that are in memory at a time.
enum Room {
    /// All rows.
    Enough,
    /// At most this number of rows; the radiance of all rows is written to this file.
    Rows(usize, Arc<Scratch>),
}

impl Room {
    /// Chooses the number of rows by the memory that the `bracket` leaves for radiance of this size.
    fn of(bracket: &Bracket, (width, height): (usize, usize), options: &Options) -> Room {
        let (Some(scratch), Some(budget)) = (bracket.scratch(), bracket.budget()) else { return Room::Enough };
        // A row takes the bytes of this row in all frames, a quarter more because frames may have moved, and the bytes
        // of a row of radiance and of a row of the picture.
        let row = bracket.frames().len() as u64 * bracket.reference().row_bytes() * 5 / 4 + 24 * width as u64;
        let rows = (budget.slab(rayon::current_num_threads()) / row) as usize;
        // Parts consist of complete bands or, if flare is subtracted, of complete cells of the flare estimate.
        let unit = if options.flare { flare::Cells::new(width, height).side() } else { BAND_ROWS };
        Room::Rows((rows / unit * unit).max(unit), scratch.clone())
    }
}

/// The rows of a radiance map: all in memory, or in parts on disk.
pub(crate) struct RadianceRows {
    size: (usize, usize),
    primaries: Primaries,
    store: Store,
}

enum Store {
    Held(RadianceMap),
    OnDisk(Vec<Kept<[f32; 3]>>),
}

impl RadianceRows {
    /// Merges all rows. Returns also the numbers of pixels whose radiance is only a bound: those clipped in all frames,
    /// and those black in all frames.
    fn merged(merging: &Merging, room: &Room) -> Result<(Self, (usize, usize))> {
        let (width, height) = merging.size();
        let mut bounds = (0, 0);
        let mut merge = |rows| -> Result<RadianceMap> {
            let slab = merging.slab(rows)?;
            bounds.0 += slab.all_clipped;
            bounds.1 += slab.all_black;
            Ok(slab.map)
        };
        let (primaries, store) = match room {
            Room::Enough => {
                let map = merge(0..height)?;
                (map.primaries, Store::Held(map))
            }
            Room::Rows(rows, scratch) => {
                let mut parts = Vec::new();
                let mut primaries = Primaries::SRGB;
                for first in (0..height).step_by(*rows) {
                    let map = merge(first..(first + rows).min(height))?;
                    primaries = map.primaries;
                    parts.push(scratch.put(map.pixels.as_slice())?);
                }
                (primaries, Store::OnDisk(parts))
            }
        };
        Ok((RadianceRows { size: (width, height), primaries, store }, bounds))
    }

    /// Width and height, in pixels.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// The primaries of the radiance.
    pub fn primaries(&self) -> Primaries {
        self.primaries
    }

    /// Calls `see` with each part and the number of its first row, from top to bottom.
    pub fn each(&self, mut see: impl FnMut(usize, &RadianceMap) -> Result<()>) -> Result<()> {
        match &self.store {
            Store::Held(map) => see(0, map),
            Store::OnDisk(parts) => {
                let mut first = 0;
                for part in parts {
                    let map = self.read(part)?;
                    see(first, &map)?;
                    first += map.pixels.height();
                }
                Ok(())
            }
        }
    }

    /// Replaces each part by the result of `change` for the part and the number of its first row.
    pub fn changed(mut self, mut change: impl FnMut(usize, RadianceMap) -> RadianceMap) -> Result<Self> {
        let mut primaries = self.primaries;
        self.store = match self.store {
            Store::Held(map) => {
                let map = change(0, map);
                primaries = map.primaries;
                Store::Held(map)
            }
            Store::OnDisk(parts) => {
                let before = RadianceRows { store: Store::OnDisk(Vec::new()), ..self };
                let mut first = 0;
                for part in &parts {
                    let map = change(first, before.read(part)?);
                    primaries = map.primaries;
                    part.replace(map.pixels.as_slice())?;
                    first += map.pixels.height();
                }
                Store::OnDisk(parts)
            }
        };
        Ok(RadianceRows { primaries, ..self })
    }

    /// Returns all rows in memory.
    pub fn whole(self) -> Result<RadianceMap> {
        match self.store {
            Store::Held(map) => Ok(map),
            Store::OnDisk(ref parts) => {
                let mut pixels = Vec::with_capacity(self.size.0 * self.size.1);
                for part in parts {
                    pixels.extend(part.get(0..part.len())?);
                }
                Ok(RadianceMap { pixels: Plane::from_vec(self.size.0, self.size.1, pixels), primaries: self.primaries })
            }
        }
    }

    fn read(&self, part: &Kept<[f32; 3]>) -> Result<RadianceMap> {
        let (width, pixels) = (self.size.0, part.get(0..part.len())?);
        let pixels = Plane::from_vec(width, pixels.len() / width, pixels);
        Ok(RadianceMap { pixels, primaries: self.primaries })
    }
}
