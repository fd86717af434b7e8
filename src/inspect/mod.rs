//! Inspection of the alignment of a bracket: tables and drawings of the data on which the alignment is based.
//!
//! In: a [`Bracket`], its [`Alignment`], and the options used for it. Out: an [`Inspection`]. It contains `Tables` of
//! exposures, alignment, bitmaps, keypoints and matches. On request, it draws [`Sheet`]s for each frame: bitmaps,
//! keypoints, matches, XOR curves and edges. Cost: bitmaps, SIFT and SURF features of all frames are computed, even if
//! the alignment did not need them. This takes some tenths of a second for each frame and detector; drawing takes as
//! long again. Source: the tables and figures in chapter 4 of the thesis that hdralign is based on; here they can be
//! made for any bracket.

pub(crate) mod files;
pub(crate) mod sheets;
pub(crate) mod tables;
pub(crate) mod text;

use crate::align::diagnostics::{FeatureKind, FrameBitmaps, FrameFeatures, Matching, XorCurves, matchings, xor_curves};
use crate::align::features::Detector;
use crate::align::{AlignMode, AlignOptions, Alignment, GreyPyramid, grey_pyramid, searched_pyramid};
use crate::bracket::{Bracket, Frame};
use crate::draw::image::png_bits;
use crate::draw::markup::file_name;
use crate::draw::svg::Drawing;
use crate::error::{Result, Warning};
use crate::plane::{Plane, map_at_once};
use crate::report::{Report, WarningReport};
use sheets::overlay::{self, Overlay};
use sheets::photograph::Photograph;
use sheets::views::{self, Couple};
use sheets::{curves, keypoints, matches};
use std::time::Instant;
use strum::VariantArray;
use tables::{DetectorTimes, Tables};

/// Maximum width and height of a drawn frame, in px.
const DRAWN: (usize, usize) = (1600, 1600);
/// Maximum width and height of each frame when two frames are drawn side by side, in px.
const DRAWN_BESIDE: (usize, usize) = (792, 1000);

/// The data on which the alignment of one frame is based.
#[derive(Debug, Clone)]
struct Evidence {
    bitmaps: FrameBitmaps,
    /// Difference between the bitmaps of this frame and of the reference frame; `None` for the reference frame
    /// itself.
    xor: Option<XorCurves>,
    sift: Detected,
    surf: Detected,
}

/// The features that one detector found in a frame, and their matches.
#[derive(Debug, Clone)]
struct Detected {
    features: FrameFeatures,
    /// Matches between this frame and the reference frame, indexed by [`FeatureKind`]; `None` for the reference
    /// frame.
    matchings: Option<[Matching; 3]>,
}

/// The data on which the alignment of a bracket is based.
#[derive(Debug, Clone)]
pub struct Inspection<'a> {
    bracket: &'a Bracket,
    alignment: &'a Alignment,
    /// The alignment method. The features of its detector (SIFT or SURF) are drawn.
    mode: AlignMode,
    pyramids: Vec<GreyPyramid>,
    evidence: Vec<Evidence>,
    tables: Tables,
}

/// A bitmap or drawing of a frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Sheet {
    /// A bitmap as a PNG file with one bit per pixel.
    Bitmap(Vec<u8>),
    /// A drawing that can be saved as SVG and PNG.
    Drawing(Drawing),
}

/// The content of a sheet. The reference frame has only sheets of the first three kinds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "lowercase")]
pub enum SheetKind {
    /// The median threshold bitmap.
    Threshold,
    /// The exclusion bitmap.
    Exclusion,
    /// The keypoints, drawn on the frame.
    Keypoints,
    /// The matches between the frame and the reference frame.
    Matches,
    /// The fraction of the compared pixels that differ between frame and reference frame, plotted over rotation and
    /// shift.
    Xor,
    /// The edges of the frame and of the reference frame in two colours, before and after alignment.
    Edges,
}

impl SheetKind {
    /// Returns the extensions of the files that are written for a sheet of this kind.
    pub fn extensions(self) -> &'static [&'static str] {
        match self {
            SheetKind::Threshold | SheetKind::Exclusion => &["png"],
            _ => &["svg", "png"],
        }
    }
}

/// Collects the data on which `alignment` is based. `options` are the options with which it was computed, and
/// `warnings` the warnings that it produced.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch) if frames on disk cannot be read.
pub fn inspect<'a>(
    bracket: &'a Bracket,
    alignment: &'a Alignment,
    options: &AlignOptions,
    warnings: &[Warning],
) -> Result<Inspection<'a>> {
    gathered(bracket, alignment, options, warnings, &grey_pyramid, &|_, _| true)
}

/// Does the same as [`inspect`] with less memory and time. A large frame is drawn at no more than half its size.
/// Features are computed only by the detector of `options`, and only for frames for which `wants_features` returns
/// true.
///
/// # Errors
/// Those of [`inspect`].
pub fn inspect_part<'a>(
    bracket: &'a Bracket,
    alignment: &'a Alignment,
    options: &AlignOptions,
    warnings: &[Warning],
    wants_features: &(dyn Fn(usize) -> bool + Sync),
) -> Result<Inspection<'a>> {
    let used = options.detector();
    gathered(bracket, alignment, options, warnings, &searched_pyramid, &|i, by| *by == used && wants_features(i))
}

fn gathered<'a>(
    bracket: &'a Bracket,
    alignment: &'a Alignment,
    options: &AlignOptions,
    warnings: &[Warning],
    pyramid: &(dyn Fn(&Frame) -> Result<GreyPyramid> + Sync),
    wants_features: &(dyn Fn(usize, &Detector) -> bool + Sync),
) -> Result<Inspection<'a>> {
    let pyramids = bracket.map_whole(pyramid).into_iter().collect::<Result<Vec<_>>>()?;
    let base = bracket.reference_index();
    let detected = |detector: Detector| -> (Vec<Detected>, f64) {
        let start = Instant::now();
        let features =
            map_at_once(pyramids.len(), bracket.detected_at_once(), |i| match wants_features(i, &detector) {
                true => FrameFeatures::new(&pyramids[i], &detector, options),
                false => FrameFeatures::none(&pyramids[i]),
            });
        let matched = map_at_once(pyramids.len(), bracket.at_once(), |i| {
            (i != base).then(|| matchings(&features[base], &features[i], options))
        });
        let both = features.into_iter().zip(matched).map(|(features, matchings)| Detected { features, matchings });
        (both.collect(), start.elapsed().as_secs_f64())
    };
    let (sift, sift_s) = detected(Detector::Sift(options.sift.clone()));
    let (surf, surf_s) = detected(Detector::Surf(options.surf.clone()));
    let xor = map_at_once(pyramids.len(), bracket.at_once(), |i| {
        let transform = alignment.placements[i].transform();
        (i != base).then(|| xor_curves(&pyramids[base], &pyramids[i], transform, options))
    });
    let evidence: Vec<Evidence> = (pyramids.iter().zip(xor))
        .zip(sift.into_iter().zip(surf))
        .map(|((pyramid, xor), (sift, surf))| Evidence {
            bitmaps: FrameBitmaps::new(&pyramids[base], pyramid, options),
            xor,
            sift,
            surf,
        })
        .collect();
    let mut report = Report::new(bracket, alignment, alignment.overlap);
    report.warnings = warnings.iter().map(WarningReport::from).collect();
    let tables = Tables::new(report, &evidence, alignment, DetectorTimes { sift_s, surf_s });
    Ok(Inspection { bracket, alignment, mode: options.mode, pyramids, evidence, tables })
}

impl Inspection<'_> {
    /// Returns the tables.
    pub fn tables(&self) -> &Tables {
        &self.tables
    }

    /// Returns the kinds of sheets of frame `i`.
    pub fn kinds(&self, i: usize) -> &'static [SheetKind] {
        let all = SheetKind::VARIANTS;
        if self.evidence[i].xor.is_some() { all } else { &all[..3] }
    }

    /// Draws one sheet of frame `i`. Returns `None` if the frame has no such sheet.
    ///
    /// # Errors
    /// A message if a picture is too large for a PNG file.
    pub fn sheet(&self, i: usize, kind: SheetKind) -> std::result::Result<Option<Sheet>, String> {
        let bitmaps = &self.evidence[i].bitmaps.bitmaps;
        let is_reference = i == self.bracket.reference_index();
        let drawn = |drawing| Ok(Some(Sheet::Drawing(drawing)));
        match kind {
            SheetKind::Threshold | SheetKind::Exclusion => {
                let bitmap = if kind == SheetKind::Threshold { &bitmaps.threshold } else { &bitmaps.exclusion };
                let size = (bitmap.width(), bitmap.height());
                Ok(Some(Sheet::Bitmap(png_bits(size, |x, y| bitmap.get(x, y))?)))
            }
            SheetKind::Keypoints => {
                let photograph = Photograph::new(self.pyramids[i].largest(), DRAWN);
                drawn(keypoints::draw(&self.title(i, "keypoints"), &photograph, self.features(i))?)
            }
            SheetKind::Matches => {
                let Some(matching) = self.matching(i) else { return Ok(None) };
                let [left, right] = [self.bracket.reference_index(), i]
                    .map(|k| (self.name(k), Photograph::new(self.pyramids[k].largest(), DRAWN_BESIDE)));
                let title = self.title(i, "matches with the reference");
                let both = [(left.0.as_str(), &left.1), (right.0.as_str(), &right.1)];
                drawn(matches::draw(&title, both, matching)?)
            }
            SheetKind::Xor => {
                let Some(xor) = self.xor(i) else { return Ok(None) };
                let placed = self.alignment.placements[i].transform().is_some();
                drawn(curves::draw(&self.title(i, "bitmaps against the reference's"), xor, placed))
            }
            SheetKind::Edges if is_reference => Ok(None),
            SheetKind::Edges => drawn(views::draw(&self.title(i, "edges"), &self.couple(i))?),
        }
    }

    /// Returns the bitmaps of frame `i`.
    pub fn bitmaps(&self, i: usize) -> &FrameBitmaps {
        &self.evidence[i].bitmaps
    }

    /// Returns the features that the detector of the alignment found in frame `i`.
    fn detected(&self, i: usize) -> &Detected {
        let evidence = &self.evidence[i];
        if self.mode == AlignMode::Surf { &evidence.surf } else { &evidence.sift }
    }

    /// Returns the keypoints that the detector of the alignment found in frame `i`.
    pub fn features(&self, i: usize) -> &FrameFeatures {
        &self.detected(i).features
    }

    /// Returns the difference between the bitmaps of frame `i` and of the reference frame; `None` for the reference
    /// frame.
    pub fn xor(&self, i: usize) -> Option<&XorCurves> {
        self.evidence[i].xor.as_ref()
    }

    /// Returns the matches between frame `i` and the reference frame; `None` for the reference frame. The list
    /// contains the matches of keypoints in the photographs and of keypoints in their bitmaps.
    pub fn matching(&self, i: usize) -> Option<&Matching> {
        self.detected(i).matchings.as_ref().map(|all| &all[FeatureKind::Merged as usize])
    }

    /// Returns the grey values of frame `i`, with a width and height of at most `most`, and whether they were
    /// brightened because the frame is dark.
    pub fn photograph(&self, i: usize, most: (usize, usize)) -> (Plane<u8>, bool) {
        let photograph = Photograph::new(self.pyramids[i].largest(), most);
        (photograph.grey, photograph.brightened)
    }

    /// Returns the edges of frame `i` and of the reference frame in two colours, at most `most` px wide; `None` for
    /// the reference frame.
    ///
    /// # Errors
    /// A message if the scratch file cannot be read.
    pub fn overlay(&self, i: usize, most: usize) -> std::result::Result<Option<Overlay>, String> {
        if i == self.bracket.reference_index() {
            return Ok(None);
        }
        overlay::of(&self.couple(i), most).map(Some)
    }

    fn couple(&self, i: usize) -> Couple<'_> {
        Couple {
            reference: self.bracket.reference(),
            frame: self.frame(i),
            reference_grey: self.pyramids[self.bracket.reference_index()].largest(),
            frame_grey: self.pyramids[i].largest(),
            motion: self.alignment.motion(self.bracket, i),
        }
    }

    fn frame(&self, i: usize) -> &Frame {
        &self.bracket.frames()[i]
    }

    fn name(&self, i: usize) -> String {
        file_name(&self.frame(i).path().to_string_lossy())
    }

    /// Returns the title of a sheet: the name of the frame, what is drawn, the exposure and the alignment status.
    fn title(&self, i: usize, what: &str) -> String {
        let table = &self.tables.frames[i];
        let status = text::status_word(table.report.alignment.status);
        format!("{}: {what} ({} EV, {status})", self.name(i), text::stops(table.relative_ev))
    }
}

#[cfg(test)]
mod tests;
