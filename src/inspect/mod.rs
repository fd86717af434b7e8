//! Inspection: what the alignment of a bracket rests on, in tables and drawings, for people who look before, or want to find out why.
//!
//! In: a [`Bracket`], its [`Alignment`] and the options that it was found with. Out: an [`Inspection`]: `Tables` of exposures, places,
//! bitmaps, keypoints and matches; for each frame its bitmaps, keypoints, matches, XOR curves and edges, as [`Sheet`]s, drawn when asked
//! for. Cost: bitmaps and features of all frames, some tenths of a second each, whatever the alignment needed itself; and the same again to
//! draw. Source: the thesis's chapter 4, its tables and figures, for any bracket.

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

/// Long side of a drawn photograph, in pixels, at the most.
const DRAWN: (usize, usize) = (1600, 1600);
/// ... of one of two side by side.
const DRAWN_BESIDE: (usize, usize) = (792, 1000);

/// What one frame's place rests on.
#[derive(Debug, Clone)]
struct Evidence {
    bitmaps: FrameBitmaps,
    features: FrameFeatures,
    /// None for the reference.
    against: Option<Against>,
}

/// How a frame compares with the reference.
#[derive(Debug, Clone)]
struct Against {
    xor: XorCurves,
    /// By [`FeatureKind`].
    matchings: [Matching; 3],
}

/// What the alignment of a bracket rests on.
#[derive(Debug, Clone)]
pub struct Inspection<'a> {
    bracket: &'a Bracket,
    alignment: &'a Alignment,
    pyramids: Vec<GreyPyramid>,
    evidence: Vec<Evidence>,
    tables: Tables,
}

/// One thing to look at.
#[derive(Debug, Clone, PartialEq)]
pub enum Sheet {
    /// A bitmap, one bit a pixel, as a PNG file.
    Bitmap(Vec<u8>),
    /// A drawing, for SVG and PNG.
    Drawing(Drawing),
}

/// What a sheet shows; of the reference there are only the first three kinds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, strum::IntoStaticStr, strum::VariantArray)]
#[strum(serialize_all = "lowercase")]
pub enum SheetKind {
    /// The median threshold bitmap.
    Threshold,
    /// What of it counts.
    Exclusion,
    /// Keypoints on the frame.
    Keypoints,
    /// Matches with the reference.
    Matches,
    /// What differs between the bitmaps against rotation and shift.
    Xor,
    /// Edges in two colours, before and after.
    Edges,
}

impl SheetKind {
    /// The extensions under which it is written.
    pub fn extensions(self) -> &'static [&'static str] {
        match self {
            SheetKind::Threshold | SheetKind::Exclusion => &["png"],
            _ => &["svg", "png"],
        }
    }
}

/// Gathers what speaks for and against every place of `alignment`, which was found with `options` and gave `warnings`.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch), where frames are on disk.
pub fn inspect<'a>(
    bracket: &'a Bracket,
    alignment: &'a Alignment,
    options: &AlignOptions,
    warnings: &[Warning],
) -> Result<Inspection<'a>> {
    gathered(bracket, alignment, options, warnings, &grey_pyramid, &|_| true)
}

/// As [`inspect`], but in less memory and time: for drawings of at most half the size of large frames, and with features only of the frames
/// of which `wants_features` says so.
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
    /// The tables.
    pub fn tables(&self) -> &Tables {
        &self.tables
    }

    /// The kinds of sheets that there are of frame `i`.
    pub fn kinds(&self, i: usize) -> &'static [SheetKind] {
        let all = SheetKind::VARIANTS;
        if self.evidence[i].against.is_some() { all } else { &all[..3] }
    }

    /// Draws one sheet of frame `i`; none where the frame has no such sheet.
    ///
    /// # Errors
    /// In words, where a picture is too large for a PNG file.
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
                let [left, right] =
                    [self.bracket.reference_index(), i].map(|k| (self.name(k), self.photograph_beside(k)));
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

    /// The bitmaps of frame `i`.
    pub fn bitmaps(&self, i: usize) -> &FrameBitmaps {
        &self.evidence[i].bitmaps
    }

    /// The keypoints of frame `i`.
    pub fn features(&self, i: usize) -> &FrameFeatures {
        &self.evidence[i].features
    }

    /// What differs between the bitmaps of frame `i` and the reference's; none for the reference.
    pub fn xor(&self, i: usize) -> Option<&XorCurves> {
        self.evidence[i].against.as_ref().map(|a| &a.xor)
    }

    /// The matches of frame `i` with the reference, plain and of bitmaps together; none for the reference.
    pub fn matching(&self, i: usize) -> Option<&Matching> {
        self.evidence[i].against.as_ref().map(|a| &a.matchings[FeatureKind::Merged as usize])
    }

    /// Frame `i` in grey, in at most `most` pixels across and down, and as it is drawn: bright enough to see, and whether it was brightened for
    /// that.
    pub fn photograph(&self, i: usize, most: (usize, usize)) -> (Plane<u8>, bool) {
        let photograph = Photograph::new(self.pyramids[i].largest(), most);
        (photograph.grey, photograph.brightened)
    }

    /// Frame `i` over the reference, edges in two colours, on pictures of at most `most` pixels across; none for the reference.
    ///
    /// # Errors
    /// In words, where the scratch file cannot be read.
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

    fn photograph_beside(&self, i: usize) -> Photograph {
        Photograph::new(self.pyramids[i].largest(), DRAWN_BESIDE)
    }

    fn name(&self, i: usize) -> String {
        file_name(&self.frame(i).path().to_string_lossy())
    }

    /// What is seen, of which frame, and how it was exposed and placed.
    fn title(&self, i: usize, what: &str) -> String {
        let table = &self.tables.frames[i];
        let status = text::status_word(table.report.alignment.status);
        format!("{}: {what} ({} EV, {status})", self.name(i), text::stops(table.relative_ev))
    }
}

#[cfg(test)]
mod tests;
