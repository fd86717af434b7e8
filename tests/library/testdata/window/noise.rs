//! Random numbers without state: hashes of counters, smooth noise for textures, and the sampler of one light path.

use super::vec3::{V3, v3};

/// Returns a 32-bit hash of three integers (the first output of PCG3D).
pub fn hash(a: u32, b: u32, c: u32) -> u32 {
    let step = |v: u32| v.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    let (mut x, mut y, mut z) = (step(a), step(b), step(c));
    for _ in 0..2 {
        x = x.wrapping_add(y.wrapping_mul(z));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        x ^= x >> 16;
        y ^= y >> 16;
        z ^= z >> 16;
    }
    x
}

/// Returns a hash of three integers as a number in 0..1.
pub fn unit(a: u32, b: u32, c: u32) -> f32 {
    (hash(a, b, c) >> 8) as f32 / (1 << 24) as f32
}

/// Returns smooth value noise in 0..1 on a lattice with cells of size 1.
pub fn value(x: f32, y: f32, z: f32) -> f32 {
    let (fx, fy, fz) = (x.floor(), y.floor(), z.floor());
    let ease = |t: f32| t * t * (3.0 - 2.0 * t);
    let (u, v, w) = (ease(x - fx), ease(y - fy), ease(z - fz));
    let at = |i: i32, j: i32, k: i32| unit((fx as i32 + i) as u32, (fy as i32 + j) as u32, (fz as i32 + k) as u32);
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let plane = |k: i32| mix(mix(at(0, 0, k), at(1, 0, k), u), mix(at(0, 1, k), at(1, 1, k), u), v);
    // Two-dimensional noise has a whole number as z; then one of the two planes is enough.
    if w == 0.0 { plane(0) } else { mix(plane(0), plane(1), w) }
}

/// Returns the sum of `octaves` of value noise, each twice as fine and half as strong as the one before; it is in 0..1
/// with mean one half.
pub fn fbm(x: f32, y: f32, z: f32, octaves: u32) -> f32 {
    let (mut sum, mut total, mut amplitude, mut k) = (0.0, 0.0, 1.0, 1.0);
    for i in 0..octaves {
        let shift = 17.3 * i as f32;
        let depth = if z == z.floor() { z + i as f32 } else { z * k };
        sum += amplitude * value(x * k + shift, y * k - shift, depth);
        total += amplitude;
        amplitude *= 0.5;
        k *= 2.03;
    }
    sum / total
}

/// Returns a normally distributed number that depends on three counters (method of Box and Muller).
pub fn gaussian(a: u32, b: u32, c: u32) -> f32 {
    let u = (f64::from(hash(a, b, c.wrapping_mul(2))) + 0.5) / 4_294_967_296.0;
    let v = f64::from(hash(a, b, c.wrapping_mul(2).wrapping_add(1))) / 4_294_967_296.0;
    ((-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()) as f32
}

/// The random numbers of one path. The first ones, which matter most, are from a low-discrepancy sequence, the others
/// are hashes.
pub struct Sampler {
    pixel: u32,
    sample: u32,
    next: u32,
}

/// Number of random numbers of a path that are from the low-discrepancy sequence.
const SPREAD: u32 = 8;

impl Sampler {
    pub fn new(pixel: u32, sample: u32) -> Sampler {
        Sampler { pixel, sample, next: 0 }
    }

    /// Returns the next number, in 0..1.
    pub fn draw(&mut self) -> f32 {
        let i = self.next;
        self.next += 1;
        if i >= SPREAD {
            return unit(self.pixel, self.sample, i);
        }
        // Roberts's R_d sequence: multiples of powers of the root of x^(d+1) = x + 1, shifted by a hash of the pixel.
        const ROOT: f64 = 1.085_070_245_491_450_8;
        let alpha = ROOT.powi(-(i as i32) - 1);
        let start = f64::from(unit(self.pixel, 0x9e37, i));
        ((start + f64::from(self.sample) * alpha).fract() as f32).min(0.999_999_9)
    }

    /// Returns a direction around the unit vector `n`, with a probability proportional to the cosine of the angle to
    /// `n`.
    pub fn cosine(&mut self, n: V3) -> V3 {
        let (a, r2) = (std::f32::consts::TAU * self.draw(), self.draw());
        let (r, (t, b)) = (r2.sqrt(), n.frame());
        (t * (r * a.cos()) + b * (r * a.sin()) + n * (1.0 - r2).max(0.0).sqrt()).unit()
    }

    /// Returns a direction within `spread` (the tangent of a small angle) of `d`.
    pub fn cone(&mut self, d: V3, spread: f32) -> V3 {
        let (a, r) = (std::f32::consts::TAU * self.draw(), spread * self.draw().sqrt());
        let (t, b) = d.frame();
        (d + t * (r * a.cos()) + b * (r * a.sin())).unit()
    }
}

/// Returns the colour `c`, made lighter or darker by up to `amount`, by a hash of `a` and `b`.
pub fn vary(c: V3, amount: f32, a: u32, b: u32) -> V3 {
    let k = 1.0 + amount * (2.0 * unit(a, b, 77) - 1.0);
    let warm = amount * 0.4 * (unit(a, b, 78) - 0.5);
    v3(c.x * (k + warm), c.y * k, c.z * (k - warm)).max(V3::ZERO)
}
