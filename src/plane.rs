//! [`Plane`], the image buffer, and the bands of rows for parallel work.
//!
//! In: sizes and closures. Out: images with the same bytes on any number of threads. This is so because the bands
//! depend only on the height, each band is computed independently, and the results of the bands are collected or folded
//! in index order. Cost: the closures.

use rayon::prelude::*;
use std::ops::Range;

/// Number of rows per band, the unit of parallel work. Results depend on this number, so it is the same on every
/// machine.
pub const BAND_ROWS: usize = 64;

/// An image of `T`, row-major; x to the right, y down; (0, 0) is the centre of the top-left pixel.
#[derive(Debug, Clone, PartialEq)]
pub struct Plane<T> {
    width: usize,
    height: usize,
    data: Vec<T>,
}

impl<T> Plane<T> {
    /// Returns a plane with the values of `data`, which are in row-major order.
    ///
    /// # Panics
    /// If `data` does not have `width * height` values.
    pub fn from_vec(width: usize, height: usize, data: Vec<T>) -> Self {
        assert_eq!(data.len(), width * height, "a plane of {width}x{height} pixels needs one value for each of them");
        Plane { width, height, data }
    }

    /// Width in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// All values, in row-major order.
    pub fn as_slice(&self) -> &[T] {
        &self.data
    }

    /// All values, in row-major order.
    pub fn as_mut_slice(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// Converts the plane to its values, in row-major order.
    pub fn into_vec(self) -> Vec<T> {
        self.data
    }

    /// Row `y`.
    pub fn row(&self, y: usize) -> &[T] {
        &self.data[y * self.width..(y + 1) * self.width]
    }

    /// The values of several rows, in row-major order.
    pub fn rows(&self, rows: Range<usize>) -> &[T] {
        &self.data[rows.start * self.width..rows.end * self.width]
    }

    /// Row `y`.
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.data[y * self.width..(y + 1) * self.width]
    }
}

impl<T: image::Primitive> From<Plane<[T; 3]>> for image::ImageBuffer<image::Rgb<T>, Vec<T>>
where
    image::Rgb<T>: image::Pixel<Subpixel = T>,
{
    /// Converts to an image of the `image` crate: `Rgb32FImage` for radiance, `RgbImage` for 8-bit values.
    fn from(plane: Plane<[T; 3]>) -> Self {
        let (width, height) = (plane.width() as u32, plane.height() as u32);
        // Never fails: there are three values per pixel.
        image::ImageBuffer::from_raw(width, height, plane.into_vec().into_flattened()).unwrap_or_default()
    }
}

impl<T: Copy> Plane<T> {
    /// The value at column `x` of row `y`.
    pub fn at(&self, x: usize, y: usize) -> T {
        self.data[y * self.width + x]
    }
}

impl<T: Copy + Sync> Plane<T> {
    /// Returns the plane with `convert` applied to every value. The bands of rows are computed in parallel.
    pub fn map<U: Copy + Default + Send>(&self, convert: impl Fn(T) -> U + Sync) -> Plane<U> {
        Plane::from_rows(self.width, self.height, |y, row| {
            for (to, &from) in row.iter_mut().zip(self.row(y)) {
                *to = convert(from);
            }
        })
    }
}

impl<T: Clone> Plane<T> {
    /// A plane with `value` in all pixels.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Plane { width, height, data: vec![value; width * height] }
    }
}

impl<T: Copy + Default + Send> Plane<T> {
    /// Returns a plane whose rows are computed with `fill(y, row)`. The bands of rows are computed in parallel.
    pub fn from_rows(width: usize, height: usize, fill: impl Fn(usize, &mut [T]) + Sync) -> Self {
        let mut plane = Plane::filled(width, height, T::default());
        plane.fill_rows(fill);
        plane
    }

    /// Computes every row with `fill(y, row)`. The bands of rows are computed in parallel.
    pub fn fill_rows(&mut self, fill: impl Fn(usize, &mut [T]) + Sync) {
        let width = self.width;
        self.fill_bands(|rows, band| {
            for (y, row) in rows.zip(band.chunks_exact_mut(width)) {
                fill(y, row);
            }
        });
    }

    /// Computes every band with `fill(rows, values)`, in parallel.
    pub fn fill_bands(&mut self, fill: impl Fn(Range<usize>, &mut [T]) + Sync) {
        self.fill_bands_with(|| (), |(), rows, values| fill(rows, values));
    }

    /// Like [`fill_bands`](Self::fill_bands), but `fill` also gets a buffer, which `scratch` creates and several bands
    /// reuse.
    ///
    /// Results must not depend on the previous contents of the buffers.
    pub fn fill_bands_with<S>(
        &mut self,
        scratch: impl Fn() -> S + Sync + Send,
        fill: impl Fn(&mut S, Range<usize>, &mut [T]) + Sync,
    ) {
        if self.data.is_empty() {
            return;
        }
        let (width, height) = (self.width, self.height);
        self.data
            .par_chunks_mut(BAND_ROWS * width)
            .enumerate()
            .for_each_init(scratch, |scratch, (band, values)| fill(scratch, band_rows(band, height), values));
    }
}

/// Returns the rows of band `band` of an image with `height` rows; the last band may be smaller.
fn band_rows(band: usize, height: usize) -> Range<usize> {
    band * BAND_ROWS..((band + 1) * BAND_ROWS).min(height)
}

/// Calls `map` with the rows of every band, in parallel, and returns the results in the order of the bands.
pub fn map_bands<R: Send>(height: usize, map: impl Fn(Range<usize>) -> R + Sync) -> Vec<R> {
    (0..height.div_ceil(BAND_ROWS)).into_par_iter().map(|band| map(band_rows(band, height))).collect()
}

/// Returns the results of `map` for 0..`count`, in order; at most `at_once` are computed at a time.
///
/// The bound limits memory: a thread that waits for parallel work within an item may start another item, so without the
/// bound all items might be in progress at once, even on few threads.
pub fn map_at_once<R: Send>(count: usize, at_once: usize, map: impl Fn(usize) -> R + Sync) -> Vec<R> {
    let at_once = at_once.clamp(1, count.max(1));
    let group = |first| (first..count.min(first + at_once)).into_par_iter().map(&map).collect::<Vec<R>>();
    (0..count).step_by(at_once).flat_map(group).collect()
}

/// Calls `map` with the rows of every band, in parallel, and folds the results in the order of the bands, so that sums
/// of floats are the same on any machine.
pub fn fold_bands<R: Send, A>(
    height: usize,
    map: impl Fn(Range<usize>) -> R + Sync,
    start: A,
    fold: impl FnMut(A, R) -> A,
) -> A {
    map_bands(height, map).into_iter().fold(start, fold)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_cover_every_row_once() {
        for height in [1, 63, 64, 65, 200] {
            let rows: Vec<usize> = map_bands(height, |r| r.collect::<Vec<_>>()).concat();
            assert_eq!(rows, (0..height).collect::<Vec<_>>());
        }
    }

    #[test]
    fn items_are_mapped_in_order_and_no_more_at_once_than_allowed() {
        use std::sync::atomic::{AtomicUsize, Ordering};
        let (going, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let map = |i: usize| {
            most.fetch_max(1 + going.fetch_add(1, Ordering::SeqCst), Ordering::SeqCst);
            // A thread that waits for this sum may start another item.
            let sum: usize = (0..1000).into_par_iter().map(|k| k % 7).sum();
            going.fetch_sub(1, Ordering::SeqCst);
            sum * i
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(4).build().unwrap();
        for at_once in [0, 1, 3, 50, usize::MAX] {
            most.store(0, Ordering::SeqCst);
            let found = pool.install(|| map_at_once(10, at_once, map));
            assert_eq!(found, (0..10).map(|i| 2997 * i).collect::<Vec<_>>());
            assert!(most.load(Ordering::SeqCst) <= at_once.max(1));
        }
        assert!(map_at_once(0, 3, |i| i).is_empty());
    }

    #[test]
    fn rows_are_filled_in_place() {
        let plane = Plane::from_rows(3, 130, |y, row| {
            for (x, v) in row.iter_mut().enumerate() {
                *v = (10 * y + x) as u32;
            }
        });
        assert_eq!((plane.at(2, 129), plane.row(64)), (1292, &[640, 641, 642][..]));
    }

    #[test]
    fn a_sum_is_the_same_on_any_number_of_threads() {
        let value = |y: usize| 1.0 / (1.0 + y as f32);
        let sum = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| fold_bands(10_000, |r| r.map(value).sum::<f32>(), 0.0f32, |a, b| a + b))
        };
        assert_eq!(sum(1).to_bits(), sum(5).to_bits());
    }
}
