//! OpenEXR: half or float RGB, scan lines, lossless.
//!
//! In: linear RGB by rows. Out: a file whose blocks lie in increasing order, so the bytes are the same on any number of threads.
//! [`read`](crate::read) is the way back. Cost: PIZ 30 ns a pixel and core for halves, 55 for floats. On six radiance maps it is the smallest
//! of all that lose nothing, 35 to 60 % of the halves as they are (ZIP 36 to 65, ZIPS 40 to 71, RLE 72 to 95), which is why it is the default. Source: "OpenEXR File
//! Layout" and "Standard Attributes" (openexr.com); colour interop ids: ASWF Color Interop Forum, "Color Space Encodings" (2024).
//!
//! The `exr` crate's own block writer wants all blocks from inside one closure, which a writer fed from outside cannot give; so the
//! file's frame (magic, header, offset table) is put together here out of the crate's parts, and the crate encodes the header, and blocks that are not PIZ.

mod piz;
mod sample;
mod writer;

#[doc(hidden)]
pub use sample::Fit;
pub use sample::Sample;
#[doc(hidden)]
pub use writer::Writer;

/// Compression of an OpenEXR file, always lossless.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[derive(strum::Display, strum::EnumIter, strum::EnumMessage, strum::EnumString, strum::IntoStaticStr)]
#[strum(serialize_all = "kebab-case")]
pub enum Compression {
    /// Wavelet and Huffman coding of 32 rows: the smallest for photographs.
    #[default]
    Piz,
    /// Deflate of 16 rows.
    #[strum(serialize = "zip")]
    Zip16,
    /// Deflate of single rows.
    #[strum(serialize = "zips")]
    Zip1,
    /// No compression: twice the size.
    None,
}

/// How OpenEXR is encoded.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    /// Halves where they do by default.
    pub sample: Sample,
    /// PIZ by default.
    pub compression: Compression,
}
