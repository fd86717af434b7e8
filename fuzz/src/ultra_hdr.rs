//! A strict reader of JPEG files with a gain map: anything unexpected is an error of the writer.
//!
//! In: a file. Out: the sizes of its two pictures, or a panic. Source: see `hdralign::write::jpeg`; the checks are
//! those of `tests/cli/ultra_hdr.rs`.

/// Segments of a JPEG up to its scan: marker codes, offsets, contents.
struct Image<'a> {
    segments: Vec<(u8, usize, &'a [u8])>,
    bytes: &'a [u8],
}

const XMP: &[u8] = b"http://ns.adobe.com/xap/1.0/\0";
const ISO: &[u8] = b"urn:iso:std:iso:ts:21496:-1\0";

impl<'a> Image<'a> {
    /// Parses the JPEG at the start of `file`.
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

    /// Returns offset and content of the only segment `code` that begins with `name`, without the name.
    fn find(&self, code: u8, name: &[u8]) -> Option<(usize, &'a [u8])> {
        let all: Vec<_> = self.segments.iter().filter(|s| s.0 == code && s.2.starts_with(name)).collect();
        assert!(all.len() < 2, "one {}", String::from_utf8_lossy(name));
        all.first().map(|s| (s.1 + name.len(), &s.2[name.len()..]))
    }

    fn xmp(&self) -> &'a str {
        std::str::from_utf8(self.find(0xE1, XMP).expect("XMP").1).expect("UTF-8")
    }

    fn size(&self) -> (u32, u32) {
        let decoded = image::load_from_memory(self.bytes).expect("a JPEG");
        (decoded.width(), decoded.height())
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
    u32::from_be_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]) as usize
}

/// Checks that `file` is a JPEG without a gain map. Returns its size.
///
/// # Panics
/// If it is not.
pub fn check_plain(file: &[u8]) -> (u32, u32) {
    let image = Image::parse(file);
    assert_eq!(image.bytes.len(), file.len());
    assert!(image.find(0xE2, b"MPF\0").is_none() && image.find(0xE1, XMP).is_none());
    image.size()
}

/// Checks that `file` is a JPEG with a gain map. Returns the sizes of the picture and of the map.
///
/// # Panics
/// If it is not.
pub fn check(file: &[u8]) -> [(u32, u32); 2] {
    let first = Image::parse(file);
    let second = Image::parse(&file[first.bytes.len()..]);
    assert_eq!(first.bytes.len() + second.bytes.len(), file.len(), "nothing between and behind");

    // GContainer.
    let xmp = first.xmp();
    assert_eq!(attribute(xmp, "hdrgm:Version"), "1.0");
    assert_eq!(number(xmp, "Item:Length") as usize, second.bytes.len());
    assert_eq!(xmp.matches("<Container:Item ").count(), 2);

    // MPF: offsets are relative to the byte order mark; the first is 0.
    let (mark, mpf) = first.find(0xE2, b"MPF\0").expect("an index");
    assert_eq!(mpf[..10], *b"MM\0*\0\0\0\x08\0\x03");
    let entries = &mpf[be32(&mpf[42..])..];
    assert_eq!((be32(entries), be32(&entries[4..]), be32(&entries[8..])), (0x30000, first.bytes.len(), 0));
    assert_eq!((be32(&entries[16..]), be32(&entries[20..])), (0, second.bytes.len()));
    assert_eq!(mark + be32(&entries[24..]), first.bytes.len());

    // ISO 21496-1: the same parameters as in the XMP.
    assert_eq!(first.find(0xE2, ISO).expect("a version").1, [0; 4]);
    let iso = second.find(0xE2, ISO).expect("numbers").1;
    assert_eq!((&iso[..5], iso.len()), (&[0, 0, 0, 0, 0x40][..], 5 + 7 * 8));
    let fractions: Vec<f64> =
        iso[5..].chunks(8).map(|f| f64::from(be32(f) as u32 as i32) / be32(&f[4..]) as f64).collect();
    let xmp = second.xmp();
    let fields = ["HDRCapacityMin", "HDRCapacityMax", "GainMapMin", "GainMapMax", "Gamma", "OffsetSDR", "OffsetHDR"];
    let numbers = fields.map(|name| number(xmp, &format!("hdrgm:{name}")));
    assert_eq!(fractions, numbers);
    let [capacity_min, capacity_max, least, most, gamma, offset, offset_hdr] = numbers;
    assert!(numbers.iter().all(|v| v.is_finite()));
    assert!(capacity_min >= 0.0 && capacity_max > capacity_min && most > least && (0.0..0.1).contains(&offset));
    assert!((gamma, offset) == (1.0, offset_hdr));
    [first.size(), second.size()]
}
