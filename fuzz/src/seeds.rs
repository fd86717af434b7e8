//! The first corpus: small files of every kind, written by the program and by the encoders of its tests.
//!
//! In: a folder. Out: a folder for each target in it, with its inputs. Cost: a second.

use crate::{folder, put};
use exif::experimental::Writer;
use exif::{Field, In, Rational, Tag, Value};
use exr::prelude::{
    AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes, LineOrder, Vec2,
    WritableImage, f16,
};
use hdralign::align::{AlignMode, AlignOptions};
use hdralign::batch::plan::{self, Planned, Responses, Settings};
use hdralign::bracket::LoadOptions;
use hdralign::bracket::colour::Profile;
use hdralign::merge::RadianceMap;
use hdralign::pipeline::{self, Options, TonemapOptions};
use hdralign::plane::Plane;
use hdralign::read;
use hdralign::response::ResponseCurve;
use hdralign::response::file::SavedResponse;
use hdralign::write::{exr as write_exr, hdr, tiff as write_tiff};
use image::{DynamicImage, ExtendedColorType, GrayImage, ImageBuffer, Rgb, RgbImage};
use std::borrow::Cow;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use tiff::encoder::{Compression as TiffCompression, DeflateLevel, TiffEncoder, colortype};

/// Writes the corpus to the folder `to`.
pub fn write(to: &Path) {
    let give = |target: &str, name: &str, bytes: &[u8]| {
        let folder = to.join(target);
        fs::create_dir_all(&folder).expect("a folder");
        fs::write(folder.join(name), bytes).expect("room for a small file");
    };
    photographs(&|name, bytes| give("photograph", name, bytes));
    radiance(&|name, bytes| give("radiance", name, bytes));
    responses(&|name, bytes| give("response_file", name, bytes));
    line_and_plans(
        &|name, kind, bytes| give("plans", name, &[&[kind], bytes].concat()),
        &|name, bytes| give("photograph", name, bytes),
    );
    for i in 0..64u64 {
        // As different from each other as possible, because parameters are drawn from them.
        let drawn = |k: u64| (crate::hash(&(i * 1000 + k).to_le_bytes()) >> 32) as u8;
        let bytes: Vec<u8> = (0..64 + 6 * i).map(drawn).collect();
        give("gain_map", &format!("drawn-{i}"), &bytes);
        give("line", &format!("drawn-{i}"), &bytes);
    }
}

/// A picture of this size that is neither uniform nor noise.
fn picture(width: u32, height: u32, i: u32) -> RgbImage {
    let code = |x: u32, y: u32, c: u32| ((x * 13 + y * 29 + c * 50 + x * y) % 200 * (i + 1) / 3).min(255) as u8;
    RgbImage::from_fn(width, height, |x, y| Rgb([0, 1, 2].map(|c| code(x, y, c))))
}

/// An EXIF block as in a Canon: exposure, times, orientation, a maker note with the position in a bracket.
fn exif_block() -> Vec<u8> {
    let text = |text: &str| Value::Ascii(vec![text.as_bytes().to_vec()]);
    let ratio = |num, denom| Value::Rational(vec![Rational { num, denom }]);
    let mut note = 2u16.to_be_bytes().to_vec();
    for (tag, kind, count, value) in [(4u16, 3u16, 33u32, 300u32), (12, 4, 1, 1_130_415_723)] {
        note.extend(tag.to_be_bytes().into_iter().chain(kind.to_be_bytes()));
        note.extend(count.to_be_bytes().into_iter().chain(value.to_be_bytes()));
    }
    note.extend([0, 9].repeat(33));
    let fields = [
        (Tag::Make, text("Canon")),
        (Tag::Model, text("EOS 5D")),
        (Tag::Orientation, Value::Short(vec![6])),
        (Tag::Software, text("1.0")),
        (Tag::ExposureTime, ratio(1, 60)),
        (Tag::FNumber, ratio(28, 10)),
        (Tag::PhotographicSensitivity, Value::Short(vec![100])),
        (Tag::DateTimeOriginal, text("2026:11:21 17:05:59")),
        (Tag::SubSecTimeOriginal, text("25")),
        (Tag::ExposureBiasValue, Value::SRational(vec![exif::SRational { num: -2, denom: 3 }])),
        (Tag::ExposureMode, Value::Short(vec![2])),
        (Tag::Flash, Value::Short(vec![1])),
        (Tag::LensModel, text("50 mm")),
        (Tag::FocalLength, ratio(50, 1)),
        (Tag::BodySerialNumber, text("4711")),
        (Tag::MakerNote, Value::Undefined(note, 0)),
        (Tag::GPSLatitudeRef, text("N")),
        (Tag::GPSLatitude, Value::Rational(vec![Rational { num: 48, denom: 1 }; 3])),
    ];
    let fields = fields.map(|(tag, value)| Field { tag, ifd_num: In::PRIMARY, value });
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut block = Cursor::new(Vec::new());
    writer.write(&mut block, false).expect("EXIF");
    block.into_inner()
}

fn jpeg(pixels: &[u8], size: (u32, u32), kind: ExtendedColorType, segment: Option<(u8, Vec<u8>)>) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 60);
    encoder.encode(pixels, size.0, size.1, kind).expect("a JPEG");
    if let Some((code, content)) = segment {
        let length = (content.len() as u16 + 2).to_be_bytes();
        bytes.splice(2..2, [&[0xFF, code], &length[..], &content].concat());
    }
    bytes
}

fn png(kind: png::ColorType, depth: png::BitDepth, samples: &[u8], change: impl Fn(&mut png::Info)) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut info = png::Info::with_size(9, 7);
    (info.color_type, info.bit_depth) = (kind, depth);
    change(&mut info);
    let mut writer = png::Encoder::with_info(&mut bytes, info).and_then(|e| e.write_header()).expect("a PNG");
    writer.write_image_data(samples).expect("a PNG");
    writer.finish().expect("a PNG");
    bytes
}

fn photographs(give: &dyn Fn(&str, &[u8])) {
    let rgb = picture(9, 7, 2);
    let grey: GrayImage = DynamicImage::ImageRgb8(rgb.clone()).to_luma8();
    let icc = Profile::adobe_rgb().or_else(Profile::srgb).map(|profile| profile.icc).unwrap_or_default();
    let exif = exif_block();
    give("profile.icc", &icc);
    give("block.exif", &exif);
    give("rgb.jpg", &jpeg(&rgb, (9, 7), ExtendedColorType::Rgb8, None));
    give("grey.jpg", &jpeg(&grey, (9, 7), ExtendedColorType::L8, None));
    let with_exif = [b"Exif\0\0", &exif[..]].concat();
    give("exif.jpg", &jpeg(&rgb, (9, 7), ExtendedColorType::Rgb8, Some((0xE1, with_exif))));
    let with_icc = [b"ICC_PROFILE\0\x01\x01", &icc[..]].concat();
    give("icc.jpg", &jpeg(&rgb, (9, 7), ExtendedColorType::Rgb8, Some((0xE2, with_icc))));

    use png::{BitDepth, ColorType};
    let words: Vec<u8> = rgb.iter().flat_map(|&v| [v, v ^ 0x55]).collect();
    let alpha: Vec<u8> = rgb.chunks(3).flat_map(|p| [p[0], p[1], p[2], 200]).collect();
    give("rgb.png", &png(ColorType::Rgb, BitDepth::Eight, &rgb, |_| ()));
    give("deep.png", &png(ColorType::Rgb, BitDepth::Sixteen, &words, |_| ()));
    give("grey.png", &png(ColorType::Grayscale, BitDepth::Eight, &grey, |_| ()));
    give("alpha.png", &png(ColorType::Rgba, BitDepth::Eight, &alpha, |_| ()));
    let bits = [0b1010_1100, 0x80].repeat(7);
    give("bits.png", &png(ColorType::Grayscale, BitDepth::One, &bits, |_| ()));
    let nibbles = [0x01, 0x21, 0x10, 0x02, 0x10].repeat(7);
    let palette = png(ColorType::Indexed, BitDepth::Four, &nibbles, |info| {
        info.palette = Some(Cow::Owned(vec![255, 0, 0, 0, 255, 0, 0, 0, 255]));
        info.trns = Some(Cow::Owned(vec![255, 128]));
    });
    give("palette.png", &palette);
    let tagged = png(ColorType::Rgb, BitDepth::Eight, &rgb, |info| {
        info.exif_metadata = Some(Cow::Owned(exif.clone()));
        info.icc_profile = Some(Cow::Owned(icc.clone()));
    });
    give("tagged.png", &tagged);

    for (name, compression) in [
        ("plain", TiffCompression::Uncompressed),
        ("lzw", TiffCompression::Lzw),
        ("deflate", TiffCompression::Deflate(DeflateLevel::Fast)),
        ("packbits", TiffCompression::Packbits),
    ] {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).expect("a TIFF").with_compression(compression);
        encoder.write_image::<colortype::RGB8>(9, 7, &rgb).expect("a TIFF");
        give(&format!("{name}.tif"), &bytes.into_inner());
    }
    let mut bytes = Cursor::new(Vec::new());
    let mut encoder = TiffEncoder::new_big(&mut bytes).expect("a TIFF");
    let deep: Vec<u16> = rgb.iter().map(|&v| u16::from(v) * 257).collect();
    encoder.write_image::<colortype::RGB16>(9, 7, &deep).expect("a TIFF");
    give("big.tif", &bytes.into_inner());
    let mut bytes = Cursor::new(Vec::new());
    let inks: Vec<u8> = rgb.iter().chain(rgb.iter()).copied().take(4 * 63).collect();
    TiffEncoder::new(&mut bytes).expect("a TIFF").write_image::<colortype::CMYK8>(9, 7, &inks).expect("a TIFF");
    give("cmyk.tif", &bytes.into_inner());
}

fn radiance(give: &dyn Fn(&str, &[u8])) {
    let pixels = Plane::from_rows(13, 9, |y, row: &mut [[f32; 3]]| {
        row.iter_mut().enumerate().for_each(|(x, p)| *p = [0.01, 1.0, 7.5].map(|v| v * (1 + x * y) as f32));
    });
    let source = put("seed.exr", &[]);
    exr_file(&source, &pixels, Compression::Uncompressed, Blocks::ScanLines, "");
    let written = |name: &str, change: &dyn Fn(&mut TonemapOptions)| {
        let path = folder().join(name);
        let mut options = TonemapOptions { outputs: vec![path.clone()], ..TonemapOptions::default() };
        options.write.overwrite = true;
        change(&mut options);
        pipeline::tonemap_file(&source, &options, &pipeline::unwatched).expect("a picture");
        give(name, &fs::read(path).expect("it was written"));
    };
    use write_exr::{Compression as Own, Sample};
    let packings = [("piz", Own::Piz), ("zip16", Own::Zip16), ("zip1", Own::Zip1), ("none", Own::None)];
    for (name, compression) in packings {
        for (kind, sample) in [("half", Sample::Half), ("float", Sample::Float)] {
            written(&format!("{name}-{kind}.exr"), &|options| {
                options.write.exr = write_exr::Options { sample, compression };
            });
        }
    }
    written("rgbe.hdr", &|_| ());
    written("xyze.hdr", &|options| options.write.hdr = hdr::Encoding::Xyze);
    written("float.tif", &|_| ());
    written("luv24.tif", &|options| options.write.tiff = write_tiff::Encoding::LogLuv24);
    written("luv32.tif", &|options| options.write.tiff = write_tiff::Encoding::LogLuv32);
    let packings = [
        ("rle", Compression::RLE),
        ("zip", Compression::ZIP16),
        ("piz", Compression::PIZ),
        ("pxr24", Compression::PXR24),
        ("b44", Compression::B44),
        ("b44a", Compression::B44A),
    ];
    for (name, compression) in packings {
        for (kind, blocks) in [("lines", Blocks::ScanLines), ("tiles", Blocks::Tiles(Vec2(4, 4)))] {
            let path = folder().join("crate.exr");
            exr_file(&path, &pixels, compression, blocks, "beauty.");
            give(&format!("crate-{name}-{kind}.exr"), &fs::read(&path).expect("it was written"));
        }
    }
    give("old.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2\n\n+X 2 -Y 3\n\x80\x40\x20\x81\x01\x01\x01\x02\x80\x80\x80\x80\x10\x20\x30\x40\x01\x01\x01\x01");
    let map = read::read(&source).map(|(map, _)| map).unwrap_or_else(|e| panic!("{e}"));
    let RadianceMap { pixels, .. } = map;
    for (name, turn) in [("one", 1u16), ("five", 5)] {
        let mut bytes = Cursor::new(Vec::new());
        let mut encoder = TiffEncoder::new(&mut bytes).expect("a TIFF");
        let mut picture = encoder.new_image::<colortype::RGB32Float>(13, 9).expect("a TIFF");
        picture.encoder().write_tag(tiff::tags::Tag::Orientation, turn).expect("a TIFF");
        picture.rows_per_strip(4).expect("a TIFF");
        picture.write_data(pixels.as_slice().as_flattened()).expect("a TIFF");
        give(&format!("strips-{name}.tif"), &bytes.into_inner());
    }
}

/// Encodes `pixels` with the `exr` crate: three sample types, with a prefix.
fn exr_file(path: &Path, pixels: &Plane<[f32; 3]>, compression: Compression, blocks: Blocks, prefix: &str) {
    let values = |c: usize| pixels.as_slice().iter().map(move |p| p[c]);
    let channels = [
        AnyChannel::new(format!("{prefix}R").as_str(), FlatSamples::F32(values(0).collect())),
        AnyChannel::new(format!("{prefix}G").as_str(), FlatSamples::F16(values(1).map(f16::from_f32).collect())),
        AnyChannel::new(format!("{prefix}B").as_str(), FlatSamples::U32(values(2).map(|v| v as u32).collect())),
    ];
    let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
    let channels = AnyChannels::sort(channels.into_iter().collect());
    let size = (pixels.width(), pixels.height());
    let layer = Layer::new(size, LayerAttributes::named("any"), encoding, channels);
    Image::from_layer(layer).write().to_file(path).expect("an EXR");
}

fn responses(give: &dyn Fn(&str, &[u8])) {
    let curves = [("srgb", ResponseCurve::srgb()), ("linear", ResponseCurve::linear())];
    for (name, curve) in curves {
        let curve = curve.with_black([0.0, 1.5, 7.0]).expect("black codes");
        let saved = SavedResponse { make: Some("Canon".into()), model: Some("EOS 5D".into()), curve };
        for (kind, extension) in ["json", "rsp", "csv"].iter().enumerate() {
            if let Ok(encoded) = saved.encode(Path::new(&format!("c.{extension}"))) {
                give(&format!("{name}-{extension}"), &[&[kind as u8], encoded.text.as_bytes()].concat());
            }
        }
    }
    let mut table = "# type: matrix\n# rows: 256\n# columns: 3\n".to_owned();
    (0..256).for_each(|z| table += &format!("{z} {} {}\n", z, f64::from(z) / 255.0));
    give("pfstools", &[&[2], table.repeat(3).as_bytes()].concat());
}

/// Files written by a run and a plan.
fn line_and_plans(plans: &dyn Fn(&str, u8, &[u8]), photograph: &dyn Fn(&str, &[u8])) {
    let frames: Vec<PathBuf> = (0..3)
        .map(|i| {
            let path = folder().join(format!("seed-{i}.png"));
            let wide = ImageBuffer::from_fn(16, 12, |x, y| Rgb(picture(16, 12, i).get_pixel(x, y).0.map(|v| u16::from(v) * 257)));
            DynamicImage::ImageRgb16(wide).save(&path).expect("room for a small file");
            path
        })
        .collect();
    let at = |name: &str| folder().join(name);
    let options = Options {
        load: LoadOptions { ev: Some(vec![-1.0, 0.0, 0.6]), ..LoadOptions::default() },
        align: AlignOptions { mode: AlignMode::None, ..AlignOptions::default() },
        outputs: ["s.png", "s.jpg"].map(at).into(),
        save_aligned: Some(at("aligned-")),
        transforms: Some(at("s-transforms.json")),
        report: Some(at("s.json")),
        ..Options::default()
    };
    pipeline::run(&frames, &options, &pipeline::unwatched).expect("a merged bracket");
    let bytes = |name: &str| fs::read(at(name)).expect("it was written");
    photograph("own.png", &bytes("s.png"));
    photograph("own.jpg", &bytes("s.jpg"));
    let is_aligned = |name: &str| name.starts_with("aligned-");
    let names = fs::read_dir(folder()).expect("a folder").flatten().filter_map(|e| e.file_name().into_string().ok());
    for name in names.filter(|name| is_aligned(name)) {
        photograph(&name, &bytes(&name));
    }
    plans("transforms", 0, &bytes("s-transforms.json"));
    let placed = r#"{"schema":"hdralign-transforms/1","width_px":16,"height_px":12,"reference":"b","frames":[
        {"file":"a","status":"aligned","model":"homography","homography":[1,0.01,-1.5,-0.01,1,0.25,1e-4,0,1],"confidence":0.9},
        {"file":"c","status":"unmoved","homography":[1,0,0,0,1,0,0,0,1]}]}"#;
    plans("placed", 0, placed.as_bytes());
    plans("report", 2, &bytes("s.json"));
    let record = r#"{"warnings":[{"degrades":true,"message":"m"}],"frames":[{"alignment":{"status":"rejected","confidence":0.5}}],
        "time_s":{"total":1.5},"step":{"id":"a","key":"k","software":"s","options":[],"inputs":[{"name":"a","bytes":1,"sha256":"x"}],
        "outputs":[{"name":"r.json","bytes":3,"sha256":"y"}],"replaced":["z"]}}"#;
    plans("record", 2, record.as_bytes());
    plans("failure", 2, br#"{"schema":"hdralign-failure/1","id":"a","error":"e"}"#);
    let planned = Planned {
        root: "/in".into(),
        folder: "a".into(),
        photographs: frames,
        size: (16, 12),
        depth: 16,
        exposures: vec![0.01, 0.02],
        camera: Some("Canon EOS 5D".into()),
        ..Planned::default()
    };
    let settings = Settings {
        output: Some("/out".into()),
        formats: vec!["exr".into(), "png".into()],
        page: true,
        responses: Responses::Shared,
        ..Settings::default()
    };
    let steps = plan::plan(&[planned.clone(), planned], &settings).expect("a plan");
    let lines: Vec<String> = steps.iter().map(|step| step.to_line().expect("UTF-8")).collect();
    plans("plan", 1, (lines.join("\n") + "\n").as_bytes());
    plans("template", 3, b"{folder}/{first}-{last} {number} {camera} {date}\na\n../b\nc/d\nCanon\n2026:11:21 17:05:59");
}
