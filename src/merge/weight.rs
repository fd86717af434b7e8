//! Weights: how far a code is trusted.
//!
//! In: a code. Out: its weight, from tables. Cost: none.
//! Source: the hat is Debevec & Malik 1997, equation 4; the Gaussian is Robertson, Borman & Stevenson 2003, section III, shifted and
//! scaled so that it is 0 at both ends; the plateau is Ward's, as hdrgen has it: 1 - (2 z / 255 - 1)^12.

use crate::response::{CODES, hat};

/// How far a code on the scale 0..=255 is trusted: 0 at both ends, where it may be clipped, but for [`Weight::Uniform`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Weight {
    /// Rises linearly from both ends to the middle.
    #[default]
    Hat,
    /// A bell about the middle, with a standard deviation of 45 codes. On truth brackets it ties with the hat in PU21-PSNR and has
    /// slightly smaller errors in stops.
    Gaussian,
    /// Nearly 1 but for the last tenth at either end.
    Plateau,
    /// 1 for all codes, clipped or not.
    Uniform,
}

impl Weight {
    /// The weight of a code on the scale 0..=255, in 0..=1.
    pub fn at(self, code: f64) -> f64 {
        let off = code / 127.5 - 1.0;
        match self {
            Weight::Hat => hat(code),
            Weight::Gaussian => {
                let bell = |off: f64| libm::exp(-4.0 * off * off);
                ((bell(off) - bell(1.0)) / (1.0 - bell(1.0))).max(0.0)
            }
            Weight::Plateau => (1.0 - libm::pow(off, 12.0)).max(0.0),
            Weight::Uniform => 1.0,
        }
    }

    /// The weights of codes 0..=255 of a channel that is black up to the code `black`: 0 up to there, the rest of the curve above.
    pub fn table(self, black: f64) -> [f32; CODES] {
        std::array::from_fn(|code| {
            let above = (code as f64 - black).max(0.0) * 255.0 / (255.0 - black);
            self.at(above) as f32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_nothing_at_the_ends_and_symmetric() {
        for weight in [Weight::Hat, Weight::Gaussian, Weight::Plateau] {
            assert_eq!((weight.at(0.0), weight.at(255.0)), (0.0, 0.0), "{weight:?}");
            assert_eq!(weight.at(127.5), 1.0);
            assert!((1..128).all(|z| (weight.at(z as f64) - weight.at(255.0 - z as f64)).abs() < 1e-12));
            assert!((1..128).all(|z| weight.at(z as f64) >= weight.at(z as f64 - 1.0)));
        }
        assert_eq!(Weight::Uniform.table(0.0), [1.0; CODES]);
        // By hand: the hat at a quarter of the range.
        assert_eq!(Weight::Hat.at(63.75), 0.5);
    }

    #[test]
    fn black_has_no_weight() {
        let table = Weight::Hat.table(15.0);
        assert_eq!((table[0], table[15], table[255]), (0.0, 0.0, 0.0));
        // By hand: 135 is the middle of 15..=255.
        assert!((table[135] - 1.0).abs() < 1e-6 && table[16] > 0.0);
    }
}
