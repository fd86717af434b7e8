//! Bends: motions that differ smoothly from a homography, because of the lens or the shutter.
//!
//! In: parameters. Out: the position in the frame of each pixel of the reference. Cost: for each pixel, 30 to 100
//! operations. Sources: the distortion of lenses by odd powers of the radius, from Brown, "Decentering Distortion of
//! Lenses", Photogrammetric Engineering 32 (1966); the rolling shutter, whose rows are read one after the other, from
//! Grundmann, Kwatra, Castro & Essa, "Calibration-Free Rolling Shutter Removal", ICCP 2012.

use crate::align::motion::Cause;
use crate::align::motion::coordinates::{Coordinates, by_homography};
use crate::align::transform::map;
use nalgebra::{Matrix3, SVector};

/// Number of cubic B-splines along the rows of a [`Shutter`]. A hand trembles about ten times per second, and a
/// picture is read in at most a tenth of a second.
pub(crate) const SPLINES: usize = 8;
/// Focal length of an expected camera, in units of half the long side of the picture: 36 mm for a picture of 36 mm. It
/// determines only by how much a turn displaces the border of the picture more than its centre.
const FOCAL_LENGTH: f64 = 2.0;
/// Number of entries of the table of distortions.
const ENTRIES: usize = 1024;
/// The table of distortions reaches this far from the centre, as a square of the radius. The corners of a square
/// picture are at 2.
const FARTHEST: f64 = 4.0;

/// Number of intervals, along each side of the picture, in which the positions of a bend are compared with those of a
/// homography.
const INTERVALS: usize = 32;
/// Between these positions, the distance may be larger by this factor, and by this many pixels. Bends are smooth.
const MARGIN: (f64, f64) = (1.05, 0.5);

/// The motion of a frame that a homography does not describe, although it is smooth.
#[derive(Debug, Clone, PartialEq)]
pub struct Bend {
    model: BendModel,
    /// The largest distance along an axis of a position from that of the homography, in pixels.
    farthest: f64,
}

/// The model of a bend: where the frame shows each pixel.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum BendModel {
    /// The lens distorts both pictures.
    Lens(Lens),
    /// The camera moved while the rows were read.
    Shutter(Box<Shutter>),
}

impl BendModel {
    #[inline(always)]
    fn position(&self, x: f64, y: f64) -> (f64, f64) {
        match self {
            BendModel::Lens(lens) => lens.position(x, y),
            BendModel::Shutter(shutter) => shutter.position(x, y),
        }
    }
}

impl Bend {
    /// The bend of a frame of `size` pixels whose motion is nearly that of `homography`, which maps pixels of the
    /// reference to the frame.
    pub(crate) fn new(model: BendModel, homography: &Matrix3<f64>, size: (usize, usize)) -> Self {
        let at = |i: usize, length: usize| i as f64 * (length.max(1) - 1) as f64 / INTERVALS as f64;
        let nodes = (0..=INTERVALS).flat_map(|j| (0..=INTERVALS).map(move |i| (at(i, size.0), at(j, size.1))));
        let distance = |(x, y): (f64, f64)| {
            let ((a, b), (u, v)) = (model.position(x, y), map(homography, x, y));
            (a - u).abs().max((b - v).abs())
        };
        let farthest = MARGIN.0 * nodes.map(distance).fold(0.0, f64::max) + MARGIN.1;
        Bend { model, farthest }
    }

    /// Why the motion is bent.
    pub(crate) fn cause(&self) -> Cause {
        match self.model {
            BendModel::Lens(_) => Cause::Lens,
            BendModel::Shutter(_) => Cause::Shutter,
        }
    }

    /// Position in the frame of the pixel (x, y) of the reference, in pixels.
    #[inline(always)]
    pub(crate) fn position(&self, x: f64, y: f64) -> (f64, f64) {
        self.model.position(x, y)
    }

    /// The largest distance along an axis of a position from that of the homography, in pixels.
    pub(crate) fn farthest(&self) -> f64 {
        self.farthest
    }
}

/// The radial distortion of a lens: of a picture, to the picture that a pinhole camera would take.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Radial {
    /// The coefficients of the third and the fifth power of the radius, in [`Coordinates`].
    pub(crate) powers: [f64; 2],
}

impl Radial {
    /// The factor on a radius whose square is `square`.
    #[inline(always)]
    fn factor(&self, square: f64) -> f64 {
        let [cubic, quintic] = self.powers;
        1.0 + square * (cubic + square * quintic)
    }

    /// The position in the pinhole camera's picture of the position (u, v).
    #[inline(always)]
    pub(crate) fn undistorted(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let factor = self.factor(u * u + v * v);
        [u * factor, v * factor]
    }

    /// The factor by which a radius in the pinhole camera's picture, whose square is `square`, is distorted: the
    /// inverse of [`factor`](Self::factor), by Newton's method.
    pub(crate) fn inverse_factor(&self, square: f64) -> f64 {
        // The unknown f: f factor(f^2 square) = 1.
        let [cubic, quintic] = self.powers.map(|p| p * square);
        let quintic = quintic * square;
        let mut f: f64 = 1.0;
        for _ in 0..5 {
            let s = f * f;
            let value = f * (1.0 + s * (cubic + s * quintic)) - 1.0;
            // Where a distortion this strong would fold the picture, the slope is limited.
            let slope = 1.0 + s * (3.0 * cubic + 5.0 * s * quintic);
            f -= value / slope.max(0.2);
        }
        f
    }
}

/// A homography between the pictures of two pinhole cameras whose lenses distort.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Lens {
    coordinates: Coordinates,
    reference: Radial,
    /// Maps undistorted positions of the reference to those of the frame, in [`Coordinates`].
    homography: Matrix3<f64>,
    /// The [inverse factors](Radial::inverse_factor) of the frame, for squares of the radius from 0 to [`FARTHEST`].
    factors: Vec<f64>,
}

impl Lens {
    /// The motion between pictures whose distortions are `reference` and `frame`. `homography` maps undistorted
    /// positions in `coordinates`.
    pub(crate) fn new(coordinates: Coordinates, [reference, frame]: [Radial; 2], homography: Matrix3<f64>) -> Self {
        let square = |i: usize| i as f64 * FARTHEST / ENTRIES as f64;
        let factors = (0..=ENTRIES).map(|i| frame.inverse_factor(square(i))).collect();
        Lens { coordinates, reference, homography, factors }
    }

    #[inline(always)]
    fn position(&self, x: f64, y: f64) -> (f64, f64) {
        let [u, v] = self.reference.undistorted(self.coordinates.of([x, y]));
        let (u, v) = map(&self.homography, u, v);
        let at = (u * u + v * v) * (ENTRIES as f64 / FARTHEST);
        let below = (at as usize).min(ENTRIES - 1);
        let (a, b) = (self.factors[below], self.factors[below + 1]);
        let factor = a + (at - below as f64).min(1.0) * (b - a);
        let [x, y] = self.coordinates.pixel([u * factor, v * factor]);
        (x, y)
    }
}

/// Number of parameters of a [`Shutter`]: a small homography, and for each spline two turns and a roll.
pub(crate) const SHUTTER_PARAMETERS: usize = 8 + 3 * SPLINES;

/// A homography, after displacements that change from row to row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Shutter {
    coordinates: Coordinates,
    /// Height of the picture, in units of the coordinates.
    height: f64,
    /// The parameters, in units of the coordinates; see [`by_shutter`].
    parameters: SVector<f64, SHUTTER_PARAMETERS>,
    /// Maps positions of the reference to the frame, in pixels.
    homography: Matrix3<f64>,
}

impl Shutter {
    /// The motion by `homography`, in pixels, of what is displaced by `parameters`, in units of the coordinates.
    pub(crate) fn new(
        coordinates: Coordinates,
        height: f64,
        parameters: SVector<f64, SHUTTER_PARAMETERS>,
        homography: Matrix3<f64>,
    ) -> Self {
        Shutter { coordinates, height, parameters, homography }
    }

    #[inline(always)]
    fn position(&self, x: f64, y: f64) -> (f64, f64) {
        let at = self.coordinates.of([x, y]);
        let [du, dv] = displacement(&self.parameters, at, self.height);
        let [x, y] = self.coordinates.pixel([at[0] + du, at[1] + dv]);
        map(&self.homography, x, y)
    }
}

/// The displacement of the position `at` by the `parameters` of a [`Shutter`] for a picture of this `height`, in units
/// of the coordinates.
#[inline(always)]
pub(crate) fn displacement(parameters: &SVector<f64, SHUTTER_PARAMETERS>, at: [f64; 2], height: f64) -> [f64; 2] {
    let (first, by_turns) = by_shutter(at, height);
    let by_homography = by_homography(at);
    std::array::from_fn(|axis| {
        let small: f64 = (0..8).map(|i| by_homography[axis][i] * parameters[i]).sum();
        let rows = by_turns.iter().zip(&parameters.as_slice()[8 + 3 * first..]);
        small + rows.map(|(by, parameter)| by[axis] * parameter).sum::<f64>()
    })
}

/// Derivatives of the displacement at (u, v) by the parameters of the four splines that are not zero in its row: the
/// number of the first, and for each spline the derivatives by a turn about the vertical axis, a turn about the
/// horizontal axis, and a roll: along x and along y.
#[inline(always)]
pub(crate) fn by_shutter([u, v]: [f64; 2], height: f64) -> (usize, [[f64; 2]; 12]) {
    let spans = (SPLINES - 3) as f64;
    let at = ((v / height + 0.5) * spans).clamp(0.0, spans);
    let first = (at as usize).min(SPLINES - 4);
    let t = at - first as f64;
    let (s, t2, t3) = (1.0 - t, t * t, t * t * t);
    let splines = [s * s * s, 3.0 * t3 - 6.0 * t2 + 4.0, -3.0 * t3 + 3.0 * t2 + 3.0 * t + 1.0, t3].map(|b| b / 6.0);
    let (p, q) = (u / FOCAL_LENGTH, v / FOCAL_LENGTH);
    let turns = [[1.0 + p * p, p * q], [p * q, 1.0 + q * q], [-v, u]];
    (first, std::array::from_fn(|i| turns[i % 3].map(|d| d * splines[i / 3])))
}
