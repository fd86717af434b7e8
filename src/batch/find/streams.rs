//! Divides photographs into streams in which the frames of a bracket follow each other, and divides each stream into
//! brackets.
//!
//! In: photographs. Out: [`Found`]. Cost: [`segment`], and sorting the photographs.
//!
//! A stream contains photographs of one camera, one lens, one size and one folder. Photographs with flash and
//! photographs without flash are in different streams. The numbered folders of a memory card (DCF 2.0, section 3.2.3:
//! 100CANON, 101CANON) count as one folder, because the camera may start a new folder within a bracket.

use super::rhythm::{self, Clock, Mode, TimedExposure};
use super::segment::{self, Rules, SAME_STOPS};
use super::twins::Placed;
use super::walk::Place;
use super::{FindOptions, Found, FoundBracket, LeftOver, Reason};
use crate::bracket::header::{ExposureMode, Header};
use crate::error::{Error, Result};
use crate::pipeline::natural;
use rayon::prelude::*;
use std::cmp::Ordering;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Returns an error if an option is invalid.
pub(super) fn check(options: &FindOptions) -> Result<()> {
    if let Some(frames @ (0 | 1)) = options.frames {
        let reason = format!("a bracket has at least 2 photographs, not {frames}");
        return Err(Error::Option { option: "--bracket", reason });
    }
    match options.gap_s {
        Some(gap) if gap.is_nan() || gap < 0.0 => {
            let reason = format!(
                "{gap} s is not a valid pause; give the longest pause allowed between two photographs of a bracket, in seconds"
            );
            Err(Error::Option { option: "--gap", reason })
        }
        _ => Ok(()),
    }
}

/// The properties that all photographs of a stream have in common.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Stream {
    folder: Folder,
    make: Option<String>,
    model: Option<String>,
    serial: Option<String>,
    lens: Option<String>,
    size: (usize, usize),
    flash: bool,
    /// Whether the time of the photographs is known. Photographs without a time are in separate streams, sorted by
    /// name.
    is_timed: bool,
}

/// A folder; the numbered folders of a memory card count as one.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum Folder {
    One(PathBuf),
    Numbered(PathBuf),
}

impl Folder {
    fn of(own: &Path) -> Self {
        let name = own.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let is_numbered = name.len() == 8
            && name.starts_with(|c: char| ('1'..='9').contains(&c))
            && name.bytes().take(3).all(|b| b.is_ascii_digit())
            && name.bytes().skip(3).all(|b| b.is_ascii_alphanumeric() || b == b'_');
        match own.parent() {
            Some(parent) if is_numbered => Folder::Numbered(parent.into()),
            _ => Folder::One(own.into()),
        }
    }
}

/// A bracket. `set` is the number of its panorama within the stream.
struct Grouped {
    place: std::sync::Arc<Place>,
    frames: Vec<Placed>,
    set: usize,
}

/// Returns the brackets among `photographs`. The photographs in no bracket are added to those in `left_over`.
pub(super) fn grouped(photographs: Vec<Placed>, options: &FindOptions, left_over: Vec<LeftOver>) -> Found {
    let mut left_over = left_over;
    let per_stream: Vec<(Vec<Grouped>, Vec<LeftOver>)> =
        if options.by_folder { by_folder(photographs) } else { by_time(photographs, options) };
    // Panoramas are numbered again over all streams, in the order of their first brackets.
    let mut brackets: Vec<(usize, Grouped)> = Vec::new();
    for (stream, (grouped, left)) in per_stream.into_iter().enumerate() {
        left_over.extend(left);
        brackets.extend(grouped.into_iter().map(|bracket| (stream, bracket)));
    }
    brackets.sort_by(|(_, a), (_, b)| {
        let (first, second) = (&a.frames[0].shot, &b.frames[0].shot);
        natural(&a.place.root, &b.place.root)
            .then_with(|| natural(&a.place.folder, &b.place.folder))
            .then_with(|| in_time(&first.header, &second.header))
            .then_with(|| natural(&first.path, &second.path))
    });
    let mut numbers = BTreeMap::new();
    let brackets = brackets
        .into_iter()
        .map(|(stream, bracket)| {
            let next = numbers.len();
            FoundBracket {
                root: bracket.place.root.clone(),
                folder: bracket.place.folder.clone(),
                set: *numbers.entry((stream, bracket.set)).or_insert(next),
                photographs: bracket.frames.into_iter().map(|placed| placed.shot).collect(),
            }
        })
        .collect();
    left_over.sort_by(|a, b| natural(&a.path, &b.path));
    Found { brackets, left_over, other_files: 0 }
}

/// Orders two photographs by time. A photograph with a time comes before one without.
fn in_time(a: &Header, b: &Header) -> Ordering {
    a.taken.is_none().cmp(&b.taken.is_none()).then(a.taken.cmp(&b.taken))
}

fn by_time(photographs: Vec<Placed>, options: &FindOptions) -> Vec<(Vec<Grouped>, Vec<LeftOver>)> {
    let mut streams: BTreeMap<Stream, Vec<Placed>> = BTreeMap::new();
    for placed in photographs {
        let header = &placed.shot.header;
        let stream = Stream {
            folder: Folder::of(&placed.place.own),
            make: header.make.clone(),
            model: header.model.clone(),
            serial: header.serial.clone(),
            lens: header.lens.clone(),
            size: (header.width, header.height),
            flash: header.exposure.flash,
            is_timed: header.taken.is_some(),
        };
        streams.entry(stream).or_default().push(placed);
    }
    let without_flash: BTreeSet<Stream> = streams.keys().filter(|s| !s.flash).cloned().collect();
    streams
        .into_iter()
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|(stream, photographs)| {
            let is_odd = stream.flash && without_flash.contains(&Stream { flash: false, ..stream });
            divided(photographs, options, is_odd)
        })
        .collect()
}

/// Divides the photographs of one stream into brackets and photographs in no bracket. `is_odd` is true if the flash
/// fired for these photographs, but not for other photographs of the same camera and folder.
fn divided(mut photographs: Vec<Placed>, options: &FindOptions, is_odd: bool) -> (Vec<Grouped>, Vec<LeftOver>) {
    let mut left = Vec::new();
    if options.frames.is_none() {
        photographs.retain(|placed| {
            let is_known = placed.shot.header.ev().is_some();
            if !is_known {
                left.push(LeftOver { path: placed.shot.path.clone(), reason: Reason::NoExposure });
            }
            is_known
        });
    }
    sort(&mut photographs);
    let exposures = exposures(&photographs);
    let clock = rhythm::clock(&exposures);
    let rules = Rules { frames: options.frames, gap_s: options.gap_s.unwrap_or(rhythm::GAP_S) };
    let ranges = segment::brackets(&exposures, clock, &rules);
    let sets = sets(&exposures, clock, &ranges);
    let bursts = bursts(&exposures, clock, &ranges);

    let mut grouped: Vec<Grouped> = Vec::with_capacity(ranges.len());
    let mut open = ranges.iter().zip(sets).peekable();
    for (i, placed) in photographs.into_iter().enumerate() {
        while open.next_if(|(range, _)| range.end <= i).is_some() {}
        match open.peek() {
            Some((range, set)) if range.contains(&i) => {
                if range.start == i {
                    grouped.push(Grouped { place: placed.place.clone(), frames: Vec::new(), set: *set });
                }
                if let Some(bracket) = grouped.last_mut() {
                    bracket.frames.push(placed);
                }
            }
            _ => {
                let reason = match (options.frames, bursts[i]) {
                    _ if is_odd => Reason::Flash,
                    (_, Some(count)) => Reason::Burst(count),
                    (Some(frames), None) => Reason::Remainder(frames),
                    (None, None) => Reason::Single,
                };
                left.push(LeftOver { path: placed.shot.path, reason });
            }
        }
    }
    (grouped, left)
}

/// Sorts by time. Photographs with the same time are sorted by folder and name. If, among those of one folder, the
/// numbers rise by more than 5000 from one name to the next, the camera's counter restarted there: 9999 comes before
/// 0001.
fn sort(photographs: &mut [Placed]) {
    let moment = |placed: &Placed| placed.shot.header.taken;
    photographs.sort_by(|a, b| moment(a).cmp(&moment(b)).then_with(|| natural(&a.shot.path, &b.shot.path)));
    let is_one_tick = |a: &Placed, b: &Placed| {
        moment(a).is_some() && moment(a) == moment(b) && a.shot.path.parent() == b.shot.path.parent()
    };
    for tick in photographs.chunk_by_mut(is_one_tick) {
        let numbers: Vec<Option<u32>> = tick.iter().map(|placed| number(&placed.shot.path)).collect();
        let restarted = numbers.windows(2).position(|w| matches!(w, [Some(a), Some(b)] if *b > a + 5000));
        if let Some(at) = restarted {
            tick.rotate_left(at + 1);
        }
    }
}

/// Returns the number that the camera gave to the photograph: the last four digits of the file name.
fn number(path: &Path) -> Option<u32> {
    let stem = path.file_stem()?.to_str()?;
    stem.get(stem.len().checked_sub(4)?..)?.parse().ok()
}

/// Converts the headers of the photographs of a stream to the input of [`segment`].
fn exposures(photographs: &[Placed]) -> Vec<TimedExposure> {
    let begin = photographs.first().and_then(|placed| placed.shot.header.taken);
    // Canon cameras record the frame's position in the bracketing sequence in the maker notes. Other cameras add this
    // position to the recorded exposure compensation.
    let has_places = photographs.iter().any(|p| p.shot.header.bracket_stops.is_some_and(|stops| stops != 0.0));
    photographs
        .iter()
        .map(|placed| {
            let header = &placed.shot.header;
            TimedExposure {
                at_s: begin.and_then(|begin| Some(header.taken?.since(&begin))),
                resolution_s: header.taken.map_or(0.0, |taken| taken.resolution_s()),
                time_s: header.exposure.time_s.map_or(0.0, |(time, _)| time),
                ev: header.ev(),
                mode: match header.mode {
                    Some(ExposureMode::AutoBracket) => Mode::AutoBracket,
                    Some(ExposureMode::Manual) => Mode::Manual,
                    Some(ExposureMode::Automatic) => Mode::Automatic,
                    None => Mode::Unknown,
                },
                place: if has_places { header.bracket_stops } else { header.bias_stops },
                bias: if has_places { header.bias_stops } else { None },
                focal_length_mm: header.focal_length_mm,
            }
        })
        .collect()
}

/// Returns for each bracket the number of its panorama, from 0. A panorama consists of consecutive brackets with the
/// same exposure steps and focal length and with pauses of at most [`rhythm::SET_S`] between them.
fn sets(exposures: &[TimedExposure], clock: Clock, ranges: &[Range<usize>]) -> Vec<usize> {
    let steps = |range: &Range<usize>| {
        let mut evs: Vec<f64> = exposures[range.clone()].iter().filter_map(|b| b.ev).collect();
        evs.sort_by(f64::total_cmp);
        evs
    };
    let is_one_pattern = |a: &Range<usize>, b: &Range<usize>| {
        let (first, second) = (steps(a), steps(b));
        // The tolerance is twice that of single exposures, because each difference contains the rounding errors of
        // two recorded exposures.
        let is_step = |i: usize| ((first[i] - first[0]) - (second[i] - second[0])).abs() < 2.0 * SAME_STOPS;
        !first.is_empty() && a.len() == b.len() && first.len() == second.len() && (0..first.len()).all(is_step)
    };
    let mut set = 0;
    let mut sets = Vec::with_capacity(ranges.len());
    for (i, range) in ranges.iter().enumerate() {
        if i > 0 {
            let earlier = &ranges[i - 1];
            let (last, first) = (&exposures[earlier.end - 1], &exposures[range.start]);
            let is_soon = rhythm::gap(last, first, clock).is_some_and(|pause| pause <= rhythm::SET_S);
            if !(is_soon && segment::is_one_view(last, first) && is_one_pattern(earlier, range)) {
                set += 1;
            }
        }
        sets.push(set);
    }
    sets
}

/// Returns for each photograph the number of photographs in its burst, or `None` if it is in no burst. A burst
/// consists of consecutive photographs that have the same exposure and are in no bracket.
fn bursts(exposures: &[TimedExposure], clock: Clock, ranges: &[Range<usize>]) -> Vec<Option<usize>> {
    let mut is_free = vec![true; exposures.len()];
    ranges.iter().for_each(|range| is_free[range.clone()].fill(false));
    let mut bursts = vec![None; exposures.len()];
    let mut begin = 0;
    for end in 1..=exposures.len() {
        let goes_on = end < exposures.len() && is_free[end - 1] && is_free[end] && {
            let (a, b) = (&exposures[end - 1], &exposures[end]);
            let is_same = matches!((a.ev, b.ev), (Some(a), Some(b)) if (a - b).abs() < SAME_STOPS);
            is_same && rhythm::gap(a, b, clock).is_none_or(|gap| gap <= rhythm::BURST_S)
        };
        if !goes_on {
            if end - begin > 1 {
                bursts[begin..end].fill(Some(end - begin));
            }
            begin = end;
        }
    }
    bursts
}

/// Returns one bracket for each folder. It contains the photographs that have the most frequent size in the folder;
/// photographs of other sizes are in no bracket.
fn by_folder(photographs: Vec<Placed>) -> Vec<(Vec<Grouped>, Vec<LeftOver>)> {
    let mut folders: BTreeMap<PathBuf, Vec<Placed>> = BTreeMap::new();
    for placed in photographs {
        folders.entry(placed.place.own.clone()).or_default().push(placed);
    }
    folders
        .into_values()
        .map(|mut photographs| {
            sort(&mut photographs);
            let size = |placed: &Placed| (placed.shot.header.width, placed.shot.header.height);
            let mut sizes: BTreeMap<(usize, usize), usize> = BTreeMap::new();
            photographs.iter().for_each(|placed| *sizes.entry(size(placed)).or_insert(0) += 1);
            // If several sizes are equally frequent, the largest is used, because small photographs are probably
            // previews.
            let most = sizes.into_iter().max_by_key(|&(size, count)| (count, size)).map_or((0, 0), |(size, _)| size);
            let (frames, others): (Vec<_>, Vec<_>) = photographs.into_iter().partition(|placed| size(placed) == most);
            let mut left: Vec<LeftOver> = others
                .into_iter()
                .map(|placed| {
                    let reason = Reason::OtherSize(size(&placed), most);
                    LeftOver { path: placed.shot.path, reason }
                })
                .collect();
            if frames.len() < 2 {
                left.extend(frames.into_iter().map(|p| LeftOver { path: p.shot.path, reason: Reason::Alone }));
                return (Vec::new(), left);
            }
            let place = frames[0].place.clone();
            (vec![Grouped { place, frames, set: 0 }], left)
        })
        .collect()
}
