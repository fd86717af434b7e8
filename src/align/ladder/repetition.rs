//! Scenes that repeat: if a transform is shifted by a period of the scene, the result matches as well, or nearly.
//!
//! In: the grey pyramids of a bracket. Out: the periods of the scene, and for a transform the shifted ones, from which
//! further candidates are refined. Cost: that of [`periods`] for the reference; if the reference is dark or has little
//! detail, also for each frame with more exposure, or for all frames, whose placement is not preset.

use crate::align::agreement::periods;
use crate::align::grey::GreyPyramid;
use crate::align::ladder::Search;
use crate::align::transform::Transform;
use nalgebra::Matrix3;

/// The periods of the scene of a bracket.
pub(super) struct Repetition {
    reference: usize,
    /// For each frame, the shifts under which it matches itself, in its own pixels. Not every frame is examined; for
    /// the others, the list is empty.
    periods: Vec<Vec<(f64, f64)>>,
}

impl Repetition {
    /// Finds the periods of the reference. In a dark reference, noise and rounding may hide them, so the brighter
    /// frames are examined too; if the reference has too little detail, for example because it is clipped, all frames.
    pub(super) fn find(search: &Search) -> Self {
        let reference = search.reference;
        let of = |pyramid: &GreyPyramid| periods(pyramid, search.options.mtb.max_shift);
        let of_reference = of(search.reference_pyramid());
        let is_dark = search.contents[reference].brightening_stops.is_some();
        let is_examined = |i: usize| {
            i != reference && search.given[i].is_none() && (of_reference.is_none() || (is_dark && i > reference))
        };
        let find = |(i, pyramid): (usize, &GreyPyramid)| if is_examined(i) { of(pyramid) } else { None };
        let mut all: Vec<_> = search.pyramids.iter().enumerate().map(find).map(Option::unwrap_or_default).collect();
        all[reference] = of_reference.unwrap_or_default();
        Repetition { reference, periods: all }
    }

    /// Whether frame `i` or the reference matches itself under a shift.
    pub(super) fn concerns(&self, i: usize) -> bool {
        !self.periods[self.reference].is_empty() || !self.periods[i].is_empty()
    }

    /// Returns the transforms that are shifted by one period of frame `i` or of the reference from `h`, which maps the
    /// reference to frame `i`.
    pub(super) fn shifted(&self, i: usize, h: &Matrix3<f64>) -> Vec<Transform> {
        let shifts = |frame: usize| {
            let both = self.periods[frame].iter().flat_map(|&(dx, dy)| [(dx, dy), (-dx, -dy)]);
            both.map(|(dx, dy)| Matrix3::new(1.0, 0.0, dx, 0.0, 1.0, dy, 0.0, 0.0, 1.0))
        };
        let of_reference = shifts(self.reference).map(|shift| h * shift);
        of_reference.chain(shifts(i).map(|shift| shift * h)).map(Transform::Homography).collect()
    }
}
