//! Parses an EXIF block and moves each field to its standard directory.
//!
//! In: a TIFF block, and the index of the directory that describes the image. Out: the readable fields; those of the
//! image are in [`In::PRIMARY`]. Cost: kamadak-exif, twice for blocks that must be reordered. Source: EXIF 2.32,
//! section 4.6; TIFF/EP, which puts the exposure into the directory of the image instead of the EXIF directory.

use crate::bracket::metadata::carried::DESCRIPTIVE;
use exif::experimental::Writer;
use exif::{Context, Exif, Field, In, Tag};
use std::collections::BTreeMap;
use std::io::Cursor;
use std::panic::catch_unwind;

/// Parses the readable fields of the block `raw`, in which the directory with index `picture` describes the image.
/// `None` where `raw` is not a TIFF block.
pub(super) fn parsed(raw: Vec<u8>, picture: u16) -> Option<Exif> {
    let exif = read(raw)?;
    if picture == 0 && exif.fields().all(|field| placed(field.tag) == field.tag) {
        return Some(exif);
    }
    in_order(&exif, picture).and_then(read).or(Some(exif))
}

fn read(raw: Vec<u8>) -> Option<Exif> {
    // Files often contain a single bad entry; the other entries are still valid and are kept.
    let parsed = catch_unwind(|| {
        exif::Reader::new().continue_on_error(true).read_raw(raw).or_else(|e| e.distill_partial_result(|_| ()))
    });
    parsed.ok()?.ok()
}

/// Returns `tag` with the directory (context) in which EXIF defines it.
fn placed(tag: Tag) -> Tag {
    let of_exif = Tag(Context::Exif, tag.number());
    let is_displaced = tag.context() == Context::Tiff && tag.description().is_none() && of_exif.description().is_some();
    if is_displaced { of_exif } else { tag }
}

/// Writes a block with the fields of the directory `picture`. Fields that this directory lacks are taken from the first
/// directory. A field in its standard directory takes precedence over a displaced field with the same tag. Maker notes
/// are left out because their offsets become invalid.
fn in_order(exif: &Exif, picture: u16) -> Option<Vec<u8>> {
    let mut fields: BTreeMap<(u8, u16), Field> = BTreeMap::new();
    for (directory, displaced) in [(picture, false), (picture, true), (0, false), (0, true)] {
        let own = exif.fields().filter(|field| field.ifd_num == In(directory));
        for field in own.filter(|field| (placed(field.tag) != field.tag) == displaced) {
            let tag = placed(field.tag);
            let (place, is_kept) = match tag.context() {
                Context::Tiff if tag == Tag::Orientation => (0, directory == picture),
                Context::Tiff => (0, tag == Tag::Software || DESCRIPTIVE.contains(&tag)),
                Context::Exif => (1, tag != Tag::MakerNote),
                Context::Gps => (2, true),
                _ => (3, false),
            };
            if is_kept && !matches!(field.value, exif::Value::Unknown(..)) {
                let moved = || Field { tag, ifd_num: In::PRIMARY, value: field.value.clone() };
                fields.entry((place, tag.number())).or_insert_with(moved);
            }
        }
    }
    let mut writer = Writer::new();
    fields.values().for_each(|field| writer.push_field(field));
    let mut block = Cursor::new(Vec::new());
    writer.write(&mut block, exif.little_endian()).ok()?;
    Some(block.into_inner())
}

#[cfg(test)]
mod tests;
