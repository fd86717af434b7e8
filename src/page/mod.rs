//! The HTML report of a bracket: one self-contained file without external scripts, styles or network access.
//!
//! In: the frames and their alignment; the rows of the picture as they are produced; at the end the [`Report`]. Out:
//! HTML of about 2 MB for any frame size. Cost: an [inspection](crate::inspect), one resampling of every frame, and a
//! second merge of some of the rows to compute the contributions of the frames. Source: the HTML standard (WHATWG);
//! Content Security Policy Level 3 (W3C), which the page declares so that a browser blocks code injected by a file
//! name.

mod document;
mod markup;
mod pictures;
mod plot;
mod sections;

use crate::align::{AlignOptions, Alignment, Motion, Rect, Status};
use crate::bracket::colour::Profile;
use crate::bracket::{Bracket, Frame};
use crate::draw::image::{Photograph, Picture, grey_jpeg, jpeg, jpegs_within};
use crate::draw::scale::{Reduced, within, within_pixels};
use crate::draw::svg::Colour;
use crate::error::{Error, Result, Warning};
use crate::inspect;
use crate::merge::deghost::Ghosts;
use crate::merge::local::LocalGain;
use crate::merge::share::Share;
use crate::merge::{MergeOptions, Merging};
use crate::plane::Plane;
use crate::report::Report;
use crate::response::ResponseCurve;
use pictures::evidence::{self, Evidence};
use pictures::frames;
use pictures::overlays::{self, Local};
use std::io;
use std::path::{Path, PathBuf};

/// Approximate number of pixels of a large result on the page. A smaller result keeps its size (see [`within_pixels`]).
const RESULT_PIXELS: usize = 3_000_000;
/// Approximate number of pixels of all frames on the page together, if they are large.
const FRAMES_PIXELS: usize = 4_500_000;
/// Approximate number of pixels of one large frame on the page, if there are few frames.
const FRAME_PIXELS: usize = 1_500_000;
/// Largest number of bytes of the result on the page. The JPEG quality is chosen accordingly.
const RESULT_BYTES: usize = 620_000;
/// Largest number of bytes of all frames on the page together. The JPEG quality is chosen accordingly.
const FRAMES_BYTES: usize = 720_000;
/// Largest long side of a drawing, in pixels.
const DRAWING: usize = 480;
/// Largest long side of the map of a frame's contribution, in pixels.
const SHARE: usize = 360;
/// JPEG quality of maps in colour.
const FINE: u8 = 82;
/// JPEG quality of small grey pictures and maps.
const COARSE: u8 = 74;

/// The colours of the frames, from violet for the shortest exposure to yellow for the longest, with rising lightness.
const SCALE: [[f64; 3]; 5] =
    [[116.0, 92.0, 176.0], [58.0, 116.0, 186.0], [32.0, 152.0, 150.0], [112.0, 190.0, 92.0], [240.0, 198.0, 52.0]];

/// The data of a page, collected during a run.
#[derive(Debug, Clone, Default)]
pub struct Page {
    path: PathBuf,
    /// ICC profile of the picture; `None` for sRGB.
    icc: Option<Vec<u8>>,
    frames: Vec<FramePage>,
    result: Option<Reduced<3>>,
    /// Histogram of the luminance: index of the first step, and the number of pixels in each step.
    luminance: Option<(i64, Vec<u64>)>,
    curve: Option<ResponseCurve>,
    /// Map of the contributions, in the colours of the frames.
    shares: Option<Picture>,
    /// Overlay of the movement.
    movement: Option<Picture>,
    /// Overlays of the local processing by the camera.
    local: Option<Local>,
    /// Wall time used to collect the data, in seconds.
    time_s: f64,
}

/// The pictures and measurements of one frame that are not in its report.
#[derive(Debug, Clone)]
struct FramePage {
    /// The frame, cropped and aligned like the result. A frame without a transform is not aligned.
    photograph: Picture,
    evidence: Evidence,
    /// Contribution of the frame to the result, 0..=1, and the map of the contribution.
    share: Option<(f64, Picture)>,
}

/// How the frames of a bracket were merged.
#[derive(Debug, Clone, Copy)]
pub struct Developed<'a> {
    /// Camera response.
    pub curve: &'a ResponseCurve,
    /// Options of the merge.
    pub merging: MergeOptions,
    /// Result of deghosting.
    pub ghosts: Option<&'a Ghosts>,
    /// Local gain, if the frames were locally processed.
    pub local: Option<&'a LocalGain>,
}

impl Page {
    /// Number of steps of the luminance histogram per stop.
    pub const PER_STOP: usize = 4;

    /// Creates an empty page that will be written to `path`.
    pub fn new(path: &Path) -> Self {
        Page { path: path.to_owned(), ..Page::default() }
    }

    /// Adds the frames of `bracket`, cropped to `region` of the reference, and, if they were merged, their
    /// contributions.
    ///
    /// `alignment` was computed with `options` and produced `warnings`.
    ///
    /// # Errors
    /// [`Error::Scratch`] if frames on disk cannot be read; [`Error::Write`] if a picture cannot be encoded.
    pub fn gather(
        &mut self,
        bracket: &Bracket,
        alignment: &Alignment,
        region: Rect,
        options: &AlignOptions,
        warnings: &[Warning],
        developed: Option<&Developed>,
    ) -> Result<()> {
        let photographs = photographs(bracket, alignment, region)?;
        let photographs = self.encoded(jpegs_within(FRAMES_BYTES, &photographs))?;
        let needs_features = |i: usize| evidence::needs_features(alignment, i);
        let inspection = inspect::inspect_part(bracket, alignment, options, warnings, &needs_features)?;
        let evidence = self.encoded(evidence::gather(&inspection, alignment, bracket))?;
        drop(inspection);
        self.frames = photographs
            .into_iter()
            .zip(evidence)
            .map(|(photograph, evidence)| FramePage { photograph, evidence, share: None })
            .collect();
        developed.map_or(Ok(()), |developed| self.gather_merged(bracket, alignment, developed))
    }

    /// Adds the response, the contributions and the overlays of the merged frames.
    fn gather_merged(&mut self, bracket: &Bracket, alignment: &Alignment, developed: &Developed) -> Result<()> {
        self.curve = Some(developed.curve.clone());
        let merging = Merging::of(bracket, alignment, developed.curve, &developed.merging, developed.ghosts)?;
        let merging = merging.with_local_gain(developed.local)?;
        let shares = merging.shares(within(merging.size(), SHARE))?;
        self.shares = Some(self.encoded(jpeg(&mixed(&shares, self.frames.len()), FINE, None))?);
        for share in &shares {
            let cells = &share.cells;
            let grey = Plane::from_rows(cells.width(), cells.height(), |y, row: &mut [u8]| {
                row.iter_mut().zip(cells.row(y)).for_each(|(v, s)| *v = (255.0 * s.clamp(0.0, 1.0) + 0.5) as u8);
            });
            self.frames[share.frame].share = Some((share.mean(), self.encoded(grey_jpeg(&grey, COARSE))?));
        }
        if let Some(ghosts) = developed.ghosts.filter(|ghosts| !ghosts.report().regions.is_empty()) {
            self.movement = Some(self.encoded(overlays::movement(&ghosts.mask()))?);
        }
        if let Some(gain) = developed.local {
            let placed: Vec<usize> = alignment.placed(bracket).map(|(i, ..)| i).collect();
            self.local = self.encoded(overlays::local(gain, &placed, merging.size()))?;
        }
        Ok(())
    }

    /// Sets the luminance histogram of the result: index of the first step and number of pixels in each step, with
    /// [`PER_STOP`](Self::PER_STOP) steps per stop.
    pub fn take_luminance(&mut self, luminance: (i64, Vec<u64>)) {
        self.luminance = Some(luminance);
    }

    /// Sets the time used to collect the data, in seconds.
    pub fn take_time(&mut self, time_s: f64) {
        self.time_s = time_s;
    }

    /// Sets the ICC profile of the picture; `None` for sRGB.
    pub fn take_profile(&mut self, profile: Option<Profile>) {
        self.icc = profile.map(|profile| profile.icc);
    }

    /// Adds the next rows of the picture, which has `size` pixels.
    pub fn see(&mut self, size: (usize, usize), rows: &[[u8; 3]]) {
        self.result.get_or_insert_with(|| Reduced::new(size, within_pixels(size, RESULT_PIXELS))).push(rows);
    }

    /// Returns the HTML of the page, including the data of `report`.
    ///
    /// # Errors
    /// [`Error::Write`] if the picture cannot be encoded.
    pub fn to_html(&self, report: &Report) -> Result<String> {
        let photograph = |result: &Reduced<3>| [Photograph { pixels: result.finish(), icc: self.icc.clone() }];
        let result = self.result.as_ref().map(photograph);
        let result = result.map(|picture| self.encoded(jpegs_within(RESULT_BYTES, &picture))).transpose()?;
        Ok(document::html(self, report, result.as_ref().and_then(|pictures| pictures.first())))
    }

    fn encoded<T>(&self, result: std::result::Result<T, String>) -> Result<T> {
        result.map_err(|reason| Error::Write { path: self.path.clone(), source: io::Error::other(reason) })
    }
}

/// Returns the frames with their profiles: aligned, cropped to `region` of the reference, and reduced. Frames without a
/// transform are not aligned.
fn photographs(bracket: &Bracket, alignment: &Alignment, region: Rect) -> Result<Vec<Photograph>> {
    let most = (FRAMES_PIXELS / bracket.frames().len().max(1)).min(FRAME_PIXELS);
    let size = within_pixels((region.width(), region.height()), most);
    let of = |(i, frame): (usize, &Frame)| {
        let still = || Motion::unmoved((bracket.width(), bracket.height()));
        let motion = alignment.motion(bracket, i).unwrap_or_else(still);
        let pixels = frames::frame(frame, &motion, region, size)?;
        Ok(Photograph { pixels, icc: icc(frame) })
    };
    bracket.frames().iter().enumerate().map(of).collect()
}

/// Returns the bytes of the ICC profile of `frame`.
fn icc(frame: &Frame) -> Option<Vec<u8>> {
    frame.profile.as_ref().map(|profile| profile.icc.clone())
}

/// Returns the colour of frame `i` of `count` frames, which are counted from the shortest exposure.
fn frame_colour(i: usize, count: usize) -> Colour {
    Colour::between(&SCALE, if count > 1 { i as f64 / (count - 1) as f64 } else { 0.5 })
}

/// Returns [`frame_colour`] in CSS notation.
fn frame_css(i: usize, count: usize) -> String {
    frame_colour(i, count).hex()
}

/// Mixes the colours of the frames by their contributions; black where no frame contributes.
fn mixed(shares: &[Share], count: usize) -> Plane<[u8; 3]> {
    let Some(first) = shares.first() else { return Plane::filled(1, 1, [0; 3]) };
    Plane::from_rows(first.cells.width(), first.cells.height(), |y, row: &mut [[u8; 3]]| {
        for (x, pixel) in row.iter_mut().enumerate() {
            let channel = |c: usize| -> f32 {
                shares.iter().map(|s| s.cells.at(x, y) * f32::from(frame_colour(s.frame, count).rgb()[c])).sum()
            };
            *pixel = [0, 1, 2].map(|c| (channel(c) + 0.5).min(255.0) as u8);
        }
    })
}

/// Returns true if the alignment of a frame with this `status` was estimated, with or without success.
fn is_searched(status: Status) -> bool {
    matches!(status, Status::Aligned | Status::Assumed | Status::Rejected)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_go_from_violet_to_yellow_and_are_mixed_by_share() {
        assert_eq!((frame_css(0, 5), frame_css(4, 5)), ("#745cb0".into(), "#f0c634".into()));
        assert_eq!(frame_colour(2, 5), frame_colour(0, 1));
        let share = |frame: usize, v: f32| Share { frame, cells: Plane::filled(2, 1, v) };
        assert_eq!(mixed(&[share(0, 0.0), share(1, 1.0)], 2).at(1, 0), [240, 198, 52]);
        // The mean of the first and the last colour is ((116 + 240) / 2, (92 + 198) / 2, (176 + 52) / 2).
        assert_eq!(mixed(&[share(0, 0.5), share(1, 0.5)], 2).at(0, 0), [178, 145, 114]);
    }
}
