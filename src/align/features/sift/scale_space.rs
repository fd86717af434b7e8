//! The scale space: octaves of increasingly smooth images, and the differences of successive images (Lowe 2004, section
//! 3).

use super::SiftOptions;
use crate::plane::Plane;
use crate::pyramid::{double, every_second, gaussian};

/// Assumed blur of the input image: standard deviation in pixels of this image (section 3.3).
const CAMERA_SIGMA: f64 = 0.5;
/// Least short side of an octave, in pixels. Smaller octaves have no useful extrema.
const LEAST_SIDE: usize = 16;

/// One octave. With s intervals it has s + 3 Gaussian images L, each smoother than the one before it.
///
/// The s + 2 differences D of successive images are computed on access. To store them would double the memory and take
/// more time than the subtractions.
pub(super) struct Octave {
    pub(super) gaussians: Vec<Plane<f32>>,
}

impl Octave {
    /// Returns D at column `x` of row `y`: L at `interval + 1` minus L at `interval`.
    #[inline]
    pub(super) fn difference(&self, interval: usize, x: usize, y: usize) -> f32 {
        self.gaussians[interval + 1].at(x, y) - self.gaussians[interval].at(x, y)
    }

    /// Computes row `y` of the difference D at `interval`.
    pub(super) fn difference_row(&self, interval: usize, y: usize, out: &mut [f32]) {
        let (smoother, sharper) = (self.gaussians[interval + 1].row(y), self.gaussians[interval].row(y));
        for (d, (p, q)) in out.iter_mut().zip(smoother.iter().zip(sharper)) {
            *d = p - q;
        }
    }
}

/// All octaves of an image.
pub(super) struct ScaleSpace {
    pub(super) octaves: Vec<Octave>,
    intervals: usize,
    sigma: f64,
    /// Size of a pixel of the first octave in pixels of the image: 1/2 if the image was doubled, otherwise 1.
    first_step: f64,
}

impl ScaleSpace {
    /// Builds the scale space of `image`, whose grey values are 0..=1.
    pub(super) fn new(image: Plane<f32>, options: &SiftOptions) -> Self {
        let (s, sigma) = (options.intervals, options.sigma);
        let (mut base, blur) =
            if options.double { (double(&image), 2.0 * CAMERA_SIGMA) } else { (image, CAMERA_SIGMA) };
        base = gaussian(&base, (sigma * sigma - blur * blur).max(0.01).sqrt());
        let k = libm::exp2(1.0 / s as f64);
        let mut octaves = Vec::new();
        while base.width().min(base.height()) >= LEAST_SIDE {
            let mut gaussians = vec![base];
            let mut reached = sigma;
            for _ in 1..s + 3 {
                let next = reached * k;
                let step = (next * next - reached * reached).sqrt();
                gaussians.push(gaussian(&gaussians[gaussians.len() - 1], step));
                reached = next;
            }
            base = every_second(&gaussians[s]);
            octaves.push(Octave { gaussians });
        }
        ScaleSpace { octaves, intervals: s, sigma, first_step: if options.double { 0.5 } else { 1.0 } }
    }

    /// Returns the size of a pixel of octave `octave`, in pixels of the image.
    pub(super) fn step(&self, octave: usize) -> f64 {
        self.first_step * (1u64 << octave) as f64
    }

    /// Returns the standard deviation of the Gaussian at a fractional interval of an octave, in pixels of this octave.
    pub(super) fn sigma_at(&self, interval: f64) -> f64 {
        self.sigma * libm::exp2(interval / self.intervals as f64)
    }
}
