//! The look of surfaces: procedural colour at a point, and how the surface reflects light.

use super::noise::{fbm, unit, value, vary};
use super::vec3::{V3, smooth, v3};

/// How a surface reflects light. Roughness is the tangent of the half angle of the reflection lobe.
#[derive(Clone, Copy, PartialEq)]
pub enum Finish {
    Matt,
    /// Matt under a clear coat (varnish, glaze), with a Fresnel reflection of this roughness.
    Coat(f32),
    Metal(f32),
    Glass,
    /// A thin sheet (cloth, leaves) that transmits this share of the light and reflects the rest.
    Sheet(f32),
}

/// The pattern of a surface; colours are linear Rec. 709 reflectances.
#[derive(Clone, Copy)]
pub enum Paint {
    Plain(V3),
    /// Plaster with fine blotches and trowel marks.
    Plaster(V3),
    /// Boards along z, of this width in metres.
    Planks(f32),
    /// Wood with the grain along an axis (0, 1 or 2).
    Wood(V3, usize),
    Rug,
    /// Spine and covers of a book; each number gives another book.
    Book(V3, u32),
    /// A painting; each number gives another one.
    Picture(u32),
    /// Woven cloth in the first colour, with stripes in the second; the number of stripes per unit of the texture
    /// coordinate.
    Cloth(V3, V3, f32),
    /// Glazed pottery with painted bands.
    Pottery(V3, V3),
    Leaf(V3, u32),
    /// Speckled material: terracotta, fruit, bread.
    Speckle(V3, f32),
    /// Wickerwork of a basket.
    Weave(V3),
}

/// The paint and the finish of a surface.
#[derive(Clone, Copy)]
pub struct Material {
    pub paint: Paint,
    pub finish: Finish,
}

impl Paint {
    /// Returns approximately the mean of [`Paint::colour`] over the surface, which is enough for the light that it
    /// reflects to others.
    pub fn mean(&self) -> V3 {
        match *self {
            Paint::Plain(c) | Paint::Plaster(c) | Paint::Speckle(c, _) => c,
            Paint::Planks(_) => v3(0.31, 0.155, 0.065),
            Paint::Wood(c, _) => c * 0.85,
            Paint::Rug => v3(0.22, 0.12, 0.10),
            Paint::Book(c, _) => c * 0.9,
            Paint::Picture(_) => v3(0.36, 0.30, 0.24),
            Paint::Cloth(a, b, _) => a.mix(b, 0.24),
            Paint::Pottery(a, b) => a.mix(b, 0.15),
            Paint::Leaf(c, _) => c * 1.05,
            Paint::Weave(c) => c * 0.6,
        }
    }

    /// Returns the reflectance at the point `p` (in metres) with the texture coordinates `uv`.
    pub fn colour(&self, p: V3, uv: [f32; 2]) -> V3 {
        match *self {
            Paint::Plain(c) => c,
            Paint::Plaster(c) => plaster(c, p),
            Paint::Planks(w) => planks(w, p),
            Paint::Wood(c, axis) => wood(c, axis, p),
            Paint::Rug => rug(uv, p),
            Paint::Book(c, n) => book(c, n, uv, p),
            Paint::Picture(n) => picture(n, uv[0], uv[1]),
            Paint::Cloth(a, b, pitch) => cloth(a, b, pitch, uv, p),
            Paint::Pottery(a, b) => pottery(a, b, uv),
            Paint::Leaf(c, n) => leaf(c, n, uv),
            Paint::Speckle(c, k) => {
                let n = fbm(p.x * 140.0, p.y * 140.0, p.z * 140.0 + 0.01, 2);
                let m = fbm(p.x * 23.0, p.y * 23.0, p.z * 23.0 + 0.01, 3);
                c * (1.0 + k * (n - 0.5) * 2.0 + k * (m - 0.5) * 1.5)
            }
            Paint::Weave(c) => {
                let (a, b) = ((uv[0] * 60.0).floor(), (uv[1] * 18.0).floor());
                let over = (a as i32 + b as i32) & 1 == 0;
                let bulge = 1.0 - (2.0 * (uv[1] * 18.0).fract() - 1.0).powi(4) * 0.7;
                c * (bulge * if over { 1.0 } else { 0.62 } * (0.8 + 0.4 * unit(a as u32, b as u32, 5)))
            }
        }
    }
}

fn plaster(c: V3, p: V3) -> V3 {
    let broad = fbm(p.x * 1.3, p.y * 1.3, p.z * 1.3 + 0.01, 3) - 0.5;
    let trowel = fbm(p.x * 9.0 + 3.0 * broad, p.y * 22.0, p.z * 9.0 + 0.01, 4) - 0.5;
    let grit = value(p.x * 160.0, p.y * 160.0, p.z * 160.0 + 0.01) - 0.5;
    let crack = (fbm(p.x * 2.1, p.y * 2.1, p.z * 2.1 + 0.01, 5) - 0.5).abs();
    c * (1.0 + 0.16 * broad + 0.15 * trowel + 0.07 * grit - 0.10 * (1.0 - smooth(0.0, 0.008, crack)))
}

/// Returns the colour of wood with rings and pores, at a position `along` the grain and (`a`, `b`) across it.
fn grain(c: V3, along: f32, a: f32, b: f32, seed: f32) -> V3 {
    let bend = fbm(along * 1.1 + seed, a * 7.0, seed + 0.01, 3);
    let ring = ((a * 34.0 + b * 21.0 + 9.0 * bend + seed) * 1.7).sin() * 0.5 + 0.5;
    let pores = fbm(along * 9.0, a * 330.0, b * 330.0 + seed + 0.01, 2);
    let k = 0.72 + 0.30 * ring.powf(1.5) + 0.40 * (pores - 0.5);
    v3(c.x * k, c.y * k * (0.94 + 0.06 * ring), c.z * k * (0.86 + 0.14 * ring))
}

fn wood(c: V3, axis: usize, p: V3) -> V3 {
    let (along, a, b) = match axis {
        0 => (p.x, p.y, p.z),
        1 => (p.y, p.x, p.z),
        _ => (p.z, p.x, p.y),
    };
    grain(c, along, a, b, 2.0)
}

fn planks(w: f32, p: V3) -> V3 {
    let lane = (p.x / w).floor();
    let offset = unit(lane as i32 as u32, 3, 9) * 1.9;
    let long = 1.55;
    let board = ((p.z + offset) / long).floor();
    let (fx, fz) = ((p.x / w).fract().abs(), ((p.z + offset) / long).fract().abs() * long);
    let (i, j) = (lane as i32 as u32, board as i32 as u32);
    let base = vary(v3(0.36, 0.185, 0.082), 0.34, i, j);
    let c = grain(base, p.z, p.x, 0.3 * unit(i, j, 8), 40.0 * unit(i, j, 4));
    let gap = (0.5 - (fx - 0.5).abs()) * w;
    let end = fz.min(long - fz);
    let knot = {
        let (kx, kz) = (unit(i, j, 21) * w, unit(i, j, 22) * long);
        let d = ((fx * w - kx).powi(2) * 3.0 + (fz - kz).powi(2)).sqrt();
        0.45 * (1.0 - smooth(0.004, 0.022, d))
    };
    c * ((0.18 + 0.82 * smooth(0.0006, 0.003, gap)) * (0.3 + 0.7 * smooth(0.0006, 0.003, end)) * (1.0 - knot))
}

/// Returns the colour of a knotted carpet, uniform in each knot: borders, a field of small flowers, a medallion.
fn rug(uv: [f32; 2], p: V3) -> V3 {
    let (nx, ny) = (280.0, 236.0);
    let (kx, ky) = ((uv[0] * nx).floor(), (uv[1] * ny).floor());
    let (red, navy, cream, gold, green) = (
        v3(0.33, 0.055, 0.04),
        v3(0.035, 0.048, 0.105),
        v3(0.62, 0.52, 0.36),
        v3(0.50, 0.27, 0.06),
        v3(0.09, 0.15, 0.075),
    );
    // The four quarters of a carpet are mirror images.
    let (x, y) = ((kx - nx / 2.0 + 0.5).abs(), (ky - ny / 2.0 + 0.5).abs());
    let edge = (nx / 2.0 - x).min(ny / 2.0 - y);
    let along = if nx / 2.0 - x < ny / 2.0 - y { y } else { x };
    let flower = |u: f32, v: f32, pitch: f32, size: f32| {
        let (a, b) = ((u / pitch).fract() - 0.5, (v / pitch).fract() - 0.5);
        let (r, t) = ((a * a + b * b).sqrt() * pitch, b.atan2(a));
        (r < size * (0.72 + 0.28 * (4.0 * t).cos()), r < size * 0.34)
    };
    let c = if edge < 2.0 {
        navy
    } else if edge < 5.0 {
        if ((along / 3.0) as i32) & 1 == 0 { cream } else { red }
    } else if edge < 22.0 {
        match flower(along, edge - 5.0, 17.0, 8.0) {
            (_, true) => gold,
            (true, _) => cream,
            _ if ((along + edge * 2.0) % 17.0) < 2.0 => green,
            _ => navy,
        }
    } else if edge < 26.0 {
        if ((along / 2.0) as i32) & 1 == 0 { gold } else { navy }
    } else {
        let d = x / 84.0 + y / 66.0;
        let wave = 0.05 * (x * 0.55).cos() + 0.05 * (y * 0.55).cos();
        match d + wave {
            d if d < 0.16 => gold,
            d if d < 0.24 => navy,
            d if d < 0.52 => match flower(x + 5.0, y + 5.0, 10.0, 4.2) {
                (_, true) => red,
                (true, _) => cream,
                _ => green,
            },
            d if d < 0.58 => cream,
            d if d < 0.64 => navy,
            d if d > 1.52 => match flower(x, y, 9.0, 4.0) {
                (_, true) => gold,
                (true, _) => red,
                _ => navy,
            },
            _ => match flower(x + 3.0, y + 7.0, 14.0, 5.0) {
                (_, true) => navy,
                (true, _) => {
                    if ((x / 14.0) as i32 + (y / 14.0) as i32) & 1 == 0 {
                        gold
                    } else {
                        cream
                    }
                }
                _ => red,
            },
        }
    };
    let wool = 0.82 + 0.36 * value(p.x * 420.0, p.z * 420.0, 3.0);
    let worn = 0.8 + 0.4 * fbm(p.x * 3.0, p.z * 9.0, 5.0, 3);
    vary(c, 0.22, kx as u32, ky as u32) * (wool * worn)
}

fn book(c: V3, n: u32, uv: [f32; 2], p: V3) -> V3 {
    let (u, v) = (uv[0], uv[1]);
    let worn = 0.8 + 0.4 * fbm(p.x * 60.0, p.y * 60.0, p.z * 60.0 + 0.01, 3);
    let gilt = if unit(n, 1, 1) < 0.6 { v3(0.62, 0.44, 0.14) } else { v3(0.7, 0.66, 0.56) };
    let band = unit(n, 2, 2) * 0.12 + 0.78;
    let rules = [band, band + 0.05, 0.12, 0.155];
    if rules.iter().any(|r| (v - r).abs() < 0.008) {
        return gilt * worn;
    }
    // Lettering: short marks in columns, as on the spine of a book.
    let (top, foot) = (band - 0.06, 0.34 + 0.2 * unit(n, 3, 3));
    if v < top && v > foot && (u - 0.5).abs() < 0.2 {
        let row = (v * 46.0).floor() as u32;
        let cell = (u * 14.0).floor() as u32;
        if unit(row, cell, n) < 0.5 && (v * 46.0).fract() < 0.75 && unit(row, n, 6) < 0.82 {
            return gilt * worn;
        }
    }
    let label = unit(n, 4, 4) < 0.3 && v > 0.55 && v < 0.75;
    let round = 0.72 + 0.28 * (1.0 - (2.0 * u - 1.0).powi(2));
    (if label { c * 0.3 } else { c }) * (worn * round)
}

/// Returns the colour of painting `n` at (u, v): a sea, a still life of discs, hills at night, flowers, a chart of
/// colour patches.
fn picture(n: u32, u: f32, v: f32) -> V3 {
    let brush = fbm(u * 40.0 + 10.0 * v, v * 90.0, n as f32, 3);
    let k = 0.75 + 0.5 * brush;
    let c = match n {
        0 => {
            let sky = v3(0.75, 0.45, 0.22).mix(v3(0.16, 0.26, 0.42), smooth(0.45, 1.0, v + 0.1 * brush));
            let sun = ((u - 0.62).powi(2) * 1.8 + (v - 0.56).powi(2)).sqrt();
            let wave = value(u * 18.0, v * 120.0, 2.0);
            let sea = v3(0.03, 0.10, 0.16)
                .mix(v3(0.55, 0.36, 0.18), smooth(0.55, 0.9, wave) * smooth(0.35, 0.0, (u - 0.62).abs()));
            let sail = (u - 0.3).abs() < 0.09 * (0.72 - v) / 0.3 && v > 0.44 && v < 0.72 && u > 0.27;
            let hull = (u - 0.31).abs() < 0.10 && v > 0.40 && v < 0.435;
            match () {
                _ if sail => v3(0.8, 0.74, 0.62),
                _ if hull => v3(0.12, 0.04, 0.02),
                _ if v < 0.45 => sea,
                _ if sun < 0.085 => v3(0.92, 0.72, 0.32),
                _ => sky,
            }
        }
        1 => {
            let mut c = v3(0.58, 0.50, 0.36);
            for i in 0..26 {
                let (x, y, r) = (unit(i, 1, 31), unit(i, 2, 31), 0.05 + 0.12 * unit(i, 3, 31));
                let d = ((u - x).powi(2) + (v - y).powi(2)).sqrt();
                let hue = [
                    v3(0.55, 0.08, 0.05),
                    v3(0.05, 0.16, 0.32),
                    v3(0.72, 0.46, 0.08),
                    v3(0.03, 0.03, 0.04),
                    v3(0.13, 0.28, 0.16),
                ];
                if d < r && (d > r * 0.6 || i % 3 == 0) {
                    c = hue[(i % 5) as usize];
                }
            }
            c
        }
        2 => {
            let ridge = |s: f32, h: f32| h + 0.16 * (fbm(u * 3.0 + s, s, s, 3) - 0.5);
            let moon = ((u - 0.32).powi(2) + (v - 0.78).powi(2) * 1.6).sqrt();
            let star = unit((u * 70.0) as u32, (v * 90.0) as u32, 8) > 0.985;
            match () {
                _ if v < ridge(1.0, 0.2) => v3(0.015, 0.03, 0.03),
                _ if v < ridge(5.0, 0.36) => v3(0.03, 0.08, 0.10),
                _ if v < ridge(9.0, 0.5) => v3(0.06, 0.14, 0.20),
                _ if moon < 0.09 => v3(0.85, 0.82, 0.66),
                _ if star => v3(0.8, 0.8, 0.7),
                _ => v3(0.08, 0.13, 0.30).mix(v3(0.30, 0.34, 0.45), smooth(0.9, 0.45, v)),
            }
        }
        3 => {
            let mut c = v3(0.66, 0.62, 0.50);
            for i in 0..9 {
                let (x, y) = (0.2 + 0.6 * unit(i, 5, 61), 0.45 + 0.4 * unit(i, 6, 61));
                let stem = x + (0.5 - x) * ((y - v) / y).clamp(0.0, 1.0);
                if v < y && v > 0.12 && (u - stem).abs() < 0.008 {
                    c = v3(0.10, 0.22, 0.07);
                }
                let (a, b) = (u - x, v - y);
                let (r, t) = ((a * a + b * b).sqrt(), b.atan2(a));
                if r < 0.075 * (0.7 + 0.3 * (5.0 * t + i as f32).cos()) {
                    c = [v3(0.68, 0.14, 0.10), v3(0.78, 0.52, 0.10), v3(0.36, 0.16, 0.42)][(i % 3) as usize];
                }
                if r < 0.02 {
                    c = v3(0.25, 0.12, 0.03);
                }
            }
            c
        }
        _ => {
            let (i, j) = ((u * 7.0) as u32, (v * 9.0) as u32);
            vary(v3(unit(i, j, 1 + n), unit(i, j, 2 + n), unit(i, j, 3 + n)) * 0.6, 0.2, i, j)
        }
    };
    c * k
}

fn cloth(a: V3, b: V3, pitch: f32, uv: [f32; 2], p: V3) -> V3 {
    let s = (uv[0] * pitch).fract();
    let stripe =
        if (0.42..0.58).contains(&s) || (0.64..0.68).contains(&s) || (0.32..0.36).contains(&s) { b } else { a };
    let weave = value(p.x * 300.0, p.y * 300.0, p.z * 300.0 + 0.01) - 0.5;
    let slub = fbm(p.x * 30.0, p.y * 140.0, p.z * 30.0 + 0.01, 2) - 0.5;
    stripe * (1.0 + 0.3 * weave + 0.25 * slub)
}

fn pottery(a: V3, b: V3, uv: [f32; 2]) -> V3 {
    let (u, v) = (uv[0] * 16.0, uv[1]);
    let zigzag = 0.44 + 0.05 * (2.0 * (u.fract() - 0.5)).abs();
    let dots = ((u.fract() - 0.5).powi(2) + ((v - 0.6) * 24.0).powi(2)).sqrt() < 0.3;
    let ring = [0.36, 0.56, 0.64, 0.9].iter().any(|r| (v - r).abs() < 0.008);
    let k = 0.85 + 0.3 * fbm(uv[0] * 40.0, v * 30.0, 3.0, 3);
    (if (v - zigzag).abs() < 0.022 || dots || ring { b } else { a }) * k
}

fn leaf(c: V3, n: u32, uv: [f32; 2]) -> V3 {
    let rib = (uv[0] - 0.5).abs() < 0.04;
    let vein = ((uv[1] * 14.0 - (uv[0] - 0.5).abs() * 6.0).fract() - 0.5).abs() < 0.08;
    vary(c, 0.25, n, 3)
        * if rib {
            1.5
        } else if vein {
            1.2
        } else {
            1.0
        }
}
