//! Tone mapping: from radiance to a picture.
//!
//! In: a [`RadianceMap`], in any unit and primaries. Out: a [`DisplayImage`], 8-bit sRGB. Each [`Operator`] is one paper in one file
//! and decides luminance; colour, gamut and encoding are the same for all and in [`display`]. Cost: see each operator.

pub mod display;
pub mod global;

use crate::merge::RadianceMap;
use crate::plane::Plane;
use global::{Curve, Scene};

/// A display-encoded picture: 8-bit, sRGB transfer and primaries.
#[derive(Debug, Clone, PartialEq)]
pub struct DisplayImage {
    /// RGB by rows.
    pub pixels: Plane<[u8; 3]>,
}

/// How luminance is brought into the range of a display.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[serde(tag = "name", rename_all = "kebab-case")]
pub enum Operator {
    /// Reinhard et al. 2002, the global curve.
    Reinhard02(global::Options),
}

impl Default for Operator {
    fn default() -> Self {
        Operator::Reinhard02(global::Options::default())
    }
}

impl Operator {
    /// What maps rows of `scene`, all of which was seen.
    pub fn settled(&self, scene: Scene) -> Curve {
        match self {
            Operator::Reinhard02(options) => Curve::settled(scene, options),
        }
    }
}

/// The picture of `radiance` by `operator`. Same radiance but for a factor, same picture, unless options fix the scale.
pub fn tonemap(radiance: &RadianceMap, operator: &Operator) -> DisplayImage {
    match operator {
        Operator::Reinhard02(options) => global::reinhard(radiance, options),
    }
}
