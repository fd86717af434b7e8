//! Overlap of two frames of a hand-held bracket.
//!
//! In: a coarse image of each frame. Out: the histograms of the overlapping parts under the best shift. Cost: sums of
//! absolute differences of ranks over coarse images, as in a pyramid search.
//!
//! The parts outside the overlap may be a tenth of an image. Where they are bright, they change the ranks of all other
//! points. Ranks of pixel values do not depend on the exposure, so the best shift is the one with the smallest
//! difference between the ranks of both frames. (The bitmaps of Ward 2003 are ranks compared with one half.) All
//! clipped points of a frame have the same rank, and so have all its black points. So the points of the other frame at
//! these ranks are given equal ranks as well. Points are sampled and not averaged, because the mean of several pixel
//! values is not the pixel value of their mean radiance.

/// Maximum number of points along the longer side of a [`View`].
const LENGTH: usize = 384;
/// Maximum number of points along the longer side of the coarsest image of the search. In this image, shifts of up to a
/// sixth of the longer side are tried.
const COARSEST: usize = 24;
/// Lowest pixel value that is not black, and highest pixel value that is not clipped.
const SHOWN: (u8, u8) = (2, 250);

/// A subsampled green channel, at 8 bits.
#[derive(Debug, Clone)]
pub(super) struct View {
    width: usize,
    codes: Vec<u8>,
}

impl View {
    /// Samples an image of `width` x `height` pixels; `code` returns the pixel value at a row and a column.
    pub(super) fn of(width: usize, height: usize, code: impl Fn(usize, usize) -> u8) -> Self {
        let stride = width.max(height).div_ceil(LENGTH).max(1);
        // At least one row or column is sampled, even where the image is narrower than the stride.
        let middles = |length: usize| ((stride / 2).min(length / 2)..length).step_by(stride);
        let codes =
            middles(height).flat_map(|y| middles(width).map(move |x| (y, x))).map(|(y, x)| code(y, x)).collect();
        View { width: middles(width).count(), codes }
    }

    fn height(&self) -> usize {
        self.codes.len() / self.width.max(1)
    }

    fn counts(&self, rows: std::ops::Range<usize>, columns: std::ops::Range<usize>) -> [u64; 256] {
        let mut counts = [0; 256];
        for y in rows {
            let row = &self.codes[y * self.width..][columns.clone()];
            row.iter().for_each(|&code| counts[usize::from(code)] += 1);
        }
        counts
    }

    /// Returns the share of the points that are not clipped, and the share that are black.
    fn ends(&self) -> (f32, f32) {
        let share = |is: &dyn Fn(u8) -> bool| {
            self.codes.iter().filter(|&&code| is(code)).count() as f32 / self.codes.len().max(1) as f32
        };
        (share(&|code| code <= SHOWN.1), share(&|code| code < SHOWN.0))
    }

    /// Returns the rank of each point: the share of darker points plus half the share of equal points. All ranks below
    /// `black` become equal, and so do all ranks above `white`.
    fn ranks(&self, (white, black): (f32, f32)) -> Ranks {
        let counts = self.counts(0..self.height(), 0..self.width);
        let mut below = 0;
        let ranks = counts.map(|count| {
            below += count;
            let rank = ((2 * below - count) as f64 / (2 * self.codes.len()) as f64) as f32;
            if rank > white {
                0.5 * (1.0 + white)
            } else if rank < black {
                0.5 * black
            } else {
                rank
            }
        });
        Ranks { width: self.width, values: self.codes.iter().map(|&code| ranks[usize::from(code)]).collect() }
    }
}

/// Returns the histograms of the parts of `a` and `b` that overlap; `None` where the shift between them is 0, or their
/// sizes differ.
pub(super) fn overlap(a: &View, b: &View) -> Option<[[u64; 256]; 2]> {
    if (a.width, a.codes.len()) != (b.width, b.codes.len()) {
        return None;
    }
    let (right, down) = shift(a, b);
    let (xs, ys) = (both(a.width, right), both(a.height(), down));
    ((right, down) != (0, 0)).then(|| [a.counts(ys.0, xs.0), b.counts(ys.1, xs.1)])
}

/// Two rows of `length` points overlap: point `i` of the second row is at point `i + by` of the first row. Returns the
/// range of overlapping points in the first row, and the range in the second row.
fn both(length: usize, by: isize) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
    let (more, less) = (by.max(0) as usize, (-by).max(0) as usize);
    (more.min(length)..length - less.min(length), less.min(length)..length - more.min(length))
}

/// Finds the shift between `a` and `b` as (right, down), in points: the position of a point in `a` minus its position
/// in `b`. The shift is a multiple of 2.
fn shift(a: &View, b: &View) -> (isize, isize) {
    let (of_a, of_b) = (a.ends(), b.ends());
    let ends = (of_a.0.min(of_b.0), of_a.1.max(of_b.1));
    let (mut finer_a, mut finer_b) = (a.ranks(ends).halved(), b.ranks(ends).halved());
    let mut levels = Vec::new();
    while finer_a.length() > COARSEST {
        let coarser = (finer_a.halved(), finer_b.halved());
        levels.push((finer_a, finer_b));
        (finer_a, finer_b) = coarser;
    }
    let farthest = (finer_a.length() / 6).max(1) as isize;
    let mut found = nearest(&finer_a, &finer_b, (0, 0), farthest);
    for (a, b) in levels.iter().rev() {
        found = nearest(a, b, (2 * found.0, 2 * found.1), 1);
    }
    (2 * found.0, 2 * found.1)
}

/// Finds the shift with the smallest mean rank difference, among those that differ from `start` by at most `farthest`
/// along each axis and leave an overlap of at least half of the points. Of shifts with equal differences, returns the
/// shortest.
fn nearest(a: &Ranks, b: &Ranks, start: (isize, isize), farthest: isize) -> (isize, isize) {
    let mut best = (f64::INFINITY, 0, start);
    for down in start.1 - farthest..=start.1 + farthest {
        for right in start.0 - farthest..=start.0 + farthest {
            let (xs, ys) = (both(a.width, right), both(a.height(), down));
            let area = xs.0.len() * ys.0.len();
            if 2 * area < a.values.len() {
                continue;
            }
            let mut sum = 0.0;
            for (i, j) in ys.0.zip(ys.1) {
                let (row, other) = (&a.values[i * a.width..][xs.0.clone()], &b.values[j * b.width..][xs.1.clone()]);
                sum += row.iter().zip(other).map(|(x, y)| f64::from((x - y).abs())).sum::<f64>();
            }
            let key = (sum / area as f64, right * right + down * down);
            if key.0 < best.0 || (key.0 == best.0 && key.1 < best.1) {
                best = (key.0, key.1, (right, down));
            }
        }
    }
    best.2
}

/// Ranks of points, 0 to 1.
struct Ranks {
    width: usize,
    values: Vec<f32>,
}

impl Ranks {
    fn height(&self) -> usize {
        self.values.len() / self.width.max(1)
    }

    fn length(&self) -> usize {
        self.width.max(self.height())
    }

    /// Halves the size by averaging 2 x 2 ranks. The last row or column is dropped if their number is odd, unless it is
    /// the only one.
    fn halved(&self) -> Ranks {
        let (width, height) = ((self.width / 2).max(1), (self.height() / 2).max(1));
        let at = |y: usize, x: usize| self.values[y.min(self.height() - 1) * self.width + x.min(self.width - 1)];
        let mean = |y: usize, x: usize| {
            (at(2 * y, 2 * x) + at(2 * y, 2 * x + 1) + at(2 * y + 1, 2 * x) + at(2 * y + 1, 2 * x + 1)) / 4.0
        };
        Ranks {
            width,
            values: (0..height).flat_map(|y| (0..width).map(move |x| (y, x))).map(|(y, x)| mean(y, x)).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a view of a scene that does not repeat itself. The view begins at `column` and `row` of the scene, and
    /// its brightness is multiplied by `brighter`.
    fn view(column: usize, row: usize, brighter: f64) -> View {
        View::of(300, 200, |y, x| {
            let (x, y) = ((x + column) as f64, (y + row) as f64);
            let light = 60.0 + 30.0 * (x / 31.0 + y / 83.0).sin() + 25.0 * (y / 37.0 - (x / 47.0).cos()).cos();
            (light * brighter).min(255.0) as u8
        })
    }

    #[test]
    fn frames_that_are_shifted_overlap_where_both_show_the_same() {
        let shared = overlap(&view(40, 40, 1.0), &view(58, 30, 1.0)).expect("a shift");
        assert_eq!(shared[0], shared[1]);
        assert_eq!(shared[0].iter().sum::<u64>(), (300 - 18) * (200 - 10));
        let (right, down) = shift(&view(40, 40, 1.0), &view(30, 60, 1.6));
        assert!((right + 10).abs() <= 2 && (down - 20).abs() <= 2, "{right}, {down}");
    }

    #[test]
    fn nearly_clipped_frame_is_aligned_by_its_unclipped_part() {
        // A sky that is brighter on the left, above a hill that rises to the right.
        let view = |column: usize, row: usize, brighter: f64| {
            View::of(300, 200, |y, x| {
                let (x, y) = ((x + column) as f64, (y + row) as f64);
                let hill = 210.0 - 0.15 * x + 8.0 * (x / 17.0).sin();
                let light =
                    if y > hill { 12.0 + 4.0 * (x / 9.0).sin() } else { 170.0 - 0.2 * x + 6.0 * (y / 11.0).cos() };
                (light * brighter).min(255.0) as u8
            })
        };
        let (right, down) = shift(&view(40, 40, 1.0), &view(48, 34, 4.0));
        assert!((right - 8).abs() <= 2 && (down + 6).abs() <= 2, "{right}, {down}");
    }

    #[test]
    fn frames_that_are_not_shifted_or_not_of_one_size_have_no_overlap_to_look_at() {
        assert_eq!(overlap(&view(40, 40, 1.0), &view(40, 40, 2.5)), None);
        assert_eq!(overlap(&view(40, 40, 1.0), &View::of(200, 300, |_, _| 0)), None);
        assert_eq!(overlap(&View::of(1, 1, |_, _| 7), &View::of(1, 1, |_, _| 9)), None);
        // A strip of nearly the largest width that a JPEG can have (65,535 pixels).
        let strip = || View::of(65_500, 4, |_, x| (x / 300) as u8);
        assert_eq!((strip().height(), overlap(&strip(), &strip())), (1, None));
    }
}
