//! Slabs: the radiance of a result from top to bottom: all of it in memory or, where memory is limited, one slab after the other, on disk.
//!
//! In: a [`Merging`]. Out: its rows, as often as they are needed, to look at or to change. Cost: that of merging, once; on disk that of
//! writing and reading 12 bytes a pixel.

use crate::bracket::colour::Primaries;
use crate::error::Result;
use crate::merge::{Merging, RadianceMap};
use crate::plane::Plane;
use crate::scratch::{Kept, Scratch};
use std::sync::Arc;

/// How much is in memory at a time.
#[derive(Debug, Clone)]
pub(super) enum Room {
    /// All.
    Enough,
    /// So many rows; the others are on this file.
    Rows(usize, Arc<Scratch>),
}

/// The radiance of a result.
pub(super) struct Slabs {
    size: (usize, usize),
    primaries: Primaries,
    store: Store,
}

enum Store {
    Held(RadianceMap),
    OnDisk(Vec<Kept<[f32; 3]>>),
}

impl Slabs {
    /// All of `merging`, and of how many pixels the radiance is but a bound: clipped in all frames, or black.
    pub fn merged(merging: &Merging, room: &Room) -> Result<(Self, (usize, usize))> {
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
                let mut slabs = Vec::new();
                let mut primaries = Primaries::SRGB;
                for first in (0..height).step_by(*rows) {
                    let map = merge(first..(first + rows).min(height))?;
                    primaries = map.primaries;
                    slabs.push(scratch.put(map.pixels.as_slice())?);
                }
                (primaries, Store::OnDisk(slabs))
            }
        };
        Ok((Slabs { size: (width, height), primaries, store }, bounds))
    }

    /// Width and height, in pixels.
    pub fn size(&self) -> (usize, usize) {
        self.size
    }

    /// What red, green, blue and white are.
    pub fn primaries(&self) -> Primaries {
        self.primaries
    }

    /// Calls `see` with each slab and its first row, from top to bottom.
    pub fn each(&self, mut see: impl FnMut(usize, &RadianceMap) -> Result<()>) -> Result<()> {
        match &self.store {
            Store::Held(map) => see(0, map),
            Store::OnDisk(slabs) => {
                let mut first = 0;
                for slab in slabs {
                    let map = self.read(slab)?;
                    see(first, &map)?;
                    first += map.pixels.height();
                }
                Ok(())
            }
        }
    }

    /// Every slab as `change` makes it from the slab and its first row.
    pub fn changed(mut self, mut change: impl FnMut(usize, RadianceMap) -> RadianceMap) -> Result<Self> {
        let mut primaries = self.primaries;
        self.store = match self.store {
            Store::Held(map) => {
                let map = change(0, map);
                primaries = map.primaries;
                Store::Held(map)
            }
            Store::OnDisk(slabs) => {
                let before = Slabs { store: Store::OnDisk(Vec::new()), ..self };
                let mut first = 0;
                for slab in &slabs {
                    let map = change(first, before.read(slab)?);
                    primaries = map.primaries;
                    slab.replace(map.pixels.as_slice())?;
                    first += map.pixels.height();
                }
                Store::OnDisk(slabs)
            }
        };
        Ok(Slabs { primaries, ..self })
    }

    /// All of it, in memory.
    pub fn whole(self) -> Result<RadianceMap> {
        match self.store {
            Store::Held(map) => Ok(map),
            Store::OnDisk(ref slabs) => {
                let mut pixels = Vec::with_capacity(self.size.0 * self.size.1);
                for slab in slabs {
                    pixels.extend(slab.get(0..slab.len())?);
                }
                Ok(RadianceMap { pixels: Plane::from_vec(self.size.0, self.size.1, pixels), primaries: self.primaries })
            }
        }
    }

    fn read(&self, slab: &Kept<[f32; 3]>) -> Result<RadianceMap> {
        let (width, pixels) = (self.size.0, slab.get(0..slab.len())?);
        let pixels = Plane::from_vec(width, pixels.len() / width, pixels);
        Ok(RadianceMap { pixels, primaries: self.primaries })
    }
}
