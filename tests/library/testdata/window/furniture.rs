//! The furniture of the room: the carpet, shelves of books, an armchair, a window seat, a table, a chest, pictures.

use super::noise::unit;
use super::paint::{Finish, Paint};
use super::scene::{Builder, FRONT, LEFT, RIGHT};
use super::vec3::{V3, v3};

/// The middle of the top of the round table, in metres.
pub const TABLE: V3 = v3(0.88, 0.75, 2.75);

/// Adds the furniture to the scene.
pub fn build(b: &mut Builder) {
    let rug = b.material(Paint::Rug, Finish::Matt);
    b.mesh.block(v3(-1.35, 0.0, 1.5), v3(2.9, 0.012, 2.45), rug);
    bookcase(b);
    armchair(b, v3(-1.5, 0.0, 2.75), 0.75);
    seat(b);
    table(b);
    chest(b);
    pictures(b);
}

/// Adds a row of books from `x` to `end` on a board at `y`, with their spines at `z`.
fn books(b: &mut Builder, x: f32, end: f32, y: f32, z: f32, tall: f32, seed: u32) {
    let dyes = [
        v3(0.30, 0.045, 0.035),
        v3(0.05, 0.11, 0.22),
        v3(0.06, 0.15, 0.08),
        v3(0.42, 0.28, 0.12),
        v3(0.16, 0.08, 0.045),
        v3(0.60, 0.53, 0.40),
        v3(0.03, 0.03, 0.035),
        v3(0.46, 0.16, 0.05),
        v3(0.13, 0.22, 0.24),
        v3(0.28, 0.10, 0.17),
    ];
    let (mut x, mut k) = (x, 0);
    let mut run = 0;
    let mut look = (0.0, 0.0, V3::ZERO);
    loop {
        // The volumes of a set, up to five, look alike.
        if run == 0 {
            run = 1 + (unit(seed, k, 1) * 4.5) as u32 * u32::from(unit(seed, k, 2) < 0.45);
            let dye = dyes[(unit(seed, k, 3) * 10.0) as usize % 10];
            look = (0.018 + 0.034 * unit(seed, k, 4), tall * (0.68 + 0.30 * unit(seed, k, 5)), dye);
        }
        run -= 1;
        let (w, h, dye) = look;
        if x + w > end {
            return;
        }
        let gap = unit(seed, k, 6) < 0.04;
        if !gap {
            let m = b.material(Paint::Book(dye, seed * 100 + k - run), Finish::Coat(0.3));
            let lean = if unit(seed, k, 7) < 0.08 { 0.05 } else { 0.0 };
            let back = 0.012 * unit(seed, k, 8);
            b.mesh.block_turned(v3(x, y, z + back), v3(w - 0.0015, h, 0.17), v3(x, y, z), lean, m);
        }
        x += w + if gap { 0.03 } else { 0.0 };
        k += 1;
    }
}

fn bookcase(b: &mut Builder) {
    let wood = b.material(Paint::Wood(v3(0.22, 0.115, 0.055), 1), Finish::Coat(0.2));
    let board = b.material(Paint::Wood(v3(0.22, 0.115, 0.055), 0), Finish::Coat(0.2));
    let (x0, x1, z0, top) = (1.60, RIGHT - 0.05, FRONT - 0.30, 2.30);
    for x in [x0, x1 - 0.03] {
        b.mesh.block(v3(x, 0.0, z0), v3(0.03, top, 0.30), wood);
    }
    b.mesh.block(v3(x0, 0.0, FRONT - 0.02), v3(x1 - x0, top, 0.02), wood);
    b.mesh.block(v3(x0 - 0.03, top, z0 - 0.03), v3(x1 - x0 + 0.06, 0.04, 0.33), board);
    for (i, y) in [0.08, 0.50, 0.88, 1.24, 1.59, 1.93].into_iter().enumerate() {
        b.mesh.block(v3(x0, y, z0 + 0.006), v3(x1 - x0, 0.024, 0.29), board);
        let room = [0.37, 0.33, 0.31, 0.30, 0.29, 0.30][i];
        let (from, to) = match i {
            2 => (x0 + 0.25, x1 - 0.03),
            4 => (x0 + 0.03, x1 - 0.32),
            0 => (x0 + 0.42, x1 - 0.06),
            _ => (x0 + 0.03, x1 - 0.03),
        };
        books(b, from, to, y + 0.024, z0 + 0.04, room * 0.92, i as u32 + 1);
    }
    let glaze = b.material(Paint::Pottery(v3(0.10, 0.22, 0.34), v3(0.70, 0.66, 0.55)), Finish::Coat(0.06));
    b.mesh.lathe(
        v3(x0 + 0.14, 0.904, FRONT - 0.17),
        &[(0.04, 0.0), (0.075, 0.05), (0.085, 0.11), (0.05, 0.17), (0.03, 0.2), (0.045, 0.23)],
        glaze,
    );
    let brass = b.material(Paint::Plain(v3(0.80, 0.58, 0.25)), Finish::Metal(0.15));
    b.mesh.cushion(v3(x1 - 0.18, 1.614 + 0.115, FRONT - 0.17), V3::ONE * 0.085, 1.0, 0.0, glaze);
    b.mesh.lathe(
        v3(x1 - 0.18, 1.614, FRONT - 0.17),
        &[(0.06, 0.0), (0.05, 0.012), (0.012, 0.02), (0.010, 0.035)],
        brass,
    );
    // A basket and books on top.
    let weave = b.material(Paint::Weave(v3(0.42, 0.27, 0.12)), Finish::Matt);
    b.mesh.lathe(
        v3(x0 + 0.30, top + 0.04, FRONT - 0.18),
        &[(0.11, 0.0), (0.13, 0.06), (0.14, 0.13), (0.135, 0.17)],
        weave,
    );
    books(b, x0 + 0.55, x0 + 0.90, top + 0.04, z0 + 0.05, 0.22, 19);
}

/// Adds a wing chair with a cushion and a throw; before it is turned by `turn` radians, it faces -z.
fn armchair(b: &mut Builder, at: V3, turn: f32) {
    let cloth = b.material(Paint::Cloth(v3(0.13, 0.20, 0.22), v3(0.30, 0.33, 0.27), 30.0), Finish::Matt);
    let linen = b.material(Paint::Cloth(v3(0.62, 0.30, 0.10), v3(0.70, 0.60, 0.40), 11.0), Finish::Matt);
    let wool = b.material(Paint::Cloth(v3(0.60, 0.54, 0.42), v3(0.36, 0.07, 0.05), 5.0), Finish::Matt);
    let wood = b.material(Paint::Wood(v3(0.18, 0.09, 0.045), 1), Finish::Coat(0.15));
    let place = |x: f32, y: f32, z: f32| at + v3(x, y, z).turned(turn);
    let mut soft = |x: f32, y: f32, z: f32, hx: f32, hy: f32, hz: f32, power: f32, m: u16| {
        b.mesh.cushion(place(x, y, z), v3(hx, hy, hz), power, turn, m);
    };
    soft(0.0, 0.27, 0.0, 0.36, 0.11, 0.36, 0.30, cloth);
    soft(0.0, 0.43, -0.03, 0.30, 0.09, 0.33, 0.42, cloth);
    soft(0.0, 0.74, 0.33, 0.36, 0.42, 0.10, 0.36, cloth);
    for s in [-1.0, 1.0] {
        soft(s * 0.37, 0.44, -0.02, 0.085, 0.22, 0.37, 0.36, cloth);
        soft(s * 0.37, 0.64, -0.04, 0.10, 0.05, 0.38, 0.6, cloth);
        soft(s * 0.36, 0.90, 0.24, 0.06, 0.22, 0.17, 0.5, cloth);
    }
    soft(0.05, 0.66, 0.17, 0.21, 0.20, 0.085, 0.55, linen);
    soft(0.37, 0.685, -0.08, 0.125, 0.03, 0.20, 0.5, wool);
    soft(0.475, 0.50, -0.08, 0.018, 0.20, 0.20, 0.4, wool);
    for (x, z) in [(-0.32, -0.32), (0.32, -0.32), (-0.32, 0.32), (0.32, 0.32)] {
        b.mesh.lathe(place(x, 0.0, z), &[(0.018, 0.0), (0.028, 0.08), (0.035, 0.18)], wood);
    }
}

/// Adds the bench under the window. It is open below, which is the darkest place of the scene.
fn seat(b: &mut Builder) {
    let wood = b.material(Paint::Wood(v3(0.30, 0.165, 0.08), 0), Finish::Coat(0.15));
    let leg = b.material(Paint::Wood(v3(0.30, 0.165, 0.08), 1), Finish::Coat(0.15));
    let pad = b.material(Paint::Cloth(v3(0.55, 0.49, 0.38), v3(0.12, 0.18, 0.30), 26.0), Finish::Matt);
    b.mesh.block(v3(-1.2, 0.38, 4.42), v3(2.2, 0.035, 0.45), wood);
    b.mesh.block(v3(-1.15, 0.30, 4.46), v3(2.1, 0.08, 0.03), wood);
    for (x, z) in [(-1.17, 4.45), (0.91, 4.45), (-1.17, 4.78), (0.91, 4.78), (-0.13, 4.45)] {
        b.mesh.block(v3(x, 0.0, z), v3(0.06, 0.38, 0.06), leg);
    }
    b.mesh.cushion(v3(-0.1, 0.445, 4.64), v3(1.08, 0.035, 0.22), 0.25, 0.0, pad);
    let dyes = [
        (v3(0.42, 0.06, 0.05), v3(0.66, 0.56, 0.38)),
        (v3(0.10, 0.20, 0.30), v3(0.60, 0.58, 0.50)),
        (v3(0.60, 0.38, 0.08), v3(0.26, 0.08, 0.04)),
    ];
    for (i, (x, turn)) in [(-0.98, 0.25), (-0.64, -0.2), (0.74, -0.3)].into_iter().enumerate() {
        let m = b.material(Paint::Cloth(dyes[i].0, dyes[i].1, 7.0), Finish::Matt);
        b.mesh.cushion(v3(x, 0.64, 4.76), v3(0.19, 0.18, 0.07), 0.55, turn, m);
    }
    // Two baskets below the bench.
    let weave = b.material(Paint::Weave(v3(0.46, 0.30, 0.14)), Finish::Matt);
    for x in [-0.75, 0.42] {
        b.mesh.lathe(v3(x, 0.0, 4.66), &[(0.13, 0.0), (0.16, 0.06), (0.175, 0.15), (0.165, 0.24)], weave);
    }
}

fn table(b: &mut Builder) {
    let wood = b.material(Paint::Wood(v3(0.40, 0.20, 0.09), 0), Finish::Coat(0.06));
    let leg = b.material(Paint::Wood(v3(0.30, 0.14, 0.065), 1), Finish::Coat(0.12));
    let r = 0.52;
    let foot = v3(TABLE.x, 0.0, TABLE.z);
    b.mesh.lathe(
        foot,
        &[
            (r - 0.03, TABLE.y - 0.035),
            (r, TABLE.y - 0.018),
            (r - 0.012, TABLE.y - 0.001),
            (0.30, TABLE.y),
            (0.0, TABLE.y),
        ],
        wood,
    );
    b.mesh.lathe(
        foot,
        &[
            (0.05, 0.10),
            (0.075, 0.18),
            (0.045, 0.26),
            (0.065, 0.38),
            (0.10, 0.46),
            (0.05, 0.56),
            (0.06, 0.64),
            (0.14, 0.715),
            (0.40, 0.72),
        ],
        leg,
    );
    for i in 0..3 {
        let a = 0.5 + i as f32 * std::f32::consts::TAU / 3.0;
        b.mesh.tube(14, 0.028, leg, |t| {
            foot + v3(a.cos(), 0.0, a.sin()) * (0.04 + 0.36 * t)
                + v3(0.0, 0.17 - 0.15 * t * t + 0.03 * (t * 9.0).sin() * (1.0 - t), 0.0)
        });
    }
}

/// Adds a chest of drawers against the right wall.
fn chest(b: &mut Builder) {
    let wood = b.material(Paint::Wood(v3(0.34, 0.17, 0.075), 2), Finish::Coat(0.10));
    let dark = b.material(Paint::Wood(v3(0.20, 0.10, 0.05), 2), Finish::Coat(0.15));
    let brass = b.material(Paint::Plain(v3(0.80, 0.58, 0.25)), Finish::Metal(0.15));
    let (x, z0, z1) = (RIGHT - 0.48, 2.75, 3.95);
    b.mesh.block(v3(x, 0.08, z0), v3(0.46, 0.80, z1 - z0), dark);
    b.mesh.block(v3(x - 0.03, 0.88, z0 - 0.03), v3(0.50, 0.03, z1 - z0 + 0.06), wood);
    for (i, y) in [0.11, 0.37, 0.63].into_iter().enumerate() {
        for k in 0..2 {
            let z = z0 + 0.03 + 0.58 * k as f32;
            b.mesh.block(v3(x - 0.014, y, z), v3(0.02, 0.235, 0.55), wood);
            for q in [0.14, 0.41] {
                b.mesh.cushion(v3(x - 0.03, y + 0.12 + 0.001 * i as f32, z + q), V3::ONE * 0.017, 1.0, 0.0, brass);
            }
        }
    }
}

/// Adds a framed picture with its middle at `at`; `right` is the unit vector to the right for a viewer who looks at it.
fn framed(b: &mut Builder, at: V3, right: V3, w: f32, h: f32, n: u32, gilt: bool) {
    let up = v3(0.0, 1.0, 0.0);
    let out = up.cross(right) * -1.0;
    let out = if out.dot(at - v3(0.0, at.y, 1.0)) > 0.0 { -out } else { out };
    let rim = if gilt {
        b.material(Paint::Speckle(v3(0.52, 0.34, 0.11), 0.25), Finish::Coat(0.2))
    } else {
        b.material(Paint::Speckle(v3(0.06, 0.04, 0.03), 0.2), Finish::Coat(0.1))
    };
    let mount = b.material(Paint::Speckle(v3(0.74, 0.70, 0.60), 0.05), Finish::Matt);
    let art = b.material(Paint::Picture(n), Finish::Matt);
    let mut sheet = |w: f32, h: f32, lift: f32, m: u16| {
        b.mesh.quad(at + out * lift - right * (w / 2.0) - up * (h / 2.0), right * w, up * h, m);
    };
    sheet(w, h, 0.012, mount);
    let inset = if gilt { 0.0 } else { 0.10 };
    sheet(w * (1.0 - inset) - 0.02, h * (1.0 - inset) - 0.02, 0.014, art);
    let bar = 0.04;
    for (c, hr, hu) in [
        (up * (h / 2.0), w / 2.0 + bar / 2.0, bar / 2.0),
        (up * (-h / 2.0), w / 2.0 + bar / 2.0, bar / 2.0),
        (right * (w / 2.0), bar / 2.0, h / 2.0 + bar / 2.0),
        (right * (-w / 2.0), bar / 2.0, h / 2.0 + bar / 2.0),
    ] {
        let half = v3((right * hr).x.abs() + out.x.abs() * 0.014, hu, (right * hr).z.abs() + out.z.abs() * 0.014);
        b.mesh.block(at + c + out * 0.014 - half, half * 2.0, rim);
    }
}

fn pictures(b: &mut Builder) {
    let (z, x) = (v3(0.0, 0.0, 1.0), v3(1.0, 0.0, 0.0));
    let wall = LEFT + 0.002;
    framed(b, v3(wall, 1.72, 2.55), z, 0.78, 0.60, 0, true);
    framed(b, v3(wall, 1.92, 3.40), z, 0.42, 0.52, 2, false);
    framed(b, v3(wall, 1.33, 3.40), z, 0.40, 0.34, 4, false);
    framed(b, v3(wall, 1.66, 4.15), z, 0.60, 0.76, 3, true);
    framed(b, v3(wall, 1.62, 1.55), z, 0.60, 0.74, 1, false);
    framed(b, v3(LEFT + 0.30, 1.86, FRONT - 0.002), x, 0.34, 0.44, 5, false);
    let wall = RIGHT - 0.002;
    framed(b, v3(wall, 1.75, 3.55), -z, 0.72, 0.66, 1, true);
    framed(b, v3(wall, 1.62, 2.66), -z, 0.52, 0.66, 3, false);
}
