//! Pictures for drawings: a frame's grey at the size it is drawn, bright enough to see, and small PNG files in memory.
//!
//! In: grey planes of any size. Out: [`Photograph`]s, PNG bytes. Cost: a pass over the plane and the deflation of what is left.

use super::drawing::{Area, Drawing};
use crate::align::bitmaps::Bitmap;
use crate::plane::Plane;
use crate::write::Metadata;
use png::{BitDepth, ColorType, Compression, Encoder, EncodingError};

/// A plane averaged over areas to fit into `most` pixels across and down; one that fits already is as it was.
pub(super) fn reduce(plane: &Plane<u8>, most: (usize, usize)) -> Plane<u8> {
    let (w, h) = (plane.width(), plane.height());
    let share = (most.0 as f64 / w as f64).min(most.1 as f64 / h as f64);
    if share >= 1.0 {
        return plane.clone();
    }
    let size = |n: usize| ((n as f64 * share).round() as usize).max(1);
    let (width, height) = (size(w), size(h));
    let (step_x, step_y) = (w as f64 / width as f64, h as f64 / height as f64);
    Plane::from_rows(width, height, |y, row| {
        let rows = parts(y, step_y, h);
        for (x, v) in row.iter_mut().enumerate() {
            let columns = parts(x, step_x, w);
            let mut sum = 0.0;
            for &(j, wy) in &rows {
                let line = plane.row(j);
                sum += wy * columns.iter().map(|&(i, wx)| wx * f64::from(line[i])).sum::<f64>();
            }
            *v = (sum / (step_x * step_y)).round() as u8;
        }
    })
}

/// The pixels that cell `i` of `step` pixels covers, of `n`, and how much of each.
fn parts(i: usize, step: f64, n: usize) -> Vec<(usize, f64)> {
    let (from, to) = (i as f64 * step, (i + 1) as f64 * step);
    let last = (to.ceil() as usize).min(n);
    (from as usize..last).map(|k| (k, (to.min(k as f64 + 1.0) - from.max(k as f64)).max(0.0))).collect()
}

/// A frame as it is drawn: grey, within the range in which coloured marks stand out.
pub(super) struct Photograph {
    /// The grey levels as shown.
    pub(super) grey: Plane<u8>,
    /// Width of the whole frame, in pixels.
    full: (usize, usize),
    /// How many pixels of the page one of `grey` takes.
    magnified: f64,
    /// Whether it is shown brighter than it is.
    pub(super) brightened: bool,
}

/// Grey levels that a photograph is shown in: marks in full colours are seen on all of them.
const DARKEST: f64 = 12.0;
const BRIGHTEST: f64 = 184.0;
/// The median is shown at this share of the range at least.
const LEAST_MEDIAN: f64 = 0.25;

impl Photograph {
    /// `frame` in no more than `most` pixels; a small one is magnified by a whole number.
    pub(super) fn new(frame: &Plane<u8>, most: (usize, usize)) -> Self {
        let small = reduce(frame, most);
        let fits = (most.0 / small.width()).min(most.1 / small.height()).max(1);
        let (curve, brightened) = shown(&small);
        let grey = Plane::from_rows(small.width(), small.height(), |y, row| {
            for (v, g) in row.iter_mut().zip(small.row(y)) {
                *v = curve[usize::from(*g)];
            }
        });
        Photograph { grey, full: (frame.width(), frame.height()), magnified: fits as f64, brightened }
    }

    /// Width and height on the page, in pixels.
    pub(super) fn size(&self) -> (f64, f64) {
        (self.grey.width() as f64 * self.magnified, self.grey.height() as f64 * self.magnified)
    }

    /// How many pixels of the page one of the frame takes.
    pub(super) fn scale(&self) -> f64 {
        self.size().0 / self.full.0 as f64
    }

    /// Where the frame's pixel (x, y) lies on a page on which the photograph's upper left corner is at `corner`.
    pub(super) fn place(&self, corner: (f64, f64), x: f64, y: f64) -> (f64, f64) {
        let (w, h) = self.size();
        (corner.0 + (x + 0.5) * w / self.full.0 as f64, corner.1 + (y + 0.5) * h / self.full.1 as f64)
    }

    /// Puts it on `page`, and gives the area that it takes.
    pub(super) fn put(&self, page: &mut Drawing, corner: (f64, f64)) -> Result<Area, String> {
        let (width, height) = self.size();
        let area = Area { x: corner.0, y: corner.1, width, height };
        page.picture(area, &png_grey(&self.grey)?);
        Ok(area)
    }
}

/// What each grey level is shown as: white where the frame's brightest few pixels in a thousand begin, its median not too dark to see, and in
/// a dark frame the camera's black level black.
fn shown(grey: &Plane<u8>) -> ([u8; 256], bool) {
    let mut counts = [0usize; 256];
    for &v in grey.as_slice() {
        counts[usize::from(v)] += 1;
    }
    let total = grey.as_slice().len();
    let quantile = |share: f64| {
        let mut below = 0;
        let found = counts.iter().position(|n| {
            below += n;
            below as f64 >= share * total as f64
        });
        found.unwrap_or(255) as f64
    };
    let white = quantile(0.998).max(4.0);
    let black = if white < 128.0 { quantile(0.01).min(white - 2.0) } else { 0.0 };
    let median = ((quantile(0.5) - black) / (white - black)).clamp(0.02, 1.0);
    let power = (libm::log(LEAST_MEDIAN) / libm::log(median)).clamp(0.45, 1.0);
    let power = if median >= LEAST_MEDIAN { 1.0 } else { power };
    let level = |v: usize| {
        let share = libm::pow(((v as f64 - black) / (white - black)).clamp(0.0, 1.0), power);
        (DARKEST + (BRIGHTEST - DARKEST) * share).round() as u8
    };
    (std::array::from_fn(level), white < 200.0 || power < 1.0)
}

/// `plane` as a PNG file.
pub(super) fn png_grey(plane: &Plane<u8>) -> Result<Vec<u8>, String> {
    png((plane.width(), plane.height()), ColorType::Grayscale, BitDepth::Eight, plane.as_slice())
}

/// `plane` as a PNG file.
pub(super) fn png_rgb(plane: &Plane<[u8; 3]>) -> Result<Vec<u8>, String> {
    png((plane.width(), plane.height()), ColorType::Rgb, BitDepth::Eight, plane.as_slice().as_flattened())
}

/// `bitmap` as a PNG file with one bit a pixel: white where it is set.
pub(super) fn png_bitmap(bitmap: &Bitmap) -> Result<Vec<u8>, String> {
    let (width, height) = (bitmap.width(), bitmap.height());
    let mut packed = vec![0u8; width.div_ceil(8) * height];
    for (y, row) in packed.chunks_exact_mut(width.div_ceil(8)).enumerate() {
        for x in (0..width).filter(|&x| bitmap.get(x, y)) {
            row[x / 8] |= 0x80 >> (x % 8);
        }
    }
    png((width, height), ColorType::Grayscale, BitDepth::One, &packed)
}

fn png(size: (usize, usize), colour: ColorType, depth: BitDepth, data: &[u8]) -> Result<Vec<u8>, String> {
    let side = |n: usize| u32::try_from(n).map_err(|e| e.to_string());
    let (width, height) = (side(size.0)?, side(size.1)?);
    let encode = || -> Result<Vec<u8>, EncodingError> {
        let mut bytes = Vec::new();
        let mut encoder = Encoder::new(&mut bytes, width, height);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        encoder.set_compression(Compression::Fast);
        // So that it is not taken for a photograph.
        encoder.add_text_chunk("Software".into(), Metadata::default().software)?;
        let mut writer = encoder.write_header()?;
        writer.write_image_data(data)?;
        writer.finish()?;
        Ok(bytes)
    };
    encode().map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::bitmaps::{ThresholdBitmaps, Zone};

    #[test]
    fn areas_keep_their_mean() {
        let plane = Plane::from_rows(30, 20, |y, row| (0..30).for_each(|x| row[x] = (7 * x + 3 * y) as u8));
        let small = reduce(&plane, (11, 100));
        assert_eq!((small.width(), small.height()), (11, 7));
        let mean = |p: &Plane<u8>| p.as_slice().iter().map(|&v| f64::from(v)).sum::<f64>() / p.as_slice().len() as f64;
        // Each value is rounded by at most a half, by chance to either side.
        assert!((mean(&plane) - mean(&small)).abs() < 0.2);
        assert_eq!(reduce(&plane, (30, 20)), plane);
        // Linear pictures stay linear: the mean of a cell is the value at its centre, (x + 1/2) 30/11 - 1/2.
        let expected = 7.0 * (5.5 * 30.0 / 11.0 - 0.5) + 3.0 * (3.5 * 20.0 / 7.0 - 0.5);
        assert!((f64::from(small.at(5, 3)) - expected).abs() <= 0.51);
    }

    #[test]
    fn a_place_is_the_same_at_every_scale() {
        let frame = Plane::filled(400, 200, 90u8);
        let photograph = Photograph::new(&frame, (100, 100));
        assert_eq!((photograph.size(), photograph.scale()), ((100.0, 50.0), 0.25));
        assert_eq!(photograph.place((10.0, 20.0), 199.5, 99.5), (60.0, 45.0));
        let small = Photograph::new(&Plane::filled(30, 20, 90u8), (100, 100));
        assert_eq!(small.size(), (90.0, 60.0));
        assert_eq!(small.place((0.0, 0.0), 14.5, 9.5), (45.0, 30.0));
    }

    #[test]
    fn dark_frames_are_brightened_and_others_only_dimmed() {
        let ramp =
            |most: usize| Plane::from_rows(256, 4, |_, row| (0..256).for_each(|x| row[x] = (x * most / 255) as u8));
        let (dark, brightened) = shown(&ramp(20));
        assert!(brightened && dark[20] == BRIGHTEST as u8 && dark[10] > 60);
        let (light, brightened) = shown(&ramp(255));
        assert!(!brightened && light.windows(2).all(|w| w[0] <= w[1]));
    }

    #[test]
    fn bitmaps_are_packed_from_the_left() {
        let plane = Plane::from_rows(11, 3, |y, row| (0..11).for_each(|x| row[x] = u8::from((x + y) % 3 == 0)));
        let bytes = png_bitmap(&ThresholdBitmaps::new(&plane, &Zone::about(0, 0)).threshold).unwrap();
        let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut back = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut back).unwrap();
        assert!(back.iter().zip(plane.as_slice()).all(|(b, p)| *b == 255 * p));
    }
}
