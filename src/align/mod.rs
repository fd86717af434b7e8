//! Alignment: the transform of every frame to the reference, with an error estimate and a confidence.
//!
//! In: a [`Bracket`]. Out: an [`Alignment`]: for each frame a [`Placement`] with the transform of the smallest
//! sufficient [`Model`], always directly to the reference. Cost: if the first method suffices, about 0.1 s of one core
//! for a frame of 1.5 MP and 0.3 s for a frame of 8 MP; up to ten times as much for a difficult frame.
//!
//! The sub-modules. Each uses only modules that come before it in this list, or in the same item:
//!
//! 1. `transform`: transforms and their models. [`motion`]: where a frame shows each pixel, by a transform, a bend, or
//!    at its depth.
//!    `result`: the types that the alignment returns.
//! 2. [`grey`]: grey pyramids. [`resampling`]: interpolation kernels, and resampling of rows. [`photometric`]:
//!    conversion of two frames to a common exposure.
//! 3. [`bitmaps`]: median threshold bitmaps (Ward 2003). [`features`]: SIFT, SURF, matching, RANSAC, LMedS. These two
//!    modules do not use each other.
//! 4. [`refinement`]: Lucas & Kanade's iterative alignment on the pixels. [`agreement`]: the check of a transform, tile
//!    by tile.
//! 5. [`preset`] and [`transforms_file`]: transforms that are not estimated, and their file.
//! 6. `local`: finds the parts of the picture that a transform does not fit.
//! 7. `ladder`: the order of the methods, and the choice among the transforms that they find. `diagnostics`: the data
//!    that the command `inspect` shows.
//! 8. `following`: the motion of each frame where one homography does not suffice: by the lens, the shutter, or depth.
//!
//! The mode `auto` tries methods from the cheapest to the most expensive, and stops as soon as the tiles of the picture
//! agree with the transform. The methods are: comparison of bitmaps with the reference; comparison of bitmaps with a
//! neighbour in exposure; features; the other minima of the bitmap search. Every transform found is refined on the
//! pixels and then checked by [`agreement`]. There are three exceptions: transforms inferred from other frames
//! ([assumed](Placement::Assumed)), frames that are left unmoved, and the dominant motion, which is fitted afterwards
//! to the displacements of small patches (`local`).

#[doc(hidden)]
pub mod agreement;
#[doc(hidden)]
pub mod bitmaps;
pub(crate) mod diagnostics;
#[doc(hidden)]
pub mod features;
mod following;
#[doc(hidden)]
pub mod grey;
mod ladder;
mod local;
pub mod motion;
#[doc(hidden)]
pub mod photometric;
pub mod preset;
#[doc(hidden)]
pub mod refinement;
#[doc(hidden)]
pub mod resampling;
mod result;
#[cfg(test)]
pub(crate) mod scene;
pub(crate) mod transform;
pub mod transforms_file;

use crate::bracket::Bracket;
use crate::error::{Error, Result, Warning};
use bitmaps::MtbOptions;
pub use features::RobustMethod;
use features::{Detector, RansacOptions, SiftOptions, SurfOptions};
#[doc(hidden)]
pub use grey::{GreyPyramid, grey_pyramid, searched_pyramid};
use ladder::search;
pub use motion::{Bend, Cause, Followed, Motion, Relief};
use preset::Preset;
pub use result::{Alignment, Displaced, Estimate, FeatureCounts, KeypointCounts, Placement, Rect, RejectedBy, Status};
use result::{unmoved_but, warnings};
pub use transform::{Model, Transform};

/// Alignment method.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[serde(rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum AlignMode {
    /// Tries a fast method first (median threshold bitmaps, then refinement on the pixels), and image features only if
    /// necessary. Every result is checked. A frame that is too dark or too bright to align gets a transform estimated
    /// from the other frames, or is rejected.
    #[default]
    Auto,
    /// Median threshold bitmaps only: shift and rotation.
    Mtb,
    /// SIFT features only: a homography, which also corrects tilt.
    Sift,
    /// SURF features only, for a homography. It finds about twice as many matching details as SIFT.
    Surf,
    /// No alignment.
    None,
}

/// Whether [`AlignMode::Auto`] follows what one homography for each frame cannot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[serde(rename_all = "kebab-case")]
#[strum(serialize_all = "kebab-case")]
pub enum Local {
    /// If only the camera moved, but one homography for each frame does not align everything: the distortion of the
    /// lens is measured, or the motion while the rows were read (rolling shutter), or the depth of the scene
    /// (parallax).
    #[default]
    Auto,
    /// One homography aligns all pixels of a frame.
    Off,
}

/// How frames are aligned.
#[derive(Debug, Clone, PartialEq)]
pub struct AlignOptions {
    /// The alignment method.
    pub mode: AlignMode,
    /// Whether the mode [`AlignMode::Auto`] follows what one homography for each frame cannot.
    pub local: Local,
    /// Options of the bitmaps and their search.
    pub mtb: MtbOptions,
    /// Options of SIFT, the feature detector of all methods but [`AlignMode::Surf`].
    pub sift: SiftOptions,
    /// Options of SURF.
    pub surf: SurfOptions,
    /// Largest ratio at which a match is accepted. The ratio is the distance of a descriptor to the nearest descriptor
    /// of the other frame, divided by its distance to the second nearest (Lowe 2004, section 7.1).
    pub ratio: f64,
    /// Transforms that are preset instead of estimated; if a frame has several, the first is used.
    pub given: Vec<Preset>,
    /// The robust estimator that separates inliers from wrong matches.
    pub robust: RobustMethod,
    /// Options of the robust estimator; the threshold is in pixels of the pyramid level on which features are detected.
    pub ransac: RansacOptions,
}

impl Default for AlignOptions {
    fn default() -> Self {
        AlignOptions {
            mode: AlignMode::Auto,
            local: Local::Auto,
            mtb: MtbOptions::default(),
            sift: SiftOptions::default(),
            surf: SurfOptions::default(),
            given: Vec::new(),
            ratio: 0.8,
            robust: RobustMethod::default(),
            ransac: RansacOptions::default(),
        }
    }
}

impl AlignOptions {
    /// Returns whether bends and depth are measured where one homography does not suffice.
    pub fn follows(&self) -> bool {
        self.mode == AlignMode::Auto && self.local == Local::Auto
    }

    /// Returns the feature detector of the [mode](Self::mode): SURF for [`AlignMode::Surf`], otherwise SIFT.
    pub(crate) fn detector(&self) -> Detector {
        match self.mode {
            AlignMode::Surf => Detector::Surf(self.surf.clone()),
            _ => Detector::Sift(self.sift.clone()),
        }
    }

    /// Checks the numbers against their ranges; [`align`] checks the preset transforms ([`given`](Self::given)).
    ///
    /// # Errors
    /// [`Error::Option`] for the first number that is out of range.
    pub fn validate(&self) -> Result<()> {
        let numbers = |options: &AlignOptions| {
            let (mtb, ransac) = (&options.mtb, &options.ransac);
            let (sift, surf) = (&options.sift, &options.surf);
            [
                ("--max-rotation", mtb.max_rotation_deg, 0.0..=45.0, " degrees"),
                ("mtb.max_shift", mtb.max_shift, 0.0..=1.0, " of the long side"),
                ("sift.intervals", sift.intervals as f64, 1.0..=16.0, ""),
                ("sift.sigma", sift.sigma, 0.5..=10.0, " pixels"),
                ("sift.contrast", sift.contrast, 0.0..=1.0, ""),
                ("sift.edge_ratio", sift.edge_ratio, 1.0..=1e6, ""),
                ("sift.max_keypoints", sift.max_keypoints as f64, 1.0..=f64::INFINITY, ""),
                ("surf.octaves", surf.octaves as f64, 1.0..=8.0, ""),
                ("surf.contrast", surf.contrast, 0.0..=1.0, ""),
                ("surf.max_keypoints", surf.max_keypoints as f64, 1.0..=f64::INFINITY, ""),
                ("ratio", options.ratio, 0.0..=1.0, ""),
                ("ransac.threshold", ransac.threshold, 1e-3..=1e3, " pixels"),
                ("ransac.confidence", ransac.confidence, 0.0..=1.0, ""),
                ("ransac.max_trials", ransac.max_trials as f64, 1.0..=f64::INFINITY, ""),
            ]
        };
        let usual = numbers(&AlignOptions::default()).map(|(_, value, ..)| value);
        for ((option, value, range, unit), usual) in numbers(self).into_iter().zip(usual) {
            if !range.contains(&value) {
                let (low, high) = range.into_inner();
                let reason = format!("{value} is not within {low}..{high}{unit}; give a number such as {usual}");
                return Err(Error::Option { option, reason });
            }
        }
        Ok(())
    }
}

/// Aligns every frame of `bracket` to its reference.
///
/// # Errors
/// [`Error::Option`] if an option is out of range; [`Error::NoOverlap`] if the placed frames have no pixel in common;
/// [`Error::Scratch`] if a frame on disk cannot be read. A frame that cannot be aligned is not an error: it is
/// [rejected](Placement::Rejected) with a warning.
pub fn align(bracket: &Bracket, options: &AlignOptions) -> Result<(Alignment, Vec<Warning>)> {
    options.validate()?;
    let given = preset::given(bracket, &options.given)?;
    let search = |find| search(bracket, options, &given, find);
    let mut searched = match options.mode {
        AlignMode::None => None,
        AlignMode::Auto => Some(search(|s| s.auto())?),
        AlignMode::Mtb => Some(search(|s| s.by_bitmaps_alone())?),
        AlignMode::Sift | AlignMode::Surf => Some(search(|s| s.by_features_alone())?),
    };
    let to_follow = searched.as_mut().filter(|_| options.follows());
    let followed = to_follow.and_then(|searched| following::follow(bracket, searched));
    let (placements, features) =
        searched.map_or_else(|| unmoved_but(bracket, &given), |searched| (searched.placements, searched.features));
    let mut warnings = warnings::of_frames(bracket, &placements);
    let overlap = Rect { x0: 0, y0: 0, x1: bracket.width(), y1: bracket.height() };
    let alignment = Alignment { placements, features, overlap, followed };
    let motions: Vec<(usize, Motion)> = alignment.placed(bracket).map(|(i, _, motion)| (i, motion)).collect();
    let (overlap, small) = warnings::common_overlap(bracket, &motions)?;
    warnings.extend(small);
    Ok((Alignment { overlap, ..alignment }, warnings))
}

#[cfg(test)]
mod tests;
