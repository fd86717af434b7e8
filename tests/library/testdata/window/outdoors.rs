//! The landscape outside of the window, as a function of direction alone: sky, clouds, mountains, hills, trees, a
//! garden.
//!
//! Values are cd/m2 in linear Rec. 709. The landscape consists of layers from far to near, each with a ridge line and a
//! texture, with haze that increases towards the low sun at the upper left.

use super::noise::{fbm, unit, value};
use super::vec3::{V3, smooth, v3};

/// Returns the direction to the sun, as a unit vector.
pub fn sun() -> V3 {
    v3(-0.50, 0.47, 0.73).unit()
}

/// Illuminance by the sun of a surface that faces it, in lux, as a colour.
pub const SUN_LUX: V3 = v3(82_000.0, 62_000.0, 37_000.0);

/// Tangent of the angular radius of the sun; it is larger than the real one, so that patches of sunlight have soft
/// edges.
pub const SUN_SPREAD: f32 = 0.009;

/// Returns the radiance from direction `d` (a unit vector, towards +z), without the disc of the sun.
pub fn radiance(d: V3) -> V3 {
    let (az, el) = (d.x.atan2(d.z), d.y.asin());
    let towards = d.dot(sun()).max(0.0);
    let mut c = sky(az, el, towards);
    let haze = v3(4900.0, 4700.0, 4900.0) * (0.60 + 1.3 * towards.powi(8));
    c = mountains(c, az, el, haze);
    c = hills(c, az, el, haze);
    c = garden(c, az, el);
    tree(c, az, el)
}

fn sky(az: f32, el: f32, towards: f32) -> V3 {
    let up = el.max(0.0);
    let blue = v3(950.0, 2450.0, 5100.0);
    let pale = v3(8400.0, 7200.0, 5300.0);
    let mut c = pale.mix(blue, smooth(-0.04, 0.20, up).powf(0.75));
    c += v3(26_000.0, 19_000.0, 10_500.0) * (0.5 * towards.powi(14) + 1.5 * towards.powi(60));
    // Cumulus clouds: the noise is stretched along the horizon, and more so lower down, as distant clouds look.
    let s = 0.10 + 0.55 * up;
    let (x, y) = (az / s * 0.36 + 3.1, (up + 0.02).ln() * 2.3);
    let warp = fbm(x * 1.3, y * 1.3, 7.0, 3) - 0.5;
    let at = |dx: f32, dy: f32| fbm(x * 1.9 + 0.9 * warp + dx, y * 2.1 + 0.5 * warp + dy, 3.0, 6);
    let density = at(0.0, 0.0);
    let cover = smooth(0.47, 0.58, density) * smooth(0.015, 0.05, el);
    let lit = (density - at(-0.10, 0.16)) * 5.0;
    let shade = smooth(-0.35, 0.45, lit);
    let thick = smooth(0.55, 0.78, density);
    let edge = v3(21_000.0, 17_200.0, 13_000.0) * (0.75 + 0.9 * towards.powi(5));
    let body = v3(5600.0, 5100.0, 5400.0);
    let cloud = body.mix(edge, (shade * (1.0 - 0.45 * thick)).clamp(0.0, 1.0));
    c.mix(cloud, cover * 0.95)
}

fn mountains(c: V3, az: f32, el: f32, haze: V3) -> V3 {
    let fold = |x: f32, s: f32| {
        let n = fbm(x, s, s, 5);
        1.0 - (2.0 * n - 1.0).abs()
    };
    let mut c = c;
    for (i, (h, rise, keep)) in [(0.040, 0.085, 0.42), (0.016, 0.060, 0.60)].into_iter().enumerate() {
        let s = 3.0 + i as f32 * 6.0;
        let ridge = h + rise * (fold(az * 5.5 + s, s) - 0.45);
        if el < ridge {
            let snow = smooth(0.050, 0.065, el + 0.014 * fbm(az * 120.0, el * 160.0, s, 3));
            let face = fbm(az * 90.0 + el * 60.0, el * 70.0, s, 4);
            let rock = v3(900.0, 1250.0, 2000.0) * (0.5 + face);
            let own = rock.mix(v3(7000.0, 6500.0, 6500.0), snow * smooth(0.45, 0.6, face));
            c = haze.mix(own, keep + 0.25 * smooth(0.0, 0.06, el));
        }
    }
    c
}

fn hills(c: V3, az: f32, el: f32, haze: V3) -> V3 {
    let mut c = c;
    for i in 0..4u32 {
        let s = 20.0 + 11.0 * i as f32;
        let fi = i as f32;
        let wave = 0.020 * (az * (7.0 - fi) + s * 1.7).sin() + 0.008 * (az * 19.0 + s).sin();
        let wood = fbm(az * (60.0 + 20.0 * fi), s, s, 4) * smooth(0.45, 0.62, fbm(az * 9.0, s, 2.0, 2));
        let base = 0.006 - 0.024 * fi + wave * (0.7 + 0.15 * fi);
        let ridge = base + (0.006 + 0.004 * fi) * wood;
        if el >= ridge {
            continue;
        }
        let depth = base - el;
        // Fields: a distorted patchwork in perspective, with hedges between the fields.
        let (x, y) = (az * (26.0 - 4.0 * fi) + 14.0 * depth, (depth + 0.004).ln() * 2.6);
        let (wx, wy) = (x + 0.9 * fbm(x * 0.6, y * 0.6, s, 2), y + 0.9 * fbm(x * 0.5, y * 0.5, s + 9.0, 2));
        let (px, py) = (wx.floor() as i32 as u32, wy.floor() as i32 as u32);
        let crop = [
            v3(1500.0, 2050.0, 420.0),
            v3(2900.0, 2350.0, 720.0),
            v3(900.0, 1500.0, 330.0),
            v3(2200.0, 2300.0, 520.0),
            v3(1900.0, 1200.0, 620.0),
        ];
        let mut field = crop[(unit(px, py, i) * 5.0) as usize % 5];
        let furrow = (wx.rem_euclid(1.0) * (24.0 + 14.0 * unit(px, py, 70)) + wy.rem_euclid(1.0) * 9.0).sin();
        field = field * (0.92 + 0.13 * furrow + 0.5 * (fbm(az * 260.0, el * 700.0, s, 3) - 0.5));
        let hedge = (0.5 - (wx.rem_euclid(1.0) - 0.5).abs()).min(0.5 - (wy.rem_euclid(1.0) - 0.5).abs());
        let ragged = 0.06 + 0.07 * fbm(az * 320.0, el * 420.0, s, 2);
        let canopy = canopies(az, el, 70.0 - 10.0 * fi, s);
        let green = v3(420.0, 660.0, 170.0) * (0.35 + 1.5 * canopy.1);
        if hedge < ragged || depth < 0.3 * (ridge - base).max(0.0) || el > base {
            field = green;
        } else if canopy.0 && unit(px, py, i + 9) < 0.45 {
            field = green * 1.1;
        }
        let rim = 1.0 + 0.9 * (1.0 - smooth(0.0, 0.004, ridge - el));
        let clear = [0.58, 0.72, 0.86, 0.95][i as usize];
        c = haze.mix(field * rim, clear);
    }
    c
}

/// Returns whether a round tree top is in this direction, and how strongly it is lit. The tree tops are on a jittered
/// grid of `pitch` cells per radian.
fn canopies(az: f32, el: f32, pitch: f32, seed: f32) -> (bool, f32) {
    let (x, y) = (az * pitch, el * pitch * 2.2);
    let mut found = (false, fbm(az * 420.0, el * 420.0, seed, 3));
    for j in -1..=1 {
        for i in -1..=1 {
            let (cx, cy) = (x.floor() as i32 + i, y.floor() as i32 + j);
            let key = (cx as u32, cy as u32, seed as u32);
            if unit(key.0, key.1, key.2 + 1) > 0.6 {
                continue;
            }
            let (dx, dy) =
                (x - cx as f32 - unit(key.0, key.1, key.2 + 2), y - cy as f32 - unit(key.0, key.1, key.2 + 3));
            let r = 0.26 + 0.2 * unit(key.0, key.1, key.2 + 4) + 0.12 * (value(x * 9.0, y * 9.0, seed) - 0.5);
            if dx * dx + dy * dy * 0.5 < r * r {
                found = (true, 0.25 * found.1 + 0.45 * (0.6 + (dy * 0.7 - dx * 0.7) / r));
            }
        }
    }
    found
}

/// Returns `c` or, in front of it, the near ground: a lawn mown in stripes, a path, beds of flowers, a hedge and a
/// picket fence.
fn garden(c: V3, az: f32, el: f32) -> V3 {
    let mut c = c;
    let bushes = -0.088 + 0.022 * fbm(az * 34.0, 1.0, 4.0, 4) + 0.012 * (az * 23.0 + 1.0).sin();
    if el < bushes {
        let leaf = fbm(az * 240.0, el * 240.0, 6.0, 4);
        let blob = fbm(az * 46.0 - el * 20.0, el * 46.0, 8.0, 3);
        let rim = 1.0 - smooth(0.0, 0.007, bushes - el);
        c = v3(560.0, 900.0, 190.0) * (0.15 + 1.5 * blob * leaf + 1.6 * rim * leaf);
        let rose = unit((az * 460.0).floor() as i32 as u32, (el * 460.0).floor() as i32 as u32, 12);
        if rose > 0.93 && blob > 0.42 {
            c = [v3(4200.0, 900.0, 1100.0), v3(4800.0, 4300.0, 3900.0), v3(4300.0, 1900.0, 2100.0)]
                [(rose * 300.0) as usize % 3];
        }
    }
    let picket = (az * 190.0).rem_euclid(1.0);
    let point = -0.104 - 0.006 * (2.0 * picket - 0.62).abs();
    if el < point && el > -0.14 && (picket < 0.62 || (el + 0.113).abs() < 0.0022 || (el + 0.130).abs() < 0.0022) {
        c = v3(2500.0, 2350.0, 2300.0) * (0.75 + 0.5 * value(az * 900.0, el * 120.0, 5.0));
    }
    let lawn = -0.128 + 0.003 * value(az * 300.0, 2.0, 2.0);
    if el < lawn {
        let far = 2.6 / (-el).tan();
        let (x, z) = (far * az.sin(), far * az.cos());
        let stripe = if ((x * 0.9 + 0.12 * z).floor() as i32) & 1 == 0 { 1.0 } else { 0.72 };
        let blades = fbm(x * 30.0, z * 9.0, 5.0, 4);
        c = v3(1750.0, 2650.0, 420.0) * (stripe * (0.45 + 1.1 * blades));
        let path = x + 1.6 + 0.7 * (z * 0.33).sin();
        if path.abs() < 0.55 {
            let stone = value(x * 5.0, z * 2.4, 6.0);
            c = v3(3300.0, 2800.0, 2100.0) * (0.6 + 0.6 * stone) * (0.7 + 0.6 * fbm(x * 60.0, z * 20.0, 5.0, 2));
        } else if path.abs() < 1.35 {
            let (fx, fz) = ((x * 16.0).floor() as i32 as u32, (z * 6.0).floor() as i32 as u32);
            let bloom = unit(fx, fz, 41);
            c = v3(500.0, 880.0, 170.0) * (0.4 + 1.4 * fbm(x * 40.0, z * 15.0, 6.0, 3));
            if bloom > 0.55 {
                let hue = [
                    v3(5200.0, 1100.0, 500.0),
                    v3(5600.0, 4300.0, 500.0),
                    v3(5200.0, 5000.0, 4700.0),
                    v3(2100.0, 1100.0, 4200.0),
                    v3(4800.0, 1500.0, 2600.0),
                ];
                c = hue[(unit(fx, fz, 42) * 5.0) as usize % 5] * (0.6 + 0.6 * unit(fx, fz, 43));
            }
        }
    }
    c
}

/// Returns `c` or, in front of it, an old tree on the right of the view: a leaning trunk, boughs, and leaves in clumps.
fn tree(c: V3, az: f32, el: f32) -> V3 {
    let mut c = c;
    let bark = v3(700.0, 470.0, 290.0) * (0.3 + 1.2 * fbm(az * 500.0, el * 90.0, 3.0, 3));
    let line = |x0: f32, y0: f32, x1: f32, y1: f32, w0: f32, w1: f32| {
        let t =
            (((az - x0) * (x1 - x0) + (el - y0) * (y1 - y0)) / ((x1 - x0).powi(2) + (y1 - y0).powi(2))).clamp(0.0, 1.0);
        let wiggle = 0.004 * (t * 9.0 + x1 * 50.0).sin();
        let d = ((az - x0 - (x1 - x0) * t - wiggle).powi(2) + (el - y0 - (y1 - y0) * t).powi(2)).sqrt();
        d < w0 + (w1 - w0) * t
    };
    let boughs = [
        line(0.105, -0.16, 0.118, 0.04, 0.0125, 0.009),
        line(0.118, 0.04, 0.06, 0.15, 0.007, 0.003),
        line(0.118, 0.03, 0.17, 0.14, 0.007, 0.003),
        line(0.092, 0.09, 0.02, 0.11, 0.0035, 0.0015),
        line(0.117, 0.05, 0.125, 0.2, 0.006, 0.003),
    ];
    if boughs.into_iter().any(|b| b) {
        let left = if el < 0.04 { smooth(0.004, -0.012, az - 0.111 - 0.06 * (el + 0.06)) } else { 0.3 };
        c = bark * (0.5 + 2.4 * left);
    }
    let clumps = [
        (0.115, 0.165, 0.075),
        (0.05, 0.16, 0.05),
        (0.17, 0.13, 0.06),
        (0.012, 0.118, 0.034),
        (0.085, 0.225, 0.07),
        (0.16, 0.20, 0.08),
        (0.075, 0.105, 0.03),
        (0.15, 0.075, 0.032),
        (0.025, 0.19, 0.04),
        (0.2, 0.08, 0.04),
    ];
    let leafy = fbm(az * 190.0, el * 190.0, 9.0, 3);
    let holes = fbm(az * 60.0, el * 60.0, 4.0, 3);
    let mut light: Option<f32> = None;
    for (x, y, r) in clumps {
        let (dx, dy) = ((az - x) / r, (el - y) / r);
        let reach = dx * dx + dy * dy + 1.1 * (leafy - 0.5) + 1.5 * (holes - 0.5);
        if reach < 0.85 {
            let lit = 0.5 + 0.42 * (dy - dx) + 0.5 * smooth(0.5, 0.85, reach);
            light = Some(light.map_or(lit, |l: f32| 0.5 * (l + lit)));
        }
    }
    if let Some(l) = light {
        let grain = value(az * 620.0, el * 620.0, 2.0);
        c = v3(1500.0, 2050.0, 330.0) * (0.10 + (0.2 + 1.2 * l.max(0.0)) * leafy * (0.45 + grain));
    }
    c
}
