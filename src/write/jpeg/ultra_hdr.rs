//! Ultra HDR metadata: the blocks of a JPEG that announce the gain map and describe how to apply it.
//!
//! In: the [`Rendition`] and the sizes of both images. Out: XMP packets, the ISO 21496-1 block and the multi-picture
//! index. Cost: negligible. Source: Google, "Ultra HDR Image Format v1.1"; ISO 21496-1:2025, annex C; CIPA DC-007
//! (MPF), sections 5.2 and A.2.

use super::gain_map::{OFFSET, Rendition};
use super::strips::{APP1, put_segment};
use std::io;

pub(super) const ISO: &[u8] = b"urn:iso:std:iso:ts:21496:-1\0";
/// The minimum version for a reader, and the version of the writer.
pub(super) const VERSION: [u8; 4] = [0; 4];
pub(super) const MPF: &[u8] = b"MPF\0";
/// Number of bytes of the multi-picture index from its header on: header, three tags, two entries.
pub(super) const MPF_BYTES: usize = 8 + 2 + 3 * 12 + 4 + 2 * 16;
/// Number of bytes from the start of the segment of the multi-picture index to the header of the index.
pub(super) const MPF_HEADER: usize = 4 + MPF.len();

/// Returns the multi-picture index (DC-007, 5.2): sizes of both images, and the offset of the second from the header
/// of the index.
pub(super) fn index(first: usize, second: usize, offset: usize) -> io::Result<Vec<u8>> {
    let four = |n: usize| {
        let number = u32::try_from(n)
            .map_err(|_| io::Error::other("a JPEG with a gain map must be smaller than 4 GB; write a .png instead"));
        number.map(u32::to_be_bytes)
    };
    four(first.saturating_add(second))?;
    let mut out = b"MM\0*\0\0\0\x08\0\x03".to_vec();
    // Version 0100; two images; their entries.
    out.extend_from_slice(b"\xB0\0\0\x07\0\0\0\x040100");
    out.extend_from_slice(b"\xB0\x01\0\x04\0\0\0\x01\0\0\0\x02");
    out.extend_from_slice(b"\xB0\x02\0\x07\0\0\0\x20\0\0\0\x32");
    out.extend_from_slice(&[0; 4]);
    // The first image has the type "baseline primary image". The MPF standard has no
    // type for the second image, the gain map.
    for (kind, size, offset) in [([0, 3, 0, 0], first, 0), ([0; 4], second, offset)] {
        out.extend_from_slice(&kind);
        out.extend_from_slice(&four(size)?);
        out.extend_from_slice(&four(offset)?);
        out.extend_from_slice(&[0; 4]);
    }
    Ok(out)
}

/// Returns the bytes that follow the version field in the metadata of ISO 21496-1: the parameters of `rendition`. All
/// channels share them, and the gain map applies in the picture's primaries.
pub(super) fn iso_numbers(rendition: &Rendition) -> Vec<u8> {
    const IN_BASE_SPACE: u8 = 0x40;
    // The numbers are multiples of 1/1024 within +-16: the cast is exact.
    let fraction = |value: f64| [((value * 1024.0).round() as i32).to_be_bytes(), 1024i32.to_be_bytes()];
    let Rendition { least_stops, most_stops, headroom_stops, .. } = *rendition;
    let mut out = vec![IN_BASE_SPACE];
    for value in [0.0, headroom_stops, least_stops, most_stops, 1.0, OFFSET, OFFSET] {
        out.extend_from_slice(fraction(value).as_flattened());
    }
    out
}

pub(super) fn put_xmp(packet: &str, out: &mut Vec<u8>) -> io::Result<()> {
    put_segment(APP1, &[b"http://ns.adobe.com/xap/1.0/\0", packet.as_bytes()], out)
}

/// Returns an XMP packet with the attributes and content `description`. It ends with a line feed: ImageMagick
/// overwrites the last byte of a packet before it reads the packet.
fn packet(software: &str, description: &str) -> String {
    let software: String = software.chars().filter(|c| !matches!(c, '<' | '>' | '&' | '"')).collect();
    format!(
        r#"<x:xmpmeta xmlns:x="adobe:ns:meta/" x:xmptk="{software}"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" {description}</rdf:RDF></x:xmpmeta>
"#
    )
}

/// Returns the XMP of the picture, which states that a gain map of `map_size` bytes follows.
pub(super) fn primary_xmp(map_size: usize, software: &str) -> String {
    let item = |semantic: &str, length: String| {
        format!(
            r#"<rdf:li rdf:parseType="Resource"><Container:Item Item:Semantic="{semantic}" Item:Mime="image/jpeg"{length}/></rdf:li>"#
        )
    };
    let items = item("Primary", String::new()) + &item("GainMap", format!(r#" Item:Length="{map_size}""#));
    let namespaces = r#"xmlns:Container="http://ns.google.com/photos/1.0/container/" xmlns:Item="http://ns.google.com/photos/1.0/container/item/" xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/""#;
    packet(
        software,
        &format!(
            r#"{namespaces} hdrgm:Version="1.0"><Container:Directory><rdf:Seq>{items}</rdf:Seq></Container:Directory></rdf:Description>"#
        ),
    )
}

/// Returns the XMP of the map: its parameters, in stops.
pub(super) fn map_xmp(rendition: &Rendition, software: &str) -> String {
    let Rendition { least_stops, most_stops, headroom_stops, .. } = rendition;
    packet(
        software,
        &format!(
            r#"xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/" hdrgm:Version="1.0" hdrgm:GainMapMin="{least_stops}" hdrgm:GainMapMax="{most_stops}" hdrgm:Gamma="1" hdrgm:OffsetSDR="{OFFSET}" hdrgm:OffsetHDR="{OFFSET}" hdrgm:HDRCapacityMin="0" hdrgm:HDRCapacityMax="{headroom_stops}" hdrgm:BaseRenditionIsHDR="False"/>"#
        ),
    )
}
