//! CIEDE2000: the perceived difference of two colours.
//!
//! In: colours in CIELAB. Out: dE; 1 is about a just noticeable difference. Cost: 0.4 us. Source: Sharma, Wu & Dalal
//! 2005, "The CIEDE2000 color-difference formula: Implementation notes, supplementary test data, and mathematical
//! observations", equations 2 to 22; CIELAB by ISO/CIE 11664-4.

use libm::{atan2, cbrt, cos, exp, hypot, sin, sqrt};

/// 25^7, a constant of the formula.
const FAR: f64 = 6_103_515_625.0;

/// A colour of CIELAB.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Lab {
    pub l: f64,
    pub a: f64,
    pub b: f64,
}

impl Lab {
    /// Converts XYZ relative to white to CIELAB.
    pub fn of(xyz: [f64; 3]) -> Lab {
        const DELTA: f64 = 6.0 / 29.0;
        let f = |t: f64| if t > DELTA * DELTA * DELTA { cbrt(t) } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
        let [x, y, z] = xyz.map(f);
        Lab { l: 116.0 * y - 16.0, a: 500.0 * (x - y), b: 200.0 * (y - z) }
    }
}

/// Returns the difference dE of two colours.
pub(super) fn difference(p: Lab, q: Lab) -> f64 {
    if p == q {
        return 0.0;
    }
    let seventh = |c: f64| {
        let cube = c * c * c;
        cube * cube * c
    };
    // Equations 2 to 7: the coordinate a is scaled up near grey.
    let chroma = 0.5 * (hypot(p.a, p.b) + hypot(q.a, q.b));
    let stretch = 1.0 + 0.5 * (1.0 - sqrt(seventh(chroma) / (seventh(chroma) + FAR)));
    let (a1, a2) = (stretch * p.a, stretch * q.a);
    let (c1, c2) = (hypot(a1, p.b), hypot(a2, q.b));
    let hue = |a: f64, b: f64| {
        let degrees = if a == 0.0 && b == 0.0 { 0.0 } else { atan2(b, a).to_degrees() };
        if degrees < 0.0 { degrees + 360.0 } else { degrees }
    };
    let (h1, h2) = (hue(a1, p.b), hue(a2, q.b));
    // Equations 8 to 14.
    let is_grey = c1 * c2 == 0.0;
    let turn = match h2 - h1 {
        _ if is_grey => 0.0,
        d if d > 180.0 => d - 360.0,
        d if d < -180.0 => d + 360.0,
        d => d,
    };
    let (dl, dc) = (q.l - p.l, c2 - c1);
    let dh = 2.0 * sqrt(c1 * c2) * sin((turn / 2.0).to_radians());
    let (l, c) = (0.5 * (p.l + q.l), 0.5 * (c1 + c2));
    let h = match h1 + h2 {
        sum if is_grey => sum,
        sum if (h1 - h2).abs() <= 180.0 => 0.5 * sum,
        sum if sum < 360.0 => 0.5 * (sum + 360.0),
        sum => 0.5 * (sum - 360.0),
    };
    // Equations 15 to 22.
    let cosine = |degrees: f64| cos(degrees.to_radians());
    let t = 1.0 - 0.17 * cosine(h - 30.0) + 0.24 * cosine(2.0 * h) + 0.32 * cosine(3.0 * h + 6.0)
        - 0.20 * cosine(4.0 * h - 63.0);
    let blue = (h - 275.0) / 25.0;
    let angle = 30.0 * exp(-blue * blue);
    let grey = (l - 50.0) * (l - 50.0);
    let (sl, sc, sh) = (1.0 + 0.015 * grey / sqrt(20.0 + grey), 1.0 + 0.045 * c, 1.0 + 0.015 * c * t);
    let rotation = -2.0 * sqrt(seventh(c) / (seventh(c) + FAR)) * sin((2.0 * angle).to_radians());
    let (dl, dc, dh) = (dl / sl, dc / sc, dh / sh);
    // Rounding can make the sum slightly negative.
    sqrt((dl * dl + dc * dc + dh * dh + rotation * dc * dh).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_gives_the_papers_table() {
        let blue = [50.0, 0.0, -82.7485];
        let red = [50.0, 2.5, 0.0];
        // Table 1 of the paper, which has four decimals.
        let table = [
            ([50.0, 2.6772, -79.7751], blue, 2.0425),
            ([50.0, 3.1571, -77.2803], blue, 2.8615),
            ([50.0, 2.8361, -74.0200], blue, 3.4412),
            ([50.0, -1.3802, -84.2814], blue, 1.0000),
            ([50.0, -1.1848, -84.8006], blue, 1.0000),
            ([50.0, -0.9009, -85.5211], blue, 1.0000),
            ([50.0, 0.0, 0.0], [50.0, -1.0, 2.0], 2.3669),
            ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0009], 7.1792),
            ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0010], 7.1792),
            ([50.0, 2.4900, -0.0010], [50.0, -2.4900, 0.0011], 7.2195),
            ([50.0, -0.0010, 2.4900], [50.0, 0.0009, -2.4900], 4.8045),
            (red, [50.0, 0.0, -2.5], 4.3065),
            (red, [73.0, 25.0, -18.0], 27.1492),
            (red, [61.0, -5.0, 29.0], 22.8977),
            (red, [56.0, -27.0, -3.0], 31.9030),
            (red, [58.0, 24.0, 15.0], 19.4535),
            ([60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387], 1.2644),
            ([63.0109, -31.0961, -5.8663], [62.8187, -29.7946, -4.0864], 1.2630),
            ([61.2901, 3.7196, -5.3901], [61.4292, 2.2480, -4.9620], 1.8731),
            ([35.0831, -44.1164, 3.7933], [35.0232, -40.0716, 1.5901], 1.8645),
            ([22.7233, 20.0904, -46.6940], [23.0331, 14.9730, -42.5619], 2.0373),
            ([36.4612, 47.8580, 18.3852], [36.2715, 50.5065, 21.2231], 1.4146),
            ([90.8027, -2.0831, 1.4410], [91.1528, -1.6435, 0.0447], 1.4441),
            ([90.9257, -0.5406, -0.9208], [88.6381, -0.8985, -0.7239], 1.5381),
            ([6.7747, -0.2908, -2.4247], [5.8714, -0.0985, -2.2286], 0.6377),
            ([2.0776, 0.0795, -1.1350], [0.9033, -0.0636, -0.5514], 0.9082),
        ];
        let lab = |v: [f64; 3]| Lab { l: v[0], a: v[1], b: v[2] };
        for (p, q, expected) in table {
            for (p, q) in [(p, q), (q, p)] {
                let found = difference(lab(p), lab(q));
                assert!((found - expected).abs() < 5.1e-5, "{p:?} {q:?}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn white_and_black_are_where_they_belong() {
        let white = Lab::of([1.0; 3]);
        assert!((white.l - 100.0).abs() < 1e-12 && white.a.abs() < 1e-12 && white.b.abs() < 1e-12);
        assert!(Lab::of([0.0; 3]).l.abs() < 1e-12);
        // Grey that reflects 18.4 % has the lightness 50.
        assert!((Lab::of([0.184_187; 3]).l - 50.0).abs() < 1e-3);
    }
}
