//! Inspection of the alignment of a bracket: tables and drawings of the data that it is based on.
//!
//! In: a [`Bracket`], its [`Alignment`] and the options used for it. Out: an [`Inspection`]: `Tables` of exposures, alignment,
//! bitmaps, keypoints and matches; and for each frame [`Sheet`]s of bitmaps, keypoints, matches, XOR curves and edges, drawn on
//! request. Cost: bitmaps and features of all frames, some tenths of a second each, even if the alignment did not need them;
//! the same again for drawing. Source: the tables and figures of chapter 4 of the thesis, for any bracket.

pub(crate) mod files;
pub(crate) mod sheets;
pub(crate) mod tables;
pub(crate) mod text;

use crate::align::diagnostics::{FeatureKind, FrameBitmaps, FrameFeatures, Matching, XorCurves, matchings, xor_curves};
use crate::align::{AlignOptions, Alignment, GreyPyramid, grey_pyramid, searched_pyramid};
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
use strum::VariantArray;
use tables::Tables;

/// Maximum width and height of a drawn frame, in px.
const DRAWN: (usize, usize) = (1600, 1600);
/// Maximum width and height of each of two frames side by side, in px.
const DRAWN_BESIDE: (usize, usize) = (792, 1000);

/// The data that the alignment of one frame is based on.
#[derive(Debug, Clone)]
struct Evidence {
    bitmaps: FrameBitmaps,
    features: FrameFeatures,
    /// `None` for the reference.
    against: Option<Against>,
}

/// Comparison of a frame with the reference.
#[derive(Debug, Clone)]
struct Against {
    xor: XorCurves,
    /// Indexed by [`FeatureKind`].
    matchings: [Matching; 3],
}

/// The data that the alignment of a bracket is based on.
#[derive(Debug, Clone)]
pub struct Inspection<'a> {
    bracket: &'a Bracket,
    alignment: &'a Alignment,
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

/// Content of a sheet; the reference has only the first three kinds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "lowercase")]
pub enum SheetKind {
    /// The median threshold bitmap.
    Threshold,
    /// The exclusion bitmap.
    Exclusion,
    /// Keypoints on the frame.
    Keypoints,
    /// Matches with the reference.
    Matches,
    /// Difference of the bitmaps against rotation and shift.
    Xor,
    /// Edges of frame and reference in two colours, before and after alignment.
    Edges,
}

impl SheetKind {
    /// Returns the extensions of the files it is written to.
    pub fn extensions(self) -> &'static [&'static str] {
        match self {
            SheetKind::Threshold | SheetKind::Exclusion => &["png"],
            _ => &["svg", "png"],
        }
    }
}

/// Collects the evidence for `alignment`, which was computed with `options` and produced `warnings`.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch) if frames on disk cannot be read.
pub fn inspect<'a>(
    bracket: &'a Bracket,
    alignment: &'a Alignment,
    options: &AlignOptions,
    warnings: &[Warning],
) -> Result<Inspection<'a>> {
    gathered(bracket, alignment, options, warnings, &grey_pyramid, &|_| true)
}

/// Like [`inspect`], with less memory and time: for drawings of at most half the size of large frames, and with features only
/// of frames for which `wants_features` returns true.
///
/// # Errors
/// Same as [`inspect`].
pub fn inspect_part<'a>(
    bracket: &'a Bracket,
    alignment: &'a Alignment,
    options: &AlignOptions,
    warnings: &[Warning],
    wants_features: &(dyn Fn(usize) -> bool + Sync),
) -> Result<Inspection<'a>> {
    gathered(bracket, alignment, options, warnings, &searched_pyramid, wants_features)
}

fn gathered<'a>(
    bracket: &'a Bracket,
    alignment: &'a Alignment,
    options: &AlignOptions,
    warnings: &[Warning],
    pyramid: &(dyn Fn(&Frame) -> Result<GreyPyramid> + Sync),
    wants_features: &(dyn Fn(usize) -> bool + Sync),
) -> Result<Inspection<'a>> {
    let pyramids = bracket.map_whole(pyramid).into_iter().collect::<Result<Vec<_>>>()?;
    let base = bracket.reference_index();
    let features = map_at_once(pyramids.len(), bracket.detected_at_once(), |i| match wants_features(i) {
        true => FrameFeatures::new(&pyramids[i], options),
        false => FrameFeatures::none(&pyramids[i]),
    });
    let against = map_at_once(pyramids.len(), bracket.at_once(), |i| {
        (i != base).then(|| Against {
            xor: xor_curves(&pyramids[base], &pyramids[i], alignment.placements[i].transform(), options),
            matchings: matchings(&features[base], &features[i], options),
        })
    });
    let evidence: Vec<Evidence> = features
        .into_iter()
        .zip(against)
        .zip(&pyramids)
        .map(|((features, against), pyramid)| Evidence {
            bitmaps: FrameBitmaps::new(&pyramids[base], pyramid, options),
            features,
            against,
        })
        .collect();
    let mut report = Report::new(bracket, alignment, alignment.overlap);
    report.warnings = warnings.iter().map(WarningReport::from).collect();
    let tables = Tables::new(report, &evidence, alignment);
    Ok(Inspection { bracket, alignment, pyramids, evidence, tables })
}

impl Inspection<'_> {
    /// Returns the tables.
    pub fn tables(&self) -> &Tables {
        &self.tables
    }

    /// Returns the kinds of sheets of frame `i`.
    pub fn kinds(&self, i: usize) -> &'static [SheetKind] {
        let all = SheetKind::VARIANTS;
        if self.evidence[i].against.is_some() { all } else { &all[..3] }
    }

    /// Draws one sheet of frame `i`. Returns `None` if the frame has no such sheet.
    ///
    /// # Errors
    /// A message if a picture is too large for a PNG file.
    pub fn sheet(&self, i: usize, kind: SheetKind) -> std::result::Result<Option<Sheet>, String> {
        let evidence = &self.evidence[i];
        let against = evidence.against.as_ref();
        let drawn = |drawing| Ok(Some(Sheet::Drawing(drawing)));
        match (kind, against) {
            (SheetKind::Threshold | SheetKind::Exclusion, _) => {
                let bitmaps = &evidence.bitmaps.bitmaps;
                let bitmap = if kind == SheetKind::Threshold { &bitmaps.threshold } else { &bitmaps.exclusion };
                let size = (bitmap.width(), bitmap.height());
                Ok(Some(Sheet::Bitmap(png_bits(size, |x, y| bitmap.get(x, y))?)))
            }
            (SheetKind::Keypoints, _) => {
                let photograph = Photograph::new(self.pyramids[i].largest(), DRAWN);
                drawn(keypoints::draw(&self.title(i, "keypoints"), &photograph, &evidence.features)?)
            }
            (SheetKind::Matches, Some(against)) => {
                let [left, right] = [self.bracket.reference_index(), i]
                    .map(|k| (self.name(k), Photograph::new(self.pyramids[k].largest(), DRAWN_BESIDE)));
                let title = self.title(i, "matches with the reference");
                let both = [(left.0.as_str(), &left.1), (right.0.as_str(), &right.1)];
                drawn(matches::draw(&title, both, &against.matchings[FeatureKind::Merged as usize])?)
            }
            (SheetKind::Xor, Some(against)) => {
                let placed = self.alignment.placements[i].transform().is_some();
                drawn(curves::draw(&self.title(i, "bitmaps against the reference's"), &against.xor, placed))
            }
            (SheetKind::Edges, Some(_)) => drawn(views::draw(&self.title(i, "edges"), &self.couple(i))?),
            (SheetKind::Matches | SheetKind::Xor | SheetKind::Edges, None) => Ok(None),
        }
    }

    /// Returns the bitmaps of frame `i`.
    pub fn bitmaps(&self, i: usize) -> &FrameBitmaps {
        &self.evidence[i].bitmaps
    }

    /// Returns the keypoints of frame `i`.
    pub fn features(&self, i: usize) -> &FrameFeatures {
        &self.evidence[i].features
    }

    /// Returns the difference of the bitmaps of frame `i` and the reference, or `None` for the reference.
    pub fn xor(&self, i: usize) -> Option<&XorCurves> {
        self.evidence[i].against.as_ref().map(|a| &a.xor)
    }

    /// Returns the merged matches of frame `i` with the reference, or `None` for the reference.
    pub fn matching(&self, i: usize) -> Option<&Matching> {
        self.evidence[i].against.as_ref().map(|a| &a.matchings[FeatureKind::Merged as usize])
    }

    /// Returns frame `i` in grey with a width and height of at most `most`, and whether it was brightened to be visible.
    pub fn photograph(&self, i: usize, most: (usize, usize)) -> (Plane<u8>, bool) {
        let photograph = Photograph::new(self.pyramids[i].largest(), most);
        (photograph.grey, photograph.brightened)
    }

    /// Returns the edges of frame `i` and the reference in two colours, at most `most` px wide, or `None` for the reference.
    ///
    /// # Errors
    /// A message if the scratch file cannot be read.
    pub fn overlay(&self, i: usize, most: usize) -> std::result::Result<Option<Overlay>, String> {
        if self.evidence[i].against.is_none() {
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
            warp: self.alignment.placements[i].transform(),
        }
    }

    fn frame(&self, i: usize) -> &Frame {
        &self.bracket.frames()[i]
    }

    fn name(&self, i: usize) -> String {
        file_name(&self.frame(i).path().to_string_lossy())
    }

    /// Returns the title of a sheet: frame, content, exposure and alignment status.
    fn title(&self, i: usize, what: &str) -> String {
        let table = &self.tables.frames[i];
        let status = text::status_word(table.report.alignment.status);
        format!("{}: {what} ({} EV, {status})", self.name(i), text::stops(table.relative_ev))
    }
}

#[cfg(test)]
mod tests;
