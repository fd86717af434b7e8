//! Arguments on the radiance that is written: colour space and encodings.

use crate::cli::arguments::choice::{Choice, choice, named};
use crate::cli::heading::OUTPUT;
use clap::Args;
use hdralign::bracket::colour::Space;
use hdralign::write::jpeg::{self, Resolution};
use hdralign::write::{self, dng, exr, hdr, tiff};
use strum::IntoEnumIterator;

/// How radiance is written.
#[derive(Debug, Args)]
#[command(next_help_heading = OUTPUT)]
pub struct Radiance {
    /// Convert the radiance to a linear colour space
    ///
    /// White stays white; colours outside the space are desaturated. For the picture see --picture-colour
    #[arg(long, hide_short_help = true, visible_alias = "color", value_parser = spaces(), default_value = KEEP, value_name = "SPACE")]
    colour: Target,

    /// Set the sample type of .exr
    #[arg(long, hide_short_help = true, value_parser = choice::<exr::Sample>(), default_value_t, value_name = "TYPE")]
    exr_type: exr::Sample,

    /// Set the compression of .exr (always lossless)
    #[arg(long, hide_short_help = true, value_parser = choice::<exr::Compression>(), default_value_t, value_name = "NAME")]
    exr_compression: exr::Compression,

    /// Set the pixel encoding of .hdr
    #[arg(long, hide_short_help = true, value_parser = choice::<hdr::Encoding>(), default_value_t, value_name = "NAME")]
    hdr_encoding: hdr::Encoding,

    /// Set the pixel encoding of radiance in .tif
    #[arg(long, hide_short_help = true, value_parser = choice::<tiff::Encoding>(), default_value_t, value_name = "NAME")]
    tiff_encoding: tiff::Encoding,

    /// Set the pixel encoding of .dng
    #[arg(long, hide_short_help = true, value_parser = choice::<dng::Encoding>(), default_value_t, value_name = "NAME")]
    dng_encoding: dng::Encoding,

    /// Set the quality of .jpg
    #[arg(long, hide_short_help = true, value_name = "1..100", default_value_t = jpeg::Options::default().quality)]
    jpeg_quality: u8,

    /// Set the size of the gain map in a .jpg: extra data from which HDR displays restore the radiance
    #[arg(long, hide_short_help = true, value_parser = choice::<Resolution>(), default_value_t, value_name = "SIZE")]
    gain_map: Resolution,
}

/// The colour space that radiance is converted to; `None` for no conversion. It is a separate type, because clap treats
/// an `Option` as an optional argument.
#[derive(Debug, Clone)]
struct Target(Option<Space>);

/// The value of `--colour` that means no conversion.
const KEEP: &str = "keep";

fn spaces() -> Choice<Target> {
    let keep = (Target(None), KEEP, "No conversion: the colour space of the input");
    let spaces = Space::iter().map(named).map(|(space, name, about)| (Target(Some(space)), name, about));
    [keep].into_iter().chain(spaces).collect()
}

impl Radiance {
    /// Returns the colour space that radiance is converted to; `None` for no conversion.
    pub fn colour(&self) -> Option<Space> {
        self.colour.0
    }

    /// Returns the options for writing files. With `overwrite`, existing files are replaced.
    pub fn write(&self, overwrite: bool) -> write::Options {
        write::Options {
            overwrite,
            exr: exr::Options { sample: self.exr_type, compression: self.exr_compression },
            hdr: self.hdr_encoding,
            tiff: self.tiff_encoding,
            dng: self.dng_encoding,
            jpeg: jpeg::Options { quality: self.jpeg_quality, gain_map: self.gain_map },
            picture: write::picture::Options::default(),
        }
    }
}
