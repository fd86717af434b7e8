//! The distortion of the lens, and the homography of each frame, from the displacements of the patches.
//!
//! In: the [`Observed`] frames. Out: [`Bends`]. Cost: some hundred multiply-adds for each observation and round.
//! Source: robust Gauss-Newton; the parameters of each frame are eliminated, so that two remain (the Schur complement,
//! as in bundle adjustment: Triggs et al. 2000, section 6.1).
//!
//! All frames are taken by the same lens, but the lens is refocused: the third power of the radius has its own
//! coefficient in each frame. From one frame alone, the distortion is known only if the camera turned.

use crate::align::following::bend::Bends;
use crate::align::following::explained::{Explained, ROUNDS, weight};
use crate::align::following::observations::Observation;
use crate::align::following::{Observed, Picture, some};
use crate::align::motion::bend::{BendModel, Lens, Radial};
use crate::align::motion::coordinates::{Coordinates, by_homography};
use crate::align::transform::map;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2};

/// Parameters of a frame: a small homography in pixels of the level, and how much its cubic coefficient differs from
/// that of the reference.
const OWN: usize = 9;
/// Expected size of the parameters: of those of the homography in pixels, of the coefficients of the reference, and of
/// the difference between frames. Beyond these sizes, a lens would not be sold, or not be used for pictures.
const EXPECTED: (f64, [f64; 2], f64) = (5.0, [0.1, 0.05], 0.01);
/// Step of the numerical derivatives by the coefficients.
const STEP: f64 = 1e-4;

type Parameters = SVector<f64, OWN>;

/// A frame, and the homography between the coordinates of reference and frame, with its inverse.
struct Frame<'a> {
    observed: &'a Observed,
    homography: Matrix3<f64>,
    inverse: Matrix3<f64>,
    unit: f64,
}

impl<'a> Frame<'a> {
    fn new(observed: &'a Observed, coordinates: &Coordinates) -> Option<Self> {
        let homography = coordinates.homography(&observed.homography);
        Some(Frame { observed, homography, inverse: homography.try_inverse()?, unit: coordinates.unit })
    }

    /// The homography between undistorted positions.
    fn undistorted(&self, own: &Parameters) -> Matrix3<f64> {
        let p = own / self.unit;
        self.homography * Matrix3::new(1.0 + p[0], p[1], p[2], p[3], 1.0 + p[4], p[5], -p[6], -p[7], 1.0)
    }

    /// The parameters without distortion.
    fn plain(&self) -> Parameters {
        SVector::from_fn(|i, _| self.observed.plain.get(i).copied().unwrap_or(0.0))
    }

    fn radials(&self, shared: Vector2<f64>, own: &Parameters) -> [Radial; 2] {
        [[shared.x, shared.y], [shared.x + own[8], shared.y]].map(|powers| Radial { powers })
    }

    /// Displacement of the position `at`, in pixels of the level.
    fn displacement(&self, at: [f64; 2], shared: Vector2<f64>, own: &Parameters) -> Vector2<f64> {
        let [reference, frame] = self.radials(shared, own);
        let [u, v] = reference.undistorted(at);
        let (u, v) = map(&self.undistorted(own), u, v);
        let factor = frame.inverse_factor(u * u + v * v);
        let (u, v) = map(&self.inverse, u * factor, v * factor);
        Vector2::new(u - at[0], v - at[1]) * self.unit
    }
}

/// The normal equations of a frame: of its own parameters, of the shared ones, and between them.
struct Normal {
    own: SMatrix<f64, OWN, OWN>,
    between: SMatrix<f64, OWN, 2>,
    shared: Matrix2<f64>,
    own_right: Parameters,
    shared_right: Vector2<f64>,
}

impl Normal {
    fn of(frame: &Frame, shared: Vector2<f64>, own: &Parameters, weight: &impl Fn(f64) -> f64) -> Self {
        let mut normal = Normal {
            own: SMatrix::zeros(),
            between: SMatrix::zeros(),
            shared: Matrix2::zeros(),
            own_right: SVector::zeros(),
            shared_right: Vector2::zeros(),
        };
        for observation in some(&frame.observed.observations) {
            let d = frame.displacement(observation.at, shared, own);
            let changed = |shared, own: &Parameters| (frame.displacement(observation.at, shared, own) - d) / STEP;
            let by_shared = SMatrix::<f64, 2, 2>::from_columns(&[
                changed(shared + Vector2::new(STEP, 0.0), own),
                changed(shared + Vector2::new(0.0, STEP), own),
            ]);
            let mut refocused = *own;
            refocused[8] += STEP;
            let by_focus = changed(shared, &refocused);
            let by_homography = by_homography(observation.at);
            let by_own = SMatrix::<f64, 2, OWN>::from_fn(|axis, i| {
                by_homography[axis].get(i).copied().unwrap_or(by_focus[axis])
            });
            let pull: Matrix2<f64> = observation.precision * weight(observation.misfit([d.x, d.y]));
            let pulled: Vector2<f64> = pull * (observation.displacement - d);
            normal.own += by_own.transpose() * pull * by_own;
            normal.between += by_own.transpose() * pull * by_shared;
            normal.shared += by_shared.transpose() * pull * by_shared;
            normal.own_right += by_own.transpose() * pulled;
            normal.shared_right += by_shared.transpose() * pulled;
        }
        for i in 0..OWN {
            let expected = if i < 8 { EXPECTED.0 } else { EXPECTED.2 };
            normal.own[(i, i)] += 1.0 / (expected * expected);
            normal.own_right[i] -= own[i] / (expected * expected);
        }
        normal
    }
}

/// The coefficients of the reference, and the parameters of each frame that is observed.
struct Fit {
    shared: Vector2<f64>,
    own: Vec<Option<Parameters>>,
}

impl Fit {
    /// One Gauss-Newton step; none if the observations do not determine it.
    fn step(&mut self, frames: &[Option<Frame>], weight: &impl Fn(f64) -> f64) -> Option<()> {
        let held = Vector2::from(EXPECTED.1.map(|e| 1.0 / (e * e)));
        let (mut normal, mut right) = (Matrix2::from_diagonal(&held), -held.component_mul(&self.shared));
        // For each frame, its own step is `by_right - by_shared * step`, with the shared step.
        let mut eliminated = Vec::with_capacity(frames.len());
        for (frame, own) in frames.iter().zip(&self.own) {
            let (Some(frame), Some(own)) = (frame, own) else {
                eliminated.push(None);
                continue;
            };
            let of = Normal::of(frame, self.shared, own, weight);
            let inverse = of.own.try_inverse()?;
            let (by_right, by_shared) = (inverse * of.own_right, inverse * of.between);
            normal += of.shared - of.between.transpose() * by_shared;
            right += of.shared_right - of.between.transpose() * by_right;
            eliminated.push(Some((by_right, by_shared)));
        }
        let step = normal.try_inverse()? * right;
        self.shared += step;
        for (own, eliminated) in self.own.iter_mut().zip(eliminated) {
            if let (Some(own), Some((by_right, by_shared))) = (own, eliminated) {
                *own += by_right - by_shared * step;
            }
        }
        Some(())
    }
}

/// Fits the distortion of the lens; no frame has a bend if the observations do not determine it.
pub(in crate::align::following) fn fit(frames: &[Option<Observed>], picture: &Picture) -> Bends {
    let coordinates = &picture.coordinates;
    let usable = frames.iter().map(|observed| observed.as_ref().filter(|observed| observed.is_usable()));
    let frames: Vec<Option<Frame>> = usable.map(|observed| Frame::new(observed?, coordinates)).collect();
    let plain = frames.iter().map(|frame| Some(frame.as_ref()?.plain())).collect();
    let mut fit = Fit { shared: Vector2::zeros(), own: plain };
    for round in (0..ROUNDS).step_by(2) {
        if fit.step(&frames, &weight(round)).is_none() {
            return vec![None; frames.len()];
        }
    }
    let bend = |(frame, own): (&Option<Frame>, &Option<Parameters>)| {
        let (frame, own) = (frame.as_ref()?, own.as_ref()?);
        let radials = frame.radials(fit.shared, own);
        let lens = Lens::new(coordinates.off_level(picture.level), radials, frame.undistorted(own));
        let plain = |o: &Observation| frame.displacement(o.at, Vector2::zeros(), &frame.plain()).into();
        let predicted = |o: &Observation| Some(frame.displacement(o.at, fit.shared, own).into());
        let explained = Explained::new(&frame.observed.observations, plain, predicted);
        Some((picture.bend(BendModel::Lens(lens), &frame.observed.homography), explained))
    };
    frames.iter().zip(&fit.own).map(bend).collect()
}
