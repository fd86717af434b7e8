//! Where a picture is cut into dark and bright: the threshold, the zone about it that does not count, and both matched between exposures.
//!
//! In: grey planes. Out: [`Histogram`], [`Percentile`], [`Zone`]. Cost: a count of at most about a million pixels. Source: Ward 2003,
//! section 2 (median, 17th and 83rd percentile; exclusion of 4 grey levels). That both frames are cut at the same radiance, as the ranks
//! of their pixels tell, is ours: a zone of 4 levels is some stops in a dark frame and a fraction of one in a bright one, the median
//! itself goes with what is in the picture, and where the picture is smooth either would move its contours.

use crate::align::bitmap::Zone;
use crate::align::lay::Motion;
use crate::plane::Plane;
use std::ops::RangeInclusive;

/// The percentile of the grey levels that is the threshold: the median, or where that is too extreme another (Ward: the 17th or 83rd).
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
pub struct Percentile(u8);

impl Percentile {
    /// The median.
    pub const MEDIAN: Percentile = Percentile(50);

    /// The one that `percent` of the pixels do not exceed, 1..=99.
    pub const fn new(percent: u8) -> Self {
        Percentile(match percent {
            0 => 1,
            1..=99 => percent,
            _ => 99,
        })
    }

    /// The percent, 1..=99.
    pub fn percent(self) -> u8 {
        self.0
    }

    /// Those that may part two frames in one of which the median is black or burnt out.
    fn others() -> impl Iterator<Item = Percentile> {
        (1..=19).map(|i| Percentile(5 * i))
    }
}

/// How many pixels have each grey level.
#[derive(Debug, Clone)]
pub struct Histogram([u64; 256]);

impl Histogram {
    /// The histogram of `plane`; of a large one that of every so many rows, about `COUNTED` pixels.
    pub fn of(plane: &Plane<u8>) -> Self {
        let mut counts = Counts::default();
        counted_rows((plane.width(), plane.height())).for_each(|y| counts.add(plane.row(y)));
        counts.sum()
    }

    /// The same of a picture of `size` that is not there: `fill` computes a row.
    pub fn of_rows((width, height): (usize, usize), fill: impl Fn(usize, &mut [u8])) -> Self {
        let (mut counts, mut row) = (Counts::default(), vec![0; width]);
        for y in counted_rows((width, height)) {
            fill(y, &mut row);
            counts.add(&row);
        }
        counts.sum()
    }

    fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// The least level that at least `percentile` of the pixels do not exceed.
    pub fn level(&self, percentile: Percentile) -> u8 {
        let wanted = (self.total() * u64::from(percentile.0)).div_ceil(100).max(1);
        let mut below = 0;
        for (v, n) in self.0.iter().enumerate() {
            below += n;
            if below >= wanted {
                return v as u8;
            }
        }
        u8::MAX
    }

    /// The share of the pixels below `level`, which may be 256.
    fn share_below(&self, level: usize) -> f64 {
        self.0[..level].iter().sum::<u64>() as f64 / self.total().max(1) as f64
    }

    /// The share of the pixels at `levels`.
    pub fn share(&self, levels: RangeInclusive<u8>) -> f64 {
        levels.map(|level| self.0[usize::from(level)]).sum::<u64>() as f64 / self.total().max(1) as f64
    }

    /// The level, up to 256, below which the share is nearest to `share`; the lowest of several.
    fn level_of_share(&self, share: f64) -> usize {
        let wanted = share * self.total() as f64;
        let mut below = 0u64;
        let mut best = (wanted, 0);
        for (v, n) in self.0.iter().enumerate() {
            below += n;
            let off = (below as f64 - wanted).abs();
            if off < best.0 {
                best = (off, v + 1);
            }
        }
        best.1
    }

    /// Of the pixels that count at this zone, the share on the side that has fewer: 0 where the bitmap is blank.
    fn balance(&self, zone: &Zone) -> f64 {
        self.share_below(zone.low.into()).min(1.0 - self.share_below(usize::from(zone.high) + 1))
    }
}

/// The rows of a picture of this size that are counted.
fn counted_rows((width, height): (usize, usize)) -> impl Iterator<Item = usize> {
    (0..height).step_by((width * height / COUNTED).max(1))
}

/// Four tables, so that equal neighbours do not wait for each other.
struct Counts([[u32; 256]; 4]);

impl Default for Counts {
    fn default() -> Self {
        Counts([[0; 256]; 4])
    }
}

impl Counts {
    fn add(&mut self, row: &[u8]) {
        let (fours, rest) = row.as_chunks::<4>();
        for four in fours {
            for (table, &v) in self.0.iter_mut().zip(four) {
                table[usize::from(v)] += 1;
            }
        }
        for &v in rest {
            self.0[0][usize::from(v)] += 1;
        }
    }

    fn sum(&self) -> Histogram {
        Histogram(std::array::from_fn(|v| self.0.iter().map(|c| u64::from(c[v])).sum()))
    }
}

/// Pixels that are counted for a histogram: a percentile of so many is off by less than a tenth of a percent.
const COUNTED: usize = 1 << 20;

/// A bitmap with a smaller share of its pixels on one side says too little: half of what Ward's outer percentiles can give.
const LEAST_BALANCE: f64 = 0.085;

/// The percentile at which both frames have something to say: the median unless it is too extreme in either, else of every fifth the one
/// that parts both best.
pub fn common_percentile(a: &Histogram, b: &Histogram, exclusion: u8) -> Percentile {
    let balance = |p| {
        let (zone_a, zone_b) = matched_zones(a, b, p, exclusion);
        a.balance(&zone_a).min(b.balance(&zone_b))
    };
    if balance(Percentile::MEDIAN) >= LEAST_BALANCE {
        return Percentile::MEDIAN;
    }
    let better = |best: Percentile, p| if balance(p) > balance(best) { p } else { best };
    Percentile::others().fold(Percentile::MEDIAN, better)
}

/// The percentile at which one frame by itself has something to say.
pub fn own_percentile(histogram: &Histogram, exclusion: u8) -> Percentile {
    common_percentile(histogram, histogram, exclusion)
}

/// The zones of two frames of which the wider, `exclusion` levels to either side of the percentile, gives the ranks, and the other the
/// levels that have these ranks.
pub fn matched_zones(a: &Histogram, b: &Histogram, percentile: Percentile, exclusion: u8) -> (Zone, Zone) {
    let own = |h: &Histogram| Zone::about(h.level(percentile), exclusion);
    let ranks = |h: &Histogram, z: &Zone| {
        [usize::from(z.low), usize::from(z.threshold) + 1, usize::from(z.high) + 1].map(|v| h.share_below(v))
    };
    let matched = |h: &Histogram, ranks: [f64; 3]| {
        let [low, threshold, high] = ranks.map(|r| h.level_of_share(r));
        let up_to = |v: usize| v.saturating_sub(1) as u8;
        Zone { low: low.min(255) as u8, threshold: up_to(threshold), high: up_to(high) }
    };
    let (zone_a, zone_b) = (own(a), own(b));
    let (ranks_a, ranks_b) = (ranks(a, &zone_a), ranks(b, &zone_b));
    if ranks_a[2] - ranks_a[0] >= ranks_b[2] - ranks_b[0] {
        (zone_a, matched(b, ranks_a))
    } else {
        (matched(a, ranks_b), zone_b)
    }
}

/// The histograms of what both frames show when the frame lies on the reference by `motion`: of pixels that are pairs, about
/// `PAIRED` of them.
pub fn common_histograms(reference: &Plane<u8>, frame: &Plane<u8>, motion: &Motion) -> (Histogram, Histogram) {
    let (width, height) = (reference.width(), reference.height());
    let step = ((width * height) as f64 / PAIRED as f64).sqrt().max(1.0) as usize;
    let (cx, cy) = ((width - 1) as f64 / 2.0, (height - 1) as f64 / 2.0);
    let (s, c) = (libm::sin(motion.angle), libm::cos(motion.angle));
    let (mut a, mut b) = ([0u64; 256], [0u64; 256]);
    for y in (step / 2..height).step_by(step) {
        let py = y as f64 - cy;
        let row = reference.row(y);
        for x in (step / 2..width).step_by(step) {
            let px = x as f64 - cx;
            let (u, v) = (cx + motion.dx + c * px - s * py + 0.5, cy + motion.dy + s * px + c * py + 0.5);
            if u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64 {
                a[usize::from(row[x])] += 1;
                b[usize::from(frame.at(u as usize, v as usize))] += 1;
            }
        }
    }
    (Histogram(a), Histogram(b))
}

/// Pairs of pixels that are compared: their ranks differ by what moved, and by noise, not by chance.
const PAIRED: usize = 1 << 15;

#[cfg(test)]
mod tests {
    use super::*;

    const SEVEN: [Percentile; 7] = [
        Percentile::new(5),
        Percentile::new(17),
        Percentile::new(33),
        Percentile::MEDIAN,
        Percentile::new(67),
        Percentile::new(83),
        Percentile::new(95),
    ];

    fn plane(width: usize, height: usize, value: impl Fn(usize, usize) -> u8 + Sync) -> Plane<u8> {
        Plane::from_rows(width, height, |y, row| row.iter_mut().enumerate().for_each(|(x, v)| *v = value(x, y)))
    }

    #[test]
    fn zones_of_two_exposures_are_the_same_pixels() {
        // Half as bright: 2 v and 2 v + 1 both become v.
        let bright = plane(256, 40, |x, _| x as u8);
        let dark = plane(256, 40, |x, _| x as u8 / 2);
        let (a, b) = (Histogram::of(&bright), Histogram::of(&dark));
        for percentile in SEVEN {
            let (zone_bright, zone_dark) = matched_zones(&a, &b, percentile, 4);
            let cut = |p: &Plane<u8>, z: &Zone| crate::align::bitmap::ThresholdBitmaps::new(p, z);
            assert_eq!(cut(&bright, &zone_bright), cut(&dark, &zone_dark), "{percentile:?}");
            let level = b.level(percentile);
            // The dark frame's zone is the wider one, and as it would be by itself.
            assert_eq!(zone_dark, Zone::about(level, 4), "{percentile:?}");
            assert_eq!(usize::from(zone_bright.low), 2 * usize::from(zone_dark.low));
            assert_eq!(matched_zones(&b, &a, percentile, 4), (zone_dark, zone_bright));
        }
    }

    #[test]
    fn at_night_the_lamps_are_the_threshold() {
        let night =
            Histogram::of(&plane(100, 100, |x, y| if x < 93 { (y % 3) as u8 } else { 100 + 20 * (x as u8 - 93) }));
        assert_eq!(own_percentile(&night, 4), Percentile::new(95));
        let snow =
            Histogram::of(&plane(100, 100, |x, y| if x < 93 { 255 - (y % 3) as u8 } else { 20 * (x as u8 - 93) }));
        assert_eq!(own_percentile(&snow, 4), Percentile::new(5));
    }

    #[test]
    fn a_large_plane_is_counted_by_some_of_its_rows() {
        let picture = plane(2048, 1600, |x, y| ((x + 31 * y) % 251) as u8);
        let large = Histogram::of(&picture);
        assert_eq!(Histogram::of_rows((2048, 1600), |y, row| row.copy_from_slice(picture.row(y))).0, large.0);
        assert_eq!(large.total(), 2048 * 1600_u64.div_ceil(3));
        for percentile in SEVEN {
            let expected = 251.0 * f64::from(percentile.0) / 100.0;
            assert!((f64::from(large.level(percentile)) - expected).abs() <= 1.0, "{percentile:?}");
        }
    }

    #[test]
    fn common_histograms_are_of_what_both_frames_show() {
        // The frame shows the reference 50 px farther left, and at its right something bright that the reference does not.
        let reference = plane(200, 120, |x, _| x as u8);
        let frame = plane(200, 120, |x, _| if x < 150 { x as u8 + 50 } else { 255 });
        let motion = Motion { dx: -50.0, ..Motion::default() };
        let (a, b) = common_histograms(&reference, &frame, &motion);
        assert_eq!(a.0, b.0);
        assert_eq!((a.total(), a.share_below(50)), (150 * 120, 0.0));
        // Turned by a half turn about the centre every pixel meets its opposite.
        let half_turn = Motion { angle: std::f64::consts::PI, ..Motion::default() };
        let turned = plane(200, 120, |x, _| 199 - x as u8);
        let (a, b) = common_histograms(&reference, &turned, &half_turn);
        assert_eq!((a.total(), a.0), (200 * 120, b.0));
    }
}
