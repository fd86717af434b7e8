//! PNG: the display picture, with 8 or 16 bits.
//!
//! In: display-encoded RGB by rows. Out: a PNG whose bands of 64 rows are compressed separately, in parallel: the same
//! bytes on any number of threads. Cost: 10 ns per pixel and core, 9 to 12 MB for 12 MP. Source: PNG (3rd ed., W3C
//! 2025), sections 5 (chunks), 9 (filtering), 11.3.2 (cICP, iCCP, sRGB), 11.3.4.6 (eXIf); RFC 1950 (zlib), RFC 1951
//! (deflate), section 2.3.
//!
//! Every row has the Paeth filter, except the first of a band, which has the Sub filter and does not need the row
//! above. Choosing a filter per row takes half as long again and makes files one percent smaller.

pub(crate) mod mask;
mod writer;

pub(crate) use writer::{Sample, Writer};
