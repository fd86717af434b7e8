//! Arguments on the picture that is written: bits.

use clap::{Args, ValueEnum};
use hdralign::tonemap::codes::Depth;
use hdralign::write::picture;

/// How the picture is written.
#[derive(Debug, Args)]
pub struct Picture {
    /// Bits of a code of the picture: 16 for who edits it further. JPEG holds 8
    #[arg(long, value_enum, default_value_t, value_name = "BITS")]
    bit_depth: DepthArg,
}

/// See [`Depth`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum DepthArg {
    /// Codes 0 to 255
    #[default]
    #[value(name = "8")]
    Eight,
    /// Codes 0 to 65535, of the floats that the tone mapping gives
    #[value(name = "16")]
    Sixteen,
}

impl Picture {
    /// How pictures are made.
    pub fn options(&self) -> picture::Options {
        picture::Options {
            depth: match self.bit_depth {
                DepthArg::Eight => Depth::Eight,
                DepthArg::Sixteen => Depth::Sixteen,
            },
        }
    }
}
