//! Arguments on the radiance that is written: colour space and encodings.

use clap::{Args, ValueEnum};
use hdralign::bracket::colour::Space;
use hdralign::write::{self, exr, gain_map::Resolution, hdr, tiff, ultra_hdr};

/// How radiance is written.
#[derive(Debug, Args)]
pub struct Radiance {
    /// The linear colour space of the radiance: white is taken to white; colours outside are drawn to grey until inside.
    /// `keep` is that of the photographs' profile, or of the radiance map. The picture has --picture-colour
    #[arg(long, visible_alias = "color", value_enum, default_value_t, value_name = "SPACE", verbatim_doc_comment)]
    colour: ColourArg,

    /// What .exr keeps a number in; auto: half, or float where halves are too small or too coarse
    #[arg(long, value_enum, default_value_t, value_name = "TYPE")]
    exr_type: ExrTypeArg,

    /// How .exr is packed, all without loss
    #[arg(long, value_enum, default_value_t, value_name = "NAME")]
    exr_compression: ExrCompressionArg,

    /// What a pixel of .hdr is
    #[arg(long, value_enum, default_value_t, value_name = "NAME")]
    hdr_encoding: HdrArg,

    /// What a pixel of .tif is
    #[arg(long, value_enum, default_value_t, value_name = "NAME")]
    tiff_encoding: TiffArg,

    /// The quality of the picture in .jpg
    #[arg(long, value_name = "1..100", default_value_t = ultra_hdr::Options::default().quality)]
    jpeg_quality: u8,

    /// The gain map in .jpg, by which HDR displays show the radiance
    #[arg(long, value_enum, default_value_t, value_name = "SIZE")]
    gain_map: GainMapArg,
}

/// See [`Resolution`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum GainMapArg {
    /// As large as the picture
    #[default]
    Full,
    /// Half as wide and high: a smaller file
    Half,
    /// None: a JPEG like any other
    None,
}

/// See [`Space`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum ColourArg {
    /// As the photographs or the radiance map are
    #[default]
    Keep,
    /// BT.709's primaries, D65
    Srgb,
    /// Display P3, D65
    DisplayP3,
    /// Adobe RGB (1998), D65
    AdobeRgb,
    /// BT.2020, D65
    Rec2020,
    /// ProPhoto RGB, D50
    Prophoto,
    /// ACEScg (AP1), the ACES white
    Acescg,
}

/// See [`exr::Sample`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum ExrTypeArg {
    /// Half where it holds the picture
    #[default]
    Auto,
    /// 16 bits, up to 65504
    Half,
    /// 32 bits, as merged
    Float,
}

/// See [`exr::Compression`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum ExrCompressionArg {
    /// Wavelet: the smallest for photographs
    #[default]
    Piz,
    /// Deflate, 16 rows at a time
    Zip,
    /// Deflate, row by row
    Zips,
    /// Not at all: twice the size
    None,
}

/// See [`hdr::Encoding`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum HdrArg {
    /// Red, green, blue
    #[default]
    Rgbe,
    /// CIE XYZ, for every colour there is
    Xyze,
}

/// See [`tiff::Encoding`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum TiffArg {
    /// 32-bit floats
    #[default]
    Float,
    /// 24 bits: 16 stops in steps of 1.1 %
    Logluv24,
    /// 32 bits: 126 stops in steps of 0.27 %
    Logluv32,
}

impl Radiance {
    /// The space that radiance is converted to, if any.
    pub fn colour(&self) -> Option<Space> {
        match self.colour {
            ColourArg::Keep => None,
            ColourArg::Srgb => Some(Space::Srgb),
            ColourArg::DisplayP3 => Some(Space::DisplayP3),
            ColourArg::AdobeRgb => Some(Space::AdobeRgb),
            ColourArg::Rec2020 => Some(Space::Rec2020),
            ColourArg::Prophoto => Some(Space::Prophoto),
            ColourArg::Acescg => Some(Space::Acescg),
        }
    }

    /// How files are encoded; those that exist are replaced where `overwrite`.
    pub fn write(&self, overwrite: bool) -> write::Options {
        write::Options {
            overwrite,
            exr: exr::Options {
                sample: match self.exr_type {
                    ExrTypeArg::Auto => exr::Sample::Auto,
                    ExrTypeArg::Half => exr::Sample::Half,
                    ExrTypeArg::Float => exr::Sample::Float,
                },
                compression: match self.exr_compression {
                    ExrCompressionArg::Piz => exr::Compression::Piz,
                    ExrCompressionArg::Zip => exr::Compression::Zip16,
                    ExrCompressionArg::Zips => exr::Compression::Zip1,
                    ExrCompressionArg::None => exr::Compression::None,
                },
            },
            hdr: match self.hdr_encoding {
                HdrArg::Rgbe => hdr::Encoding::Rgbe,
                HdrArg::Xyze => hdr::Encoding::Xyze,
            },
            tiff: match self.tiff_encoding {
                TiffArg::Float => tiff::Encoding::Float,
                TiffArg::Logluv24 => tiff::Encoding::LogLuv24,
                TiffArg::Logluv32 => tiff::Encoding::LogLuv32,
            },
            jpeg: ultra_hdr::Options {
                quality: self.jpeg_quality,
                gain_map: match self.gain_map {
                    GainMapArg::Full => Resolution::Full,
                    GainMapArg::Half => Resolution::Half,
                    GainMapArg::None => Resolution::None,
                },
            },
            picture: write::picture::Options::default(),
        }
    }
}
