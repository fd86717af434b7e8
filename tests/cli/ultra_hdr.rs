//! `.jpg`: a JPEG with a gain map, read by the rules of viewers (the reader of libultrahdr; ISO 21496-1, annex C; CIPA
//! DC-007).

use crate::support::{Folder, jpeg_with, ratio, small};
use exif::{In, Tag, Value};
use hdralign::bracket::colour::{Conversion, Found, Primaries, Profile, srgb_to_linear};
use hdralign::merge::RadianceMap;
use hdralign::plane::Plane;
use hdralign::read::read;
use hdralign::tonemap::DisplayImage;
use hdralign::write::{self, Metadata};
use image::RgbImage;

const XMP: &[u8] = b"http://ns.adobe.com/xap/1.0/\0";
const ISO: &[u8] = b"urn:iso:std:iso:ts:21496:-1\0";

/// A JPEG: its segments up to the scan, each with its marker and the offset of its content, and all its bytes.
struct Image<'a> {
    segments: Vec<(u8, usize, &'a [u8])>,
    bytes: &'a [u8],
}

impl<'a> Image<'a> {
    /// Parses the image at the start of `file`, to its end marker; panics on anything unexpected.
    fn parse(file: &'a [u8]) -> Self {
        assert_eq!(file[..2], [0xFF, 0xD8], "start of image");
        let (mut at, mut segments) = (2, Vec::new());
        loop {
            assert_eq!(file[at], 0xFF, "a marker at {at}");
            let code = file[at + 1];
            assert!(matches!(code, 0xC0 | 0xC4 | 0xDA..=0xDD | 0xE0..=0xEF), "marker {code:X} at {at}");
            let length = usize::from(u16::from_be_bytes([file[at + 2], file[at + 3]]));
            segments.push((code, at + 4, &file[at + 4..at + 2 + length]));
            at += 2 + length;
            if code == 0xDA {
                break;
            }
        }
        let mut restarts = 0u8;
        loop {
            at += file[at..].iter().position(|&b| b == 0xFF).expect("an end marker");
            match file[at + 1] {
                0 => {}
                0xD9 => break,
                code => {
                    assert_eq!(code, 0xD0 + restarts % 8, "restarts are numbered in order");
                    restarts = restarts.wrapping_add(1);
                }
            }
            at += 2;
        }
        Image { segments, bytes: &file[..at + 2] }
    }

    /// Returns the content after `name` of the only segment with the marker `code` that begins with `name`.
    fn named(&self, code: u8, name: &[u8]) -> &'a [u8] {
        self.find(code, name).unwrap_or_else(|| panic!("no {}", String::from_utf8_lossy(name))).1
    }

    /// Returns the content after `name` and its offset, of the only segment with the marker `code` that begins with
    /// `name`.
    fn find(&self, code: u8, name: &[u8]) -> Option<(usize, &'a [u8])> {
        let all: Vec<_> = self.segments.iter().filter(|s| s.0 == code && s.2.starts_with(name)).collect();
        assert!(all.len() < 2, "one {}", String::from_utf8_lossy(name));
        all.first().map(|s| (s.1 + name.len(), &s.2[name.len()..]))
    }

    fn xmp(&self) -> &'a str {
        std::str::from_utf8(self.named(0xE1, XMP)).expect("UTF-8")
    }

    fn decoded(&self) -> RgbImage {
        image::load_from_memory(self.bytes).expect("a JPEG").to_rgb8()
    }
}

/// Returns the value of the attribute `name`, which must occur once.
fn attribute<'a>(xml: &'a str, name: &str) -> &'a str {
    let parts: Vec<&str> = xml.split(&format!(" {name}=\"")).collect();
    assert_eq!(parts.len(), 2, "{name} in {xml}");
    parts[1].split('"').next().expect("an end")
}

fn number(xml: &str, name: &str) -> f64 {
    attribute(xml, name).parse().expect("a number")
}

fn be32(bytes: &[u8]) -> usize {
    u32::from_be_bytes(bytes[..4].try_into().expect("four bytes")) as usize
}

/// The contents of a file as a reader of gain maps sees them.
struct UltraHdr {
    base: RgbImage,
    map: RgbImage,
    least: f64,
    most: f64,
    offset: f64,
}

impl UltraHdr {
    fn parse(file: &[u8]) -> Self {
        let first = Image::parse(file);
        let second = Image::parse(&file[first.bytes.len()..]);
        assert_eq!(first.bytes.len() + second.bytes.len(), file.len(), "nothing between and behind");

        // GContainer: the length is that of the second image, which is the end of the file.
        let xmp = first.xmp();
        assert_eq!(attribute(xmp, "hdrgm:Version"), "1.0");
        assert_eq!(number(xmp, "Item:Length") as usize, second.bytes.len());
        let items: Vec<&str> = xmp.split("<Container:Item ").skip(1).collect();
        assert_eq!(items.len(), 2);
        for (item, semantic) in items.iter().zip(["Primary", "GainMap"]) {
            assert!(item.starts_with(&format!("Item:Semantic=\"{semantic}\" Item:Mime=\"image/jpeg\"")), "{item}");
        }

        // MPF: offsets are relative to the byte order mark; that of the first image is 0 by the standard.
        let (mark, mpf) = first.find(0xE2, b"MPF\0").expect("an index");
        assert_eq!(mpf[..10], *b"MM\0*\0\0\0\x08\0\x03");
        let tags: Vec<u16> = (0..3).map(|i| u16::from_be_bytes([mpf[10 + 12 * i], mpf[11 + 12 * i]])).collect();
        assert_eq!(tags, [0xB000, 0xB001, 0xB002]);
        assert_eq!((&mpf[18..22], be32(&mpf[30..]), be32(&mpf[38..])), (&b"0100"[..], 2, 32));
        let entries = &mpf[be32(&mpf[42..])..];
        assert_eq!(entries.len(), 32);
        assert_eq!((be32(entries), be32(&entries[4..]), be32(&entries[8..])), (0x30000, first.bytes.len(), 0));
        assert_eq!((be32(&entries[16..]), be32(&entries[20..])), (0, second.bytes.len()));
        assert_eq!(mark + be32(&entries[24..]), first.bytes.len());

        // ISO 21496-1: the first image has the version, and the second all parameters, which are equal to those in its
        // XMP.
        assert_eq!(first.named(0xE2, ISO), [0; 4]);
        let iso = second.named(0xE2, ISO);
        assert_eq!(
            iso[..5],
            [0, 0, 0, 0, 0x40],
            "version 0 to read and written; one channel for all, in the base's space"
        );
        assert_eq!(iso.len(), 5 + 7 * 8);
        let fractions: Vec<f64> =
            iso[5..].chunks(8).map(|f| f64::from(be32(f) as u32 as i32) / be32(&f[4..]) as f64).collect();
        let xmp = second.xmp();
        let fields =
            ["HDRCapacityMin", "HDRCapacityMax", "GainMapMin", "GainMapMax", "Gamma", "OffsetSDR", "OffsetHDR"];
        let numbers = fields.map(|name| number(xmp, &format!("hdrgm:{name}")));
        assert_eq!(fractions, numbers);
        let [capacity_min, capacity_max, least, most, gamma, offset, offset_hdr] = numbers;
        assert!(capacity_min >= 0.0 && capacity_max > capacity_min && most > least && (0.0..0.1).contains(&offset));
        assert_eq!((gamma, offset), (1.0, offset_hdr));
        assert_eq!((attribute(xmp, "hdrgm:Version"), attribute(xmp, "hdrgm:BaseRenditionIsHDR")), ("1.0", "False"));
        assert!(first.find(0xE2, b"ICC_PROFILE\0").is_some() && first.find(0xE1, b"Exif\0\0").is_some());

        let (base, map) = (first.decoded(), second.decoded());
        let step = base.width().div_ceil(map.width());
        assert_eq!(map.dimensions(), (base.width().div_ceil(step), base.height().div_ceil(step)));
        UltraHdr { base, map, least, most, offset }
    }

    /// Returns the HDR rendition of a channel of a pixel, relative to white (ISO 21496-1, 6.2), and the code value of
    /// the base image.
    fn light(&self, x: u32, y: u32, c: usize) -> (f64, u8) {
        let code = self.base.get_pixel(x, y).0[c];
        let gain = f64::from(self.map.get_pixel(x, y).0[c]) / 255.0;
        let stops = self.least + gain * (self.most - self.least);
        let base = srgb_to_linear(f64::from(code) / 255.0);
        ((base + self.offset) * stops.exp2() - self.offset, code)
    }
}

/// Returns the share of the values that the gain map restores within 0.1 stop, of those with a reliable code value and
/// a gain within the range of the map.
fn share_within(hdr: &UltraHdr, map: &RadianceMap) -> f64 {
    let mut ratios = Vec::new();
    let mut reported = Vec::new();
    for y in 0..map.pixels.height() {
        for (x, pixel) in map.pixels.row(y).iter().enumerate() {
            for c in 0..3 {
                let (light, code) = hdr.light(x as u32, y as u32, c);
                if (8..=250).contains(&code) && pixel[c] > 0.0 {
                    let base = srgb_to_linear(f64::from(code) / 255.0);
                    ratios.push((light.max(1e-9) / f64::from(pixel[c])).log2());
                    reported.push((light, base, f64::from(pixel[c])));
                }
            }
        }
    }
    ratios.sort_by(f64::total_cmp);
    let white = ratios[ratios.len() / 2];
    let (mut within, mut all) = (0.0, 0.0);
    for (light, base, radiance) in reported {
        let wanted = radiance * white.exp2();
        let gain = ((wanted + hdr.offset) / (base + hdr.offset)).log2();
        if (hdr.least..=hdr.most).contains(&gain) && wanted <= 64.0 {
            all += 1.0;
            within += f64::from(u8::from((light.max(1e-9) / wanted).log2().abs() <= 0.1));
        }
    }
    assert!(all > 0.5 * ratios.len() as f64, "most of it is in range");
    within / all
}

/// Returns a tinted scene of nine stops, with lamps and fine texture; its sides are odd, and it has several strips of
/// rows.
fn lamps() -> RadianceMap {
    let (width, height) = (333, 64 * 3 + 21);
    let pixels = Plane::from_rows(width, height, |y, row| {
        for (x, p) in row.iter_mut().enumerate() {
            let ramp = 0.02 * (x as f32 / 50.0).exp2();
            let lamp = if (x / 40 + y / 40) % 5 == 0 { 8.0 } else { 1.0 };
            let texture = 1.0 + 0.2 * (((x * 7919 + y * 104_729) % 1009) as f32 / 1009.0);
            *p = [ramp * lamp * texture, 0.8 * ramp * lamp, 0.5 * ramp * texture];
        }
    });
    RadianceMap { pixels, primaries: Primaries::SRGB }
}

fn written(folder: &Folder, name: &str, map: &RadianceMap) {
    let display = DisplayImage { pixels: Plane::filled(map.pixels.width(), map.pixels.height(), [0; 3]) };
    let float = write::exr::Options { sample: write::exr::Sample::Float, ..Default::default() };
    let options = write::Options { exr: float, ..Default::default() };
    let files = write::write(&[folder.at(name)], map, &display, &Metadata::default(), &options).expect("written");
    write::commit(files.into_iter().map(|w| w.file).collect(), true).expect("named");
}

#[test]
fn the_map_gives_the_radiance_back() {
    let folder = Folder::empty();
    let map = lamps();
    written(&folder, "lamps.exr", &map);
    folder.line("tonemap lamps.exr -o a.jpg -q").done();
    let hdr = UltraHdr::parse(&folder.bytes("a.jpg"));
    assert_eq!(hdr.base.dimensions(), hdr.map.dimensions());
    let share = share_within(&hdr, &map);
    assert!(share > 0.97, "{share}");

    // If the picture is in Display P3, the gain map is also for Display P3, as its profile states.
    folder.line("tonemap lamps.exr -o p3.jpg --picture-colour display-p3 -q").done();
    let bytes = folder.bytes("p3.jpg");
    let wide = UltraHdr::parse(&bytes);
    let to_p3 = Conversion::between(&Primaries::SRGB, &Primaries::DISPLAY_P3).expect("two spaces");
    let pixels = map.pixels.as_slice().iter().map(|p| to_p3.apply(*p)).collect();
    let of_p3 = Plane::from_vec(map.pixels.width(), map.pixels.height(), pixels);
    let share = share_within(&wide, &RadianceMap { pixels: of_p3, primaries: Primaries::DISPLAY_P3 });
    assert!(share > 0.97, "{share}");
    // Compared with the radiance in sRGB, the result would be wrong.
    assert!(share_within(&wide, &map) < 0.9);
    let profile = Image::parse(&bytes).named(0xE2, b"ICC_PROFILE\0\x01\x01").to_vec();
    let Found::Rgb(profile) = Profile::parse(profile) else { panic!("no profile") };
    assert_eq!(profile.primaries, Some(Primaries::DISPLAY_P3));

    folder.line("tonemap lamps.exr -o half.jpg --gain-map half -q").done();
    let half = UltraHdr::parse(&folder.bytes("half.jpg"));
    assert_eq!((half.map.dimensions(), &half.base), ((167, 107), &hdr.base));

    folder.line("tonemap lamps.exr -o none.jpg --gain-map none -q").done();
    let bytes = folder.bytes("none.jpg");
    let plain = Image::parse(&bytes);
    assert_eq!((plain.bytes.len(), plain.decoded()), (bytes.len(), hdr.base));
    assert!(plain.find(0xE2, b"MPF\0").is_none() && plain.find(0xE1, XMP).is_none());
}

#[test]
fn gain_map_of_a_merge_is_valid_and_the_file_reads_as_a_photograph() {
    let folder = Folder::with_bracket();
    folder
        .line("merge w2.jpg w3.jpg w4.jpg --align none -o a.exr --exr-type float -o a.jpg -o b.jpg -o a.png -q")
        .done();
    let bytes = folder.bytes("a.jpg");
    assert!(bytes == folder.bytes("b.jpg"));
    let hdr = UltraHdr::parse(&bytes);
    let (map, _) = read(&folder.at("a.exr")).expect("an EXR");
    let share = share_within(&hdr, &map);
    assert!(share > 0.97, "{share}");
    // The picture is that of the PNG, except for the losses of JPEG. Its quantisation steps are 2 to 14 at this
    // quality, so the mean error is below 3.5 even if all frequencies are present.
    let png = image::open(folder.at("a.png")).expect("a PNG").to_rgb8();
    let mean = png.as_raw().iter().zip(hdr.base.as_raw()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>()
        / png.as_raw().len() as f64;
    assert!(mean < 3.5, "{mean}");
    let quality = |q: u32| {
        folder.line(&format!("tonemap a.exr -o q.jpg --jpeg-quality {q} --force -q")).done();
        Image::parse(&folder.bytes("q.jpg")).bytes.len()
    };
    assert!(quality(40) * 2 < quality(95));
    // The same file with another program's name is a photograph, as from a phone.
    let mut phone = bytes;
    while let Some(at) = phone.windows(9).position(|name| name == b"hdralign ") {
        phone[at..at + 9].copy_from_slice(b"darkroom ");
    }
    folder.put("phone.jpg", &phone);
    folder.line("merge phone.jpg w1.jpg -e=0,-2 --align none --crop none -o again.exr -q").done();
}

/// The photographs have EXIF of all kinds: fields that are valid for the result are kept; the location is kept only
/// with `--keep-gps`.
#[test]
fn exif_is_carried_over_and_put_right() {
    let folder = Folder::with_bracket();
    let text = |text: &str| Value::Ascii(vec![text.as_bytes().to_vec()]);
    for (name, i, time) in [("a.jpg", 2, 100), ("b.jpg", 3, 25)] {
        let fields = [
            (Tag::Make, text("Maker")),
            (Tag::Orientation, Value::Short(vec![3])),
            (Tag::Artist, text("Somebody")),
            (Tag::ExposureTime, ratio(1, time)),
            (Tag::LensModel, text("50 mm")),
            (Tag::DateTimeOriginal, text("2012:07:19 05:16:25")),
            (Tag::MakerNote, Value::Undefined(vec![7; 40], 0)),
            (Tag::PixelXDimension, Value::Long(vec![9999])),
            (Tag::GPSLatitudeRef, text("N")),
            (Tag::GPSLatitude, Value::Rational(vec![exif::Rational { num: 48, denom: 1 }; 3])),
        ];
        folder.put(name, &jpeg_with(&small(i), &fields));
    }
    let read = |name: &str, options: &str| {
        folder.line(&format!("merge a.jpg b.jpg --align none --picture {name} --force -q {options}")).done();
        let mut file = std::io::Cursor::new(folder.bytes(name));
        let size = image::image_dimensions(folder.at(name)).expect("a picture");
        (exif::Reader::new().read_from_container(&mut file).expect("EXIF"), size)
    };
    for name in ["r.jpg", "r.png", "r.tif"] {
        let (carried, (width, height)) = read(name, "");
        let shown = |tag| carried.get_field(tag, In::PRIMARY).map(|f| f.display_value().to_string());
        for (tag, value) in [
            (Tag::Make, "\"Maker\"".to_string()),
            (Tag::Artist, "\"Somebody\"".into()),
            (Tag::LensModel, "\"50 mm\"".into()),
            (Tag::DateTimeOriginal, "2012-07-19 05:16:25".into()),
            (Tag::Orientation, "row 0 at top and column 0 at left".into()),
            (Tag::Software, format!("\"hdralign {}\"", env!("CARGO_PKG_VERSION"))),
            (Tag::ColorSpace, "sRGB".into()),
        ] {
            assert_eq!(shown(tag), Some(value), "{name} {tag}");
        }
        // A TIFF has its size in other tags (EXIF 2.32, table 17).
        let sizes = [(Tag::PixelXDimension, width), (Tag::PixelYDimension, height)];
        let expected = |side: u32| (name != "r.tif").then(|| side.to_string());
        assert!(sizes.into_iter().all(|(tag, side)| shown(tag) == expected(side)), "{name}");
        assert!(shown(Tag::ExposureTime).is_some_and(|t| t == "1/100" || t == "1/25"), "{name}");
        let left_out = [Tag::MakerNote, Tag::GPSLatitude, Tag::GPSLatitudeRef];
        assert!(left_out.into_iter().all(|tag| shown(tag).is_none()), "{name}");
        let pointers = [[0x88, 0x25, 0, 4], [0x25, 0x88, 4, 0]];
        assert!(
            !folder.bytes(name).windows(4).any(|w| pointers.iter().any(|p| w == p)),
            "{name}: no pointer to a place"
        );
        let (kept, _) = read(name, "--keep-gps --picture-colour display-p3");
        let latitude = kept.get_field(Tag::GPSLatitude, In::PRIMARY).map(|f| f.display_value().to_string());
        assert_eq!(latitude.as_deref(), Some("48 deg 48 min 48 sec"), "{name}");
        let colours = kept.get_field(Tag::ColorSpace, In::PRIMARY).map(|f| f.display_value().to_string());
        assert_eq!(colours.as_deref(), Some("uncalibrated"), "{name}");
    }
}

#[test]
fn impossible_values_are_rejected() {
    let folder = Folder::empty();
    let map = RadianceMap { pixels: Plane::filled(65_501, 1, [1.0; 3]), primaries: Primaries::SRGB };
    written(&folder, "wide.exr", &map);
    let run = folder.line("tonemap wide.exr -o wide.jpg");
    assert!(run.code == 1 && run.stderr.contains("wide.jpg") && run.stderr.contains("65500"), "{run:?}");
    assert!(run.stderr.contains(".png"), "a remedy: {run:?}");
    for quality in ["0", "101"] {
        let run = folder.line(&format!("tonemap wide.exr -o wide.jpg --jpeg-quality {quality}"));
        assert!(run.code == 2 && run.stderr.contains("--jpeg-quality"), "{run:?}");
    }
    assert_eq!(folder.listing().len(), 1, "nothing is left behind");
}
