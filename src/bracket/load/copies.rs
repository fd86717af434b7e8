//! Finds copies: photographs that are in the bracket twice, under two names.
//!
//! In: size, pixel values and brightness of each photograph. Out: the photographs that have the same pixels as another
//! one. Exposures are not compared here: [`contradiction`] finds copies whose recorded exposure differs from the
//! exposure of the original. Cost: comparing histograms; pixels are compared only where the histograms are equal.
//!
//! Frames that are entirely underexposed or clipped may be equal without being copies, so they are not searched.

use crate::bracket::exposure::brightness::Brightness;
use crate::bracket::window::Store;
use crate::error::{Result, Warning};
use std::path::{Path, PathBuf};

/// The properties of one photograph that are compared.
pub(crate) struct Look<'a> {
    pub path: &'a Path,
    pub size: (usize, usize),
    pub store: &'a Store,
    pub brightness: &'a Brightness,
    pub well_exposed: u64,
}

/// A photograph with the same pixels as another.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Copied {
    copy: usize,
    /// Index of the original: of the photographs with these pixels, the one whose path sorts first.
    original: usize,
    path: PathBuf,
    other: PathBuf,
}

impl Copied {
    pub fn warning(&self) -> Warning {
        Warning::SamePixels { path: self.path.clone(), other: self.other.clone() }
    }
}

/// Returns each photograph that has the same pixels as one whose path sorts before its own. They are sorted by path.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch) where the frames are on disk.
pub(crate) fn find(looks: &[Look]) -> Result<Vec<Copied>> {
    let mut order: Vec<usize> = (0..looks.len()).filter(|&i| looks[i].well_exposed > 0).collect();
    order.sort_by(|&a, &b| looks[a].path.cmp(looks[b].path));
    let mut originals: Vec<usize> = Vec::new();
    let mut copies = Vec::new();
    for copy in order {
        let mut found = None;
        for &original in &originals {
            if found.is_none() && is_copy(&looks[copy], &looks[original])? {
                found = Some(original);
            }
        }
        match found {
            Some(original) => {
                let [path, other] = [copy, original].map(|i| looks[i].path.to_path_buf());
                copies.push(Copied { copy, original, path, other });
            }
            None => originals.push(copy),
        }
    }
    Ok(copies)
}

/// Number of rows compared at a time, which limits the memory needed for frames on disk.
const AT_ONCE: usize = 64;

fn is_copy(a: &Look, b: &Look) -> Result<bool> {
    if a.size != b.size || a.well_exposed != b.well_exposed || !a.brightness.is_like(b.brightness) {
        return Ok(false);
    }
    let height = a.size.1;
    for y in (0..height).step_by(AT_ONCE) {
        let rows = y..(y + AT_ONCE).min(height);
        if a.store.window(a.size, rows.clone())?.codes() != b.store.window(b.size, rows)?.codes() {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Returns a message about the first copy whose exposure in `evs` differs from that of its original; `None` where there
/// is none.
pub(crate) fn contradiction(copies: &[Copied], evs: &[f64]) -> Option<String> {
    copies.iter().find_map(|Copied { copy, original, path, other }| {
        let apart = (evs[*copy] - evs[*original]).abs();
        (apart > ONE_EXPOSURE).then(|| {
            let (path, other) = (path.display(), other.display());
            format!("{path} has the same pixels as {other}, but its exposure differs by {apart:.1} EV")
        })
    })
}

/// Exposures that differ by no more than this, in EV, count as two notations of the same exposure.
const ONE_EXPOSURE: f64 = 0.1;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::Samples;

    /// Returns the copies found among `pictures` of 8 x 100 pixels, as (index of the copy, index of the original).
    fn copies(pictures: &[Samples]) -> Vec<(usize, usize)> {
        let names: Vec<PathBuf> = (0..pictures.len()).map(|i| format!("{i}").into()).collect();
        let brightness: Vec<Brightness> = pictures.iter().map(|p| Brightness::of(p, 8)).collect();
        let stores: Vec<Store> = pictures.iter().map(|p| Store::Held(p.clone())).collect();
        let look = |i: usize| Look {
            path: &names[i],
            size: (8, 100),
            store: &stores[i],
            brightness: &brightness[i],
            well_exposed: crate::bracket::reference::well_exposed(&pictures[i], 8),
        };
        let looks: Vec<Look> = (0..pictures.len()).map(look).collect();
        find(&looks).unwrap().iter().map(|c| (c.copy, c.original)).collect()
    }

    fn picture(code: impl Fn(usize) -> u8) -> Samples {
        Samples::Eight((0..8 * 100 * 3).map(code).collect())
    }

    #[test]
    fn every_pixel_counts() {
        let plain = picture(|i| (i % 200) as u8);
        // The same histogram, but the green values of the last two pixels are exchanged.
        let mut other = plain.clone();
        if let Samples::Eight(v) = &mut other {
            v.swap(2395, 2398);
        }
        assert_eq!(copies(&[plain.clone(), other.clone(), plain.clone(), other]), [(2, 0), (3, 1)]);
        assert_eq!(copies(&[plain.clone(), plain.clone(), plain]), [(1, 0), (2, 0)]);
    }

    #[test]
    fn black_and_white_frames_are_not_copies() {
        assert!(copies(&[picture(|_| 0), picture(|_| 0), picture(|_| 255), picture(|_| 255)]).is_empty());
    }

    #[test]
    fn one_light_has_one_exposure() {
        let copied = Copied { copy: 2, original: 0, path: "c".into(), other: "a".into() };
        assert_eq!(contradiction(std::slice::from_ref(&copied), &[1.0, 5.0, 1.05]), None);
        let said = contradiction(&[copied], &[1.0, 5.0, 3.0]).unwrap();
        assert!(said.contains("c has the same pixels as a") && said.contains("2.0 EV"), "{said}");
    }
}
