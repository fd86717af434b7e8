//! Triangles with smooth normals and texture coordinates, and the few shapes of which everything in the room consists.

use super::vec3::{V3, v3};

/// A corner of a triangle.
#[derive(Clone, Copy, Default)]
pub struct Corner {
    pub at: V3,
    pub normal: V3,
    pub uv: [f32; 2],
}

/// A triangle and the index of its material.
#[derive(Clone, Copy)]
pub struct Triangle {
    pub corners: [Corner; 3],
    pub material: u16,
}

/// A list of triangles, to which the methods add shapes.
#[derive(Default)]
pub struct Mesh {
    pub triangles: Vec<Triangle>,
}

impl Mesh {
    /// Adds a flat parallelogram from `o` along `u` and `v`; the texture coordinates run from 0 to 1 along both.
    pub fn quad(&mut self, o: V3, u: V3, v: V3, material: u16) {
        let normal = u.cross(v).unit();
        let c = |a: f32, b: f32| Corner { at: o + u * a + v * b, normal, uv: [a, b] };
        let (p, q, r, s) = (c(0.0, 0.0), c(1.0, 0.0), c(1.0, 1.0), c(0.0, 1.0));
        self.triangles.push(Triangle { corners: [p, q, r], material });
        self.triangles.push(Triangle { corners: [p, r, s], material });
    }

    /// Adds a box with the lowest corner `lo`, turned by `turn` radians about the vertical axis through `pivot`.
    pub fn block_turned(&mut self, lo: V3, size: V3, pivot: V3, turn: f32, material: u16) {
        let (x, y, z) = (v3(size.x, 0.0, 0.0), v3(0.0, size.y, 0.0), v3(0.0, 0.0, size.z));
        let faces = [(lo, x, y), (lo + z, x, y), (lo, z, y), (lo + x, z, y), (lo, x, z), (lo + y, x, z)];
        for (o, u, v) in faces {
            let place = |p: V3| pivot + (p - pivot).turned(turn);
            self.quad(place(o), u.turned(turn), v.turned(turn), material);
        }
    }

    /// Adds a box with the lowest corner `lo`.
    pub fn block(&mut self, lo: V3, size: V3, material: u16) {
        self.block_turned(lo, size, lo, 0.0, material);
    }

    /// Adds a smooth surface. `f` returns the point at (u, v), both from 0 to 1; normals are computed from differences
    /// of `f`.
    pub fn surface(&mut self, nu: usize, nv: usize, material: u16, f: impl Fn(f32, f32) -> V3) {
        let corner = |i: usize, j: usize| {
            let (u, v) = (i as f32 / nu as f32, j as f32 / nv as f32);
            let e = 1e-3;
            let (du, dv) = (f(u + e, v) - f(u - e, v), f(u, v + e) - f(u, v - e));
            Corner { at: f(u, v), normal: du.cross(dv).unit(), uv: [u, v] }
        };
        let grid: Vec<Corner> =
            (0..=nv).flat_map(|j| (0..=nu).map(move |i| (i, j))).map(|(i, j)| corner(i, j)).collect();
        for j in 0..nv {
            for i in 0..nu {
                let k = j * (nu + 1) + i;
                let (p, q, r, s) = (grid[k], grid[k + 1], grid[k + nu + 2], grid[k + nu + 1]);
                for corners in [[p, q, r], [p, r, s]] {
                    let area = (corners[1].at - corners[0].at).cross(corners[2].at - corners[0].at).length();
                    if area > 1e-12 {
                        self.triangles.push(Triangle { corners, material });
                    }
                }
            }
        }
    }

    /// Adds a solid of revolution about a vertical axis; `profile` lists (radius, height) from the bottom up, which are
    /// joined by a smooth curve.
    pub fn lathe(&mut self, foot: V3, profile: &[(f32, f32)], material: u16) {
        let at = |v: f32| {
            let n = profile.len() - 1;
            let s = v.clamp(0.0, 1.0) * n as f32;
            let i = (s as usize).min(n - 1);
            let t = s - i as f32;
            let p = |k: isize| profile[(i as isize + k).clamp(0, n as isize) as usize];
            let cubic = |a: f32, b: f32, c: f32, d: f32| {
                b + 0.5 * t * (c - a + t * (2.0 * a - 5.0 * b + 4.0 * c - d + t * (3.0 * (b - c) + d - a)))
            };
            let (a, b, c, d) = (p(-1), p(0), p(1), p(2));
            (cubic(a.0, b.0, c.0, d.0).max(1e-4), cubic(a.1, b.1, c.1, d.1))
        };
        self.surface(48, 6 * (profile.len() - 1), material, |u, v| {
            let ((r, h), a) = (at(v), -std::f32::consts::TAU * u);
            foot + v3(r * a.cos(), h, r * a.sin())
        });
    }

    /// Adds a soft box (superellipsoid) with the half sizes `half`; `power` is 1 for an ellipsoid and near 0 for a box.
    pub fn cushion(&mut self, centre: V3, half: V3, power: f32, turn: f32, material: u16) {
        let soft = |x: f32| x.signum() * x.abs().powf(power);
        let n = if half.length() > 0.08 { 40 } else { 14 };
        self.surface(n, n / 2, material, |u, v| {
            let (a, b) = (-std::f32::consts::TAU * u, std::f32::consts::PI * (v.clamp(0.002, 0.998) - 0.5));
            let p = v3(soft(b.cos()) * soft(a.cos()), soft(b.sin()), soft(b.cos()) * soft(a.sin()));
            centre + (p * half).turned(turn)
        });
    }

    /// Adds a round tube along the curve `path`, whose parameter runs from 0 to 1.
    pub fn tube(&mut self, rings: usize, radius: f32, material: u16, path: impl Fn(f32) -> V3) {
        self.surface(8, rings, material, |u, v| {
            let (t, b) = (path(v + 0.01) - path(v - 0.01)).unit().frame();
            let a = -std::f32::consts::TAU * u;
            path(v) + (t * a.cos() + b * a.sin()) * radius
        });
    }
}
