//! OpenEXR files of any writer.
//!
//! In: a file. Out: the radiance of the first part that has R, G and B or, if there is none, of the first part that has
//! Y; and the metadata of this part. Supported: half, float and integer samples; scan lines and tiles (the finest
//! level); every compression of the `exr` crate (all except HTJ2K); one or several parts. If the data window is not the
//! display window, the pixels of the data window are used. Alpha is dropped: colours are premultiplied, so the picture
//! is shown over black. Other channels and parts are [listed](Contents::unread). Deep data and the subsampled chroma of
//! luminance-chroma files are rejected. Cost: the crate's codecs; blocks are decompressed in parallel. Source: see
//! [`crate::write::exr`].

use super::Contents;
use crate::bracket::colour::Primaries;
use crate::limits::{self, DEFLATE, Limits};
use crate::plane::Plane;
use crate::write::Metadata;
use ::exr::block::UncompressedBlock;
use ::exr::block::chunk::Chunk;
use ::exr::block::reader::ChunksReader;
use ::exr::compression::Compression;
use ::exr::image::read::image::LayersReader;
use ::exr::image::{AnyChannel, AnyChannels, FlatSamples, Layers};
use ::exr::math::Vec2;
use ::exr::meta::MetaData;
use ::exr::meta::attribute::{AttributeValue, Text};
use ::exr::prelude::{ReadChannels, ReadLayers, read as reader};
use rayon::prelude::*;
use std::collections::HashSet;
use std::io::Cursor;

/// Reads the picture in the `bytes` of an `.exr` file as stored, with its chromaticities (BT.709 if there are none).
/// Pixels may be negative, infinite or NaN.
///
/// # Errors
/// The reason, for damaged files, files without colour or luminance, and files that exceed `limits`.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<Contents, String> {
    let failed = |e| match e {
        ::exr::error::Error::Io(_) => "it is truncated; copy it again".into(),
        ::exr::error::Error::NotSupported(what) if what.contains("subsampl") => {
            format!("{what}; convert it to RGB first")
        }
        ::exr::error::Error::NotSupported(what) if what.contains("deep") => {
            "it contains deep data (several samples per pixel); flatten it first".into()
        }
        ::exr::error::Error::NotSupported(what) => format!("{what}; save it with ZIP compression"),
        other => match compression(bytes).filter(|&code| code > LAST_COMPRESSION) {
            Some(code) => format!("its compression, number {code}, is newer than this program; save it with ZIP"),
            None => format!("{other}; if it is truncated or damaged, copy it again"),
        },
    };
    check(&MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(failed)?, bytes.len(), limits)?;
    let (meta, layers) = unpacked(bytes).map_err(failed)?;
    let chosen = layers.iter().find_map(|layer| Some((layer, colour(&layer.channel_data.list)?)));
    let grey = || layers.iter().find_map(|layer| Some((layer, luminance(&layer.channel_data.list)?)));
    let Some((layer, channels)) = chosen.or_else(grey) else {
        let mut all = layers.iter().flat_map(|layer| &layer.channel_data.list).map(|c| c.name.to_string());
        let mut names: Vec<String> = all.by_ref().take(8).collect();
        names.extend(all.next().map(|_| "...".to_owned()));
        return Err(format!(
            "it needs R, G and B in the same part (layer) of the file, or else Y; its channels are {}",
            names.join(", ")
        ));
    };
    if channels.iter().any(|c| c.sampling != Vec2(1, 1)) {
        return Err("its chroma channels are subsampled; convert it to RGB first".into());
    }
    let (width, height) = (layer.size.width(), layer.size.height());
    let pixels = Plane::from_rows(width, height, |y, row| {
        for (c, channel) in channels.iter().enumerate() {
            fill(row, c, &channel.sample_data, y * width);
        }
    });

    let own = &layer.attributes;
    let number = |v: Option<f32>| v.map(decimal);
    let words = |t: Option<&Text>| t.map(|t| t.to_string());
    let other = |name: &str| match own.other.get(&Text::from(name)) {
        Some(AttributeValue::Text(text)) => Some(text.to_string()),
        _ => None,
    };
    let mut metadata = Metadata {
        time_s: number(own.exposure),
        f_number: number(own.aperture),
        iso: number(own.iso_speed),
        ..Metadata::default()
    };
    metadata.capture.make = other("cameraMake");
    metadata.capture.model = other("cameraModel");
    metadata.capture.lens = other("lensModel");
    metadata.capture.focal_length_mm = match own.other.get(&Text::from("nominalFocalLength")) {
        Some(AttributeValue::F32(length)) => Some(decimal(*length)),
        _ => None,
    };
    metadata.capture.date = words(own.capture_date.as_ref());
    metadata.comments.extend(words(own.comments.as_ref()));
    if let Some(c) = meta.headers.first().and_then(|header| header.shared_attributes.chromaticities) {
        let xy = |p: Vec2<f32>| [f64::from(p.0), f64::from(p.1)];
        metadata.primaries = Primaries { red: xy(c.red), green: xy(c.green), blue: xy(c.blue), white: xy(c.white) };
    }
    let mut contents = Contents::new(pixels, metadata);
    contents.set_unit("whiteLuminance", number(own.white_luminance));
    contents.unread = unread(&layers, layer, channels);
    Ok(contents)
}

/// Number of the last compression that the crate knows by name. The numbers up to it include DWAB and HTJ2K.
const LAST_COMPRESSION: u8 = 11;

/// Returns the number of the compression in the first header.
fn compression(bytes: &[u8]) -> Option<u8> {
    let attribute = b"compression\0compression\0\x01\0\0\0";
    let header = &bytes[..bytes.len().min(1 << 16)];
    let at = header.windows(attribute.len()).position(|window| window == attribute)?;
    header.get(at + attribute.len()).copied()
}

/// Checks the headers against the length of the file and the limits, because the crate does not. The headers of all
/// parts are checked, because all parts are read.
fn check(meta: &MetaData, length: usize, limits: &Limits) -> Result<(), String> {
    let (mut needed, mut blocks, mut size) = (length as u64, 0, (0, 0));
    for header in &meta.headers {
        size = (header.layer_size.width(), header.layer_size.height());
        limits.check_size(size.0, size.1)?;
        let pixels = size.0 as u64 * size.1 as u64;
        let each: u64 = header.channels.list.iter().map(|c| c.sample_type.bytes_per_sample() as u64).sum();
        let most = match header.compression {
            Compression::Uncompressed => 1,
            Compression::RLE => 64,
            // PXR24 drops one byte of four before it uses deflate. PIZ stores at best 255 repetitions of 2 bytes in 9
            // bits: a factor of 453, which is smaller than that of deflate.
            Compression::ZIP1 | Compression::ZIP16 | Compression::PIZ => DEFLATE,
            Compression::PXR24 => DEFLATE * 4 / 3,
            _ => u64::MAX,
        };
        // Subsampled channels usually have at least a quarter of the values.
        limits::check_length(length, pixels * each / 4, most)?;
        blocks += header.chunk_count as u64;
        needed = needed.saturating_add(pixels.saturating_mul(each));
    }
    // Every block takes 8 bytes in the offset table, and at least 8 for its own position and length.
    limits::check_length(length, blocks.saturating_mul(8 + 8), 1)?;
    let pixels = meta.headers.iter().map(|h| h.layer_size.area() as u64).max().unwrap_or(0);
    limits.check_memory(size, needed.saturating_add(12 * pixels))
}

/// Number of blocks that are decompressed in parallel: enough to occupy any number of threads, with some MB of memory.
const AT_ONCE: usize = 64;

/// Reads the headers and the parts of the file. The crate's own loop is not used: it decompresses in threads that no
/// other thread joins, so that a panic on a damaged block would end the process.
fn unpacked(bytes: &[u8]) -> ::exr::error::Result<(MetaData, Layers<AnyChannels<FlatSamples>>)> {
    let wanted = reader().no_deep_data().largest_resolution_level().all_channels().all_layers();
    let file = ::exr::block::read(Cursor::new(bytes), false)?;
    let mut layers = wanted.create_layers_reader(file.headers())?;
    let mut chunks = file.filter_chunks(false, |meta, tile, block| layers.filter_block(meta, tile, block))?;
    let meta = chunks.meta_data().clone();
    let mut seen = HashSet::new();
    loop {
        let some: Vec<Chunk> = chunks.by_ref().take(AT_ONCE).collect::<::exr::error::Result<_>>()?;
        if some.is_empty() {
            return Ok((meta, layers.into_layers()));
        }
        let blocks: Vec<_> =
            some.into_par_iter().map(|chunk| UncompressedBlock::decompress_chunk(chunk, &meta, false)).collect();
        for block in blocks {
            let block = block?;
            // If one block is present twice, another is missing, and would be black.
            if !seen.insert((block.index.layer, block.index.pixel_position)) {
                return Err(::exr::error::Error::Invalid("table of blocks".into()));
            }
            layers.read_block(&meta.headers, block)?;
        }
    }
}

type Channel = AnyChannel<FlatSamples>;
type Layer = ::exr::image::Layer<AnyChannels<FlatSamples>>;

/// Returns R, G and B, either without prefix or all with the same prefix and a dot.
fn colour(channels: &[Channel]) -> Option<[&Channel; 3]> {
    let named = |name: String| channels.iter().find(|c| c.name.to_string() == name);
    let prefixes = channels.iter().filter_map(|c| c.name.to_string().strip_suffix(".R").map(|p| format!("{p}.")));
    std::iter::once(String::new()).chain(prefixes).find_map(|prefix| {
        let [r, g, b] = ["R", "G", "B"].map(|c| named(format!("{prefix}{c}")));
        Some([r?, g?, b?])
    })
}

/// Returns Y for all three channels or, if there is chroma, RY, Y and BY.
fn luminance(channels: &[Channel]) -> Option<[&Channel; 3]> {
    let named = |name: &str| channels.iter().find(|c| c.name.to_string() == name);
    // Chroma is normally subsampled; the caller rejects such a file.
    Some(match (named("Y")?, named("RY"), named("BY")) {
        (y, Some(ry), Some(by)) => [ry, y, by],
        (y, ..) => [y; 3],
    })
}

/// Returns the shortest decimal that is rounded to this float: 5.6 instead of 5.599999904632568.
fn decimal(v: f32) -> f64 {
    v.to_string().parse().unwrap_or(f64::from(v))
}

/// Returns the names of what is not read: the channels of `layer` that are not `chosen`, and the other layers. A
/// layer is a part of the file, named by its number if it has no name, or a prefix before the dot in channel names.
fn unread(layers: &[Layer], layer: &Layer, chosen: [&Channel; 3]) -> Vec<String> {
    let mut found = Vec::new();
    for (number, other) in layers.iter().enumerate() {
        if !std::ptr::eq(other, layer) {
            let name = other.attributes.layer_name.as_ref().map_or_else(|| format!("{}", number + 1), Text::to_string);
            found.push(format!("layer {name}"));
            continue;
        }
        for channel in other.channel_data.list.iter().filter(|c| !chosen.iter().any(|r| std::ptr::eq(*c, *r))) {
            let name = channel.name.to_string();
            let prefix = chosen[0].name.to_string().strip_suffix('R').map(str::to_owned).unwrap_or_default();
            found.push(match (name.strip_prefix(&prefix), name.rsplit_once('.')) {
                (Some("A"), _) => "alpha".to_owned(),
                (_, Some((layer, _))) => format!("layer {layer}"),
                _ => format!("channel {name}"),
            });
        }
    }
    found.dedup();
    found
}

/// Copies channel `c` of a row from `samples`, from index `at` on, as floats.
fn fill(row: &mut [[f32; 3]], c: usize, samples: &FlatSamples, at: usize) {
    match samples {
        FlatSamples::F16(v) => row.iter_mut().zip(&v[at..]).for_each(|(p, v)| p[c] = v.to_f32()),
        FlatSamples::F32(v) => row.iter_mut().zip(&v[at..]).for_each(|(p, &v)| p[c] = v),
        FlatSamples::U32(v) => row.iter_mut().zip(&v[at..]).for_each(|(p, &v)| p[c] = v as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::{Channel, FlatSamples};
    use crate::merge::RadianceMap;
    use ::exr::prelude::*;

    fn channel(name: &str, samples: FlatSamples) -> Channel {
        AnyChannel::new(name, samples)
    }

    fn floats(f: impl Fn(usize) -> f32) -> FlatSamples {
        FlatSamples::F32((0..12).map(f).collect())
    }

    fn read_back(channels: Vec<Channel>, compression: Compression) -> crate::error::Result<RadianceMap> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.exr");
        let encoding = Encoding { compression, blocks: Blocks::Tiles(Vec2(2, 2)), line_order: LineOrder::Increasing };
        let channels = AnyChannels::sort(channels.into_iter().collect());
        let layer = Layer::new((4, 3), LayerAttributes::named("any"), encoding, channels);
        Image::from_layer(layer).write().to_file(&path).unwrap();
        crate::read::read(&path).map(|(map, _)| map)
    }

    #[test]
    fn other_writers_channels_are_found() {
        let rgb = |prefix: &str| {
            vec![
                channel(&format!("{prefix}R"), floats(|i| i as f32)),
                channel(&format!("{prefix}G"), FlatSamples::U32((0..12).map(|i| 100 + i).collect())),
                channel(
                    &format!("{prefix}B"),
                    FlatSamples::F16((0..12).map(|i| f16::from_f32(-(i as f32) / 4.0)).collect()),
                ),
                channel("A", floats(|_| 0.5)),
            ]
        };
        let expected: Vec<[f32; 3]> = (0..12).map(|i| [i as f32, 100.0 + i as f32, -(i as f32) / 4.0]).collect();
        for compression in [Compression::Uncompressed, Compression::RLE, Compression::ZIP1, Compression::PIZ] {
            for prefix in ["", "beauty."] {
                let map = read_back(rgb(prefix), compression).unwrap();
                assert_eq!((map.pixels.width(), map.pixels.as_slice()), (4, &expected[..]));
            }
        }
        let grey = read_back(vec![channel("Y", floats(|i| i as f32 / 3.0))], Compression::ZIP16).unwrap();
        assert_eq!(grey.pixels.at(2, 1), [2.0; 3]);
        let depth = read_back(vec![channel("Z", floats(|_| 1.0))], Compression::ZIP16).unwrap_err();
        assert!(depth.to_string().contains("its channels are Z"), "{depth}");
    }

    #[test]
    fn whole_files_of_newer_kinds_are_not_called_damaged() {
        let layer = SpecificChannels::rgb(|at: Vec2<usize>| (at.x() as f32, 0.5, at.y() as f32));
        let mut bytes = std::io::Cursor::new(Vec::new());
        Image::from_channels((20, 10), layer).write().to_buffered(&mut bytes).unwrap();
        let mut bytes = bytes.into_inner();
        let name = b"compression\0compression\0";
        let at = bytes.windows(name.len()).position(|window| window == name).unwrap() + name.len() + 4;
        // The crate knows HTJ2K by name, but does not support it; it does not know ZSTD.
        for code in [10, 11, 12, 13, 200] {
            bytes[at] = code;
            let reason = super::parse(&bytes, &crate::limits::Limits::default()).unwrap_err();
            assert!(reason.contains("compression") && !reason.contains("again"), "{code}: {reason}");
        }
        bytes[at] = 3;
        bytes[at - 5] = b'x';
        assert!(super::parse(&bytes, &crate::limits::Limits::default()).unwrap_err().contains("again"));
    }

    #[test]
    fn damaged_files_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.exr");
        let layer = SpecificChannels::rgb(|at: Vec2<usize>| (at.x() as f32, 0.5, at.y() as f32));
        Image::from_channels((200, 100), layer).write().to_file(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        for cut in [bytes.len() - 1, bytes.len() / 2, 100, 9] {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            assert!(matches!(crate::read::read(&path), Err(crate::error::Error::Decode { .. })), "cut at {cut}");
        }
    }

    /// Found by the fuzzer: rows of zeros in B44 cause an overflow in the crate's codec, which panics in debug
    /// builds.
    #[test]
    fn a_codec_that_panics_does_not_end_the_process() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.exr");
        let halves = || FlatSamples::F16((0..256).map(|i| f16::from_f32((i * i) as f32)).collect());
        let channels = AnyChannels::sort(["R", "G", "B"].map(|name| channel(name, halves())).into_iter().collect());
        let encoding =
            Encoding { compression: Compression::B44, blocks: Blocks::ScanLines, line_order: LineOrder::Increasing };
        let layer = Layer::new((16, 16), LayerAttributes::named("any"), encoding, channels);
        Image::from_layer(layer).write().to_file(&path).unwrap();
        let mut bytes = std::fs::read(&path).unwrap();
        let end = bytes.len();
        bytes[end - 200..].fill(0);
        std::fs::write(&path, &bytes).unwrap();
        let read = crate::read::read(&path);
        assert!(read.is_err() == cfg!(debug_assertions), "release builds give the values of other readers");
    }

    /// Found by code review for the fuzz target: a row without an entry in the table of blocks was black.
    #[test]
    fn a_block_that_is_there_twice_is_damage() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.exr");
        let layer = SpecificChannels::rgb(|at: Vec2<usize>| (at.x() as f32, 0.5, at.y() as f32));
        let encoding = Encoding::UNCOMPRESSED;
        let layer = Layer::new((4, 3), LayerAttributes::named("any"), encoding, layer);
        Image::from_layer(layer).write().to_file(&path).unwrap();
        assert!(crate::read::read(&path).is_ok());
        let mut bytes = std::fs::read(&path).unwrap();
        let number = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
        let table = (0..bytes.len() - 24).find(|&at| number(at) == at as u64 + 24).unwrap();
        bytes.copy_within(table..table + 8, table + 16);
        std::fs::write(&path, &bytes).unwrap();
        let error = crate::read::read(&path).unwrap_err().to_string();
        assert!(error.contains("table of blocks"), "{error}");
    }
}
