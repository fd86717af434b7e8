//! Thresholds and exclusion zones of bitmaps, matched between two exposures.
//!
//! In: histograms of grey values. Out: [`Percentile`], [`Zone`]. Cost: negligible compared with the histograms. Source:
//! Ward 2003, section 2 (median, 17th and 83rd percentile; exclusion of 4 grey values around the threshold).
//!
//! Unlike in Ward's method, the thresholds of both frames are at the same radiance. They are found by rank: at any
//! exposure, the pixels of a scene have the same order of grey values. Ward's method differs in two ways: its zone of 4
//! grey values spans some stops in a dark frame, but only a fraction of a stop in a bright frame; and its median
//! depends on the content of the frame. On smooth surfaces, both would displace the contours of one bitmap relative to
//! the other.

use crate::align::bitmaps::{Motion, Zone};
use crate::align::grey::{Histogram, Percentile};
use crate::plane::Plane;

/// Returns the share of pixels below `zone` or the share above it, whichever is smaller: 0 for a blank bitmap.
fn balance_at(histogram: &Histogram, zone: &Zone) -> f64 {
    histogram.share_below(zone.low.into()).min(1.0 - histogram.share_below(usize::from(zone.high) + 1))
}

/// A bitmap has enough structure if at least this share of the pixels is on each side of the zone. The value is half of
/// the 17 % of pixels that lie beyond Ward's 17th and 83rd percentile.
const LEAST_BALANCE: f64 = 0.085;

/// Returns the percentile at which the bitmaps of both frames have structure.
///
/// This is the median, if in both frames at least [`LEAST_BALANCE`] of the pixels are on each side of the median's
/// zone. Otherwise it is the multiple of five percent with the best balance.
pub fn common_percentile(a: &Histogram, b: &Histogram, exclusion: u8) -> Percentile {
    let balance = |p| {
        let (zone_a, zone_b) = matched_zones(a, b, p, exclusion);
        balance_at(a, &zone_a).min(balance_at(b, &zone_b))
    };
    if balance(Percentile::MEDIAN) >= LEAST_BALANCE {
        return Percentile::MEDIAN;
    }
    let better = |best: Percentile, p| if balance(p) > balance(best) { p } else { best };
    Percentile::others().fold(Percentile::MEDIAN, better)
}

/// Returns one zone for each of two frames. Each zone contains the same fraction of the pixels of its frame, at the
/// same ranks.
///
/// In each frame, the grey values up to `exclusion` away from the percentile contain a share of the pixels. The frame
/// in which this share is larger keeps these grey values as its zone. The zone of the other frame consists of the grey
/// values that its pixels have at the same ranks.
pub fn matched_zones(a: &Histogram, b: &Histogram, percentile: Percentile, exclusion: u8) -> (Zone, Zone) {
    let own = |h: &Histogram| Zone::about(h.value_at(percentile), exclusion);
    let ranks = |h: &Histogram, z: &Zone| {
        [usize::from(z.low), usize::from(z.threshold) + 1, usize::from(z.high) + 1].map(|v| h.share_below(v))
    };
    let matched = |h: &Histogram, ranks: [f64; 3]| {
        let [low, threshold, high] = ranks.map(|r| h.value_of_share(r));
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

/// Returns the histograms of two frames over the area that both show under `motion`, from about `PAIRED` pairs of
/// pixels.
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

/// Approximate number of pairs of pixels that are sampled for the histograms. With so many pairs, sampling changes the
/// ranks less than motion and noise do.
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
        // The second frame is half as bright: the values 2 v and 2 v + 1 of the first frame both become v.
        let bright = plane(256, 40, |x, _| x as u8);
        let dark = plane(256, 40, |x, _| x as u8 / 2);
        let (a, b) = (Histogram::of(&bright), Histogram::of(&dark));
        for percentile in SEVEN {
            let (zone_bright, zone_dark) = matched_zones(&a, &b, percentile, 4);
            let cut = |p: &Plane<u8>, z: &Zone| crate::align::bitmaps::bitmap::ThresholdBitmaps::new(p, z);
            assert_eq!(cut(&bright, &zone_bright), cut(&dark, &zone_dark), "{percentile:?}");
            let level = b.value_at(percentile);
            // In the dark frame, the values up to 4 away from the percentile contain the larger share of pixels. So
            // this frame keeps them as its zone.
            assert_eq!(zone_dark, Zone::about(level, 4), "{percentile:?}");
            assert_eq!(usize::from(zone_bright.low), 2 * usize::from(zone_dark.low));
            assert_eq!(matched_zones(&b, &a, percentile, 4), (zone_dark, zone_bright));
        }
    }

    #[test]
    fn at_night_the_lamps_are_the_threshold() {
        let night =
            Histogram::of(&plane(100, 100, |x, y| if x < 93 { (y % 3) as u8 } else { 100 + 20 * (x as u8 - 93) }));
        assert_eq!(common_percentile(&night, &night, 4), Percentile::new(95));
        let snow =
            Histogram::of(&plane(100, 100, |x, y| if x < 93 { 255 - (y % 3) as u8 } else { 20 * (x as u8 - 93) }));
        assert_eq!(common_percentile(&snow, &snow, 4), Percentile::new(5));
    }

    #[test]
    fn common_histograms_are_of_the_overlap() {
        // The frame shows the reference's content 50 px farther left. At its right, it shows something bright that is
        // not in the reference.
        let reference = plane(200, 120, |x, _| x as u8);
        let frame = plane(200, 120, |x, _| if x < 150 { x as u8 + 50 } else { 255 });
        let motion = Motion { dx: -50.0, ..Motion::default() };
        let (a, b) = common_histograms(&reference, &frame, &motion);
        assert_eq!(a.0, b.0);
        assert_eq!((a.total(), a.share_below(50)), (150 * 120, 0.0));
        // After half a turn about the centre, every pixel is compared with the opposite one.
        let half_turn = Motion { angle: std::f64::consts::PI, ..Motion::default() };
        let turned = plane(200, 120, |x, _| 199 - x as u8);
        let (a, b) = common_histograms(&reference, &turned, &half_turn);
        assert_eq!((a.total(), a.0), (200 * 120, b.0));
    }
}
