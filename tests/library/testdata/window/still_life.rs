//! Small things in the room: flowers, fruit, glass, plants, a cat on the window seat.

use super::furniture::TABLE;
use super::noise::unit;
use super::paint::{Finish, Paint};
use super::scene::{Builder, FRONT, LEFT, RIGHT, WINDOW};
use super::vec3::{V3, v3};

/// Adds the small things to the scene.
pub fn build(b: &mut Builder) {
    bouquet(b, TABLE + v3(0.02, 0.0, 0.10));
    fruit(b, TABLE + v3(-0.27, 0.0, -0.12));
    tea(b);
    sill(b);
    cat(b, v3(0.12, 0.475, 4.66));
    tall_plant(b, v3(LEFT + 0.42, 0.0, 4.35));
    on_the_chest(b);
}

fn bouquet(b: &mut Builder, at: V3) {
    let glaze = b.material(Paint::Pottery(v3(0.66, 0.62, 0.54), v3(0.05, 0.12, 0.30)), Finish::Coat(0.05));
    b.mesh.lathe(at, &[(0.05, 0.0), (0.085, 0.05), (0.10, 0.12), (0.075, 0.19), (0.042, 0.235), (0.055, 0.27)], glaze);
    let dyes =
        [v3(0.68, 0.05, 0.04), v3(0.80, 0.40, 0.04), v3(0.72, 0.16, 0.24), v3(0.82, 0.66, 0.20), v3(0.75, 0.70, 0.62)];
    for i in 0..17u32 {
        let a = i as f32 * 2.4;
        let reach = 0.05 + 0.17 * (i as f32 / 17.0).sqrt();
        let top = at + v3(reach * a.cos(), 0.66 - 0.9 * reach + 0.06 * unit(i, 1, 1), reach * a.sin());
        let neck = at + v3(0.02 * a.cos(), 0.25, 0.02 * a.sin());
        let stem = b.material(Paint::Leaf(v3(0.12, 0.25, 0.05), i), Finish::Matt);
        let bend = v3(0.0, 0.05, 0.0);
        b.mesh.tube(10, 0.0035, stem, |t| neck.mix(top, t) + bend * (4.0 * t * (1.0 - t)));
        let dye = dyes[(unit(i, 2, 2) * 5.0) as usize % 5];
        let axis = (top - neck).unit();
        let (side, other) = axis.frame();
        for p in 0..9u32 {
            // The petals form two rings around the end of the stem; each petal is a curved sheet.
            let ring = p % 2;
            let t = p as f32 * 0.698 + a;
            let out = side * t.cos() + other * t.sin();
            let across = axis.cross(out);
            let petal = b.material(Paint::Leaf(dye * (0.85 + 0.3 * unit(i, p, 4)), p), Finish::Sheet(0.4));
            let (long, wide) = (0.046 + 0.008 * ring as f32, 0.020);
            b.mesh.surface(4, 6, petal, |u, v| {
                let open = 0.35 + 0.5 * ring as f32;
                let width = wide * (v.clamp(0.0, 1.0) * std::f32::consts::PI * 0.93).sin().max(0.02).sqrt();
                top + out * (long * open * v * (1.0 + 0.5 * v))
                    + axis * (long * v * (1.05 - 0.3 * ring as f32))
                    + across * (width * (2.0 * u - 1.0))
                    + out * (-0.012 * (2.0 * u - 1.0).powi(2))
            });
        }
        let heart = b.material(Paint::Speckle(v3(0.20, 0.12, 0.02), 0.4), Finish::Matt);
        b.mesh.cushion(top + axis * 0.008, V3::ONE * 0.009, 1.0, 0.0, heart);
        if i % 2 == 0 {
            blade(
                b,
                neck + v3(0.0, -0.02, 0.0),
                v3((a + 1.0).cos(), 0.9, (a + 1.0).sin()).unit(),
                0.26,
                0.022,
                v3(0.16, 0.34, 0.07),
                i,
            );
        }
    }
}

/// Adds a leaf from `root` along `d` that droops towards its tip.
fn blade(b: &mut Builder, root: V3, d: V3, long: f32, wide: f32, c: V3, n: u32) {
    let m = b.material(Paint::Leaf(c, n), Finish::Sheet(0.4));
    let side = d.cross(v3(0.0, 1.0, 0.0)).unit();
    let lift = side.cross(d).unit();
    b.mesh.surface(4, 12, m, |u, v| {
        let width = wide * (v.clamp(0.0, 1.0) * 3.0).sin().max(0.015);
        let s = 2.0 * u - 1.0;
        root + d * (long * v) - v3(0.0, long * 0.45 * v * v, 0.0) + side * (width * s) + lift * (0.25 * width * s * s)
    });
}

fn fruit(b: &mut Builder, at: V3) {
    let bowl = b.material(Paint::Plain(v3(0.90, 0.86, 0.80)), Finish::Metal(0.06));
    b.mesh.lathe(
        at,
        &[
            (0.05, 0.0),
            (0.03, 0.015),
            (0.08, 0.03),
            (0.125, 0.055),
            (0.145, 0.085),
            (0.138, 0.084),
            (0.11, 0.055),
            (0.06, 0.036),
            (0.0, 0.032),
        ],
        bowl,
    );
    let skins = [
        v3(0.55, 0.06, 0.03),
        v3(0.75, 0.30, 0.03),
        v3(0.42, 0.48, 0.06),
        v3(0.62, 0.12, 0.05),
        v3(0.78, 0.34, 0.03),
        v3(0.70, 0.52, 0.06),
    ];
    for (i, (x, y, z)) in [
        (0.06, 0.088, 0.01),
        (-0.03, 0.088, 0.055),
        (-0.045, 0.088, -0.045),
        (0.035, 0.088, -0.065),
        (0.0, 0.142, -0.005),
        (-0.085, 0.10, 0.0),
    ]
    .into_iter()
    .enumerate()
    {
        let m = b.material(Paint::Speckle(skins[i], 0.3), Finish::Coat(0.18));
        b.mesh.cushion(at + v3(x, y, z), v3(0.041, 0.038, 0.041), 1.0, 0.0, m);
    }
}

/// Adds a cup, an open book and a glass globe.
fn tea(b: &mut Builder) {
    let china = b.material(Paint::Pottery(v3(0.80, 0.78, 0.72), v3(0.40, 0.06, 0.05)), Finish::Coat(0.04));
    let cup = TABLE + v3(0.12, 0.0, -0.30);
    b.mesh.lathe(cup, &[(0.03, 0.0), (0.05, 0.004), (0.075, 0.012), (0.078, 0.014)], china);
    b.mesh.lathe(
        cup + v3(0.0, 0.012, 0.0),
        &[(0.022, 0.0), (0.034, 0.02), (0.040, 0.045), (0.043, 0.062), (0.040, 0.062), (0.03, 0.02), (0.0, 0.012)],
        china,
    );
    b.mesh.tube(12, 0.004, china, |t| {
        let a = (t - 0.5) * 2.6;
        cup + v3(0.040 + 0.022 * a.cos(), 0.046 + 0.018 * a.sin(), 0.0)
    });
    let glass = b.material(Paint::Plain(v3(0.97, 0.985, 0.98)), Finish::Glass);
    b.mesh.cushion(TABLE + v3(0.34, 0.072, -0.12), V3::ONE * 0.07, 1.0, 0.0, glass);
    let page = b.material(Paint::Cloth(v3(0.78, 0.74, 0.64), v3(0.50, 0.46, 0.38), 2.0), Finish::Matt);
    let cover = b.material(Paint::Plain(v3(0.22, 0.05, 0.04)), Finish::Coat(0.3));
    let (o, turn) = (TABLE + v3(-0.09, 0.0, -0.36), 0.35);
    b.mesh.block_turned(o + v3(-0.15, 0.001, -0.10), v3(0.30, 0.004, 0.20), o, turn, cover);
    for s in [-1.0f32, 1.0] {
        b.mesh.surface(14, 6, page, |u, v| {
            o + v3(s * 0.142 * u, 0.008 + 0.022 * (u * 2.6).sin().max(0.0) * (1.0 - 0.5 * u), 0.19 * v - 0.095)
                .turned(turn)
        });
    }
}

/// Adds pots of herbs and coloured bottles on the window sill.
fn sill(b: &mut Builder) {
    let y = WINDOW[2];
    for (k, x) in [(0u32, -0.98), (1, 0.92)] {
        let pot = b.material(Paint::Speckle(v3(0.52, 0.21, 0.10), 0.25), Finish::Matt);
        let at = v3(x, y, FRONT + 0.02);
        b.mesh.lathe(
            at,
            &[(0.05, 0.0), (0.062, 0.06), (0.072, 0.105), (0.08, 0.106), (0.08, 0.13), (0.066, 0.128), (0.0, 0.11)],
            pot,
        );
        for i in 0..34u32 {
            let (a, lift) = (i as f32 * 2.4, 0.4 + 1.6 * unit(i, k, 5));
            let root = at + v3(0.03 * a.cos(), 0.12 + 0.10 * unit(i, k, 6), 0.03 * a.sin());
            blade(
                b,
                root,
                v3(a.cos(), lift, a.sin()).unit(),
                0.10 + 0.09 * unit(i, k, 7),
                0.020,
                v3(0.17, 0.38, 0.07),
                i,
            );
        }
    }
    let tints = [v3(0.30, 0.75, 0.42), v3(0.85, 0.42, 0.10), v3(0.25, 0.45, 0.85)];
    for (i, (x, s)) in [(-0.22, 1.0), (-0.09, 0.8), (0.62, 1.1)].into_iter().enumerate() {
        let glass = b.material(Paint::Plain(tints[i]), Finish::Glass);
        let h = |r: f32, y: f32| (r * s, y * s);
        b.mesh.lathe(
            v3(x, y + 0.001, FRONT + 0.01),
            &[
                h(0.001, 0.0),
                h(0.042, 0.004),
                h(0.045, 0.06),
                h(0.044, 0.14),
                h(0.018, 0.19),
                h(0.014, 0.24),
                h(0.019, 0.255),
                h(0.001, 0.256),
            ],
            glass,
        );
    }
}

/// Adds a tabby cat that sits and looks out of the window.
fn cat(b: &mut Builder, at: V3) {
    let fur = b.material(Paint::Speckle(v3(0.42, 0.20, 0.075), 0.55), Finish::Matt);
    let white = b.material(Paint::Speckle(v3(0.62, 0.54, 0.44), 0.3), Finish::Matt);
    b.mesh.lathe(
        at,
        &[(0.085, 0.0), (0.118, 0.045), (0.112, 0.12), (0.088, 0.20), (0.062, 0.26), (0.035, 0.30), (0.0, 0.31)],
        fur,
    );
    let head = at + v3(-0.012, 0.335, 0.015);
    b.mesh.cushion(head, v3(0.068, 0.058, 0.064), 1.0, 0.4, fur);
    b.mesh.cushion(head + v3(-0.035, -0.016, 0.052), v3(0.028, 0.022, 0.026), 1.0, 0.4, white);
    for s in [-1.0f32, 1.0] {
        b.mesh.lathe(head + v3(s * 0.040, 0.032, s * 0.010), &[(0.026, 0.0), (0.015, 0.028), (0.001, 0.056)], fur);
    }
    for s in [-1.0f32, 1.0] {
        b.mesh.cushion(at + v3(s * 0.075, 0.055, -0.03), v3(0.055, 0.065, 0.075), 1.0, 0.0, fur);
    }
    b.mesh.tube(24, 0.019, fur, |t| {
        at + v3(
            0.09 + 0.17 * t - 0.06 * t * t,
            0.022 + 0.01 * t - 0.30 * (t - 0.35).max(0.0).powi(2),
            -0.08 - 0.13 * (t * 2.2).sin(),
        )
    });
}

/// Adds a tall plant in the corner, with its leaves against the light.
fn tall_plant(b: &mut Builder, at: V3) {
    let weave = b.material(Paint::Weave(v3(0.50, 0.34, 0.17)), Finish::Matt);
    b.mesh.lathe(at, &[(0.15, 0.0), (0.175, 0.10), (0.185, 0.24), (0.17, 0.34), (0.155, 0.34), (0.0, 0.30)], weave);
    let bark = b.material(Paint::Speckle(v3(0.22, 0.15, 0.09), 0.3), Finish::Matt);
    for (k, (dx, dz, h)) in [(0.05, -0.06, 1.45), (0.16, 0.04, 1.05), (-0.10, -0.02, 1.25)].into_iter().enumerate() {
        let path = move |t: f32| at + v3(dx * t * t * 1.6, 0.3 + (h - 0.3) * t, dz * t * 1.5);
        b.mesh.tube(14, 0.011, bark, path);
        for i in 0..13u32 {
            let (t, a) = (0.32 + 0.68 * i as f32 / 12.0, i as f32 * 2.4 + k as f32);
            let d = v3(a.cos(), 0.55 + 0.5 * t, a.sin()).unit();
            blade(b, path(t), d, 0.30 + 0.08 * unit(i, k as u32, 3), 0.075, v3(0.11, 0.27, 0.055), i + 20 * k as u32);
        }
    }
}

fn on_the_chest(b: &mut Builder) {
    let (x, y) = (RIGHT - 0.25, 0.91);
    let brass = b.material(Paint::Plain(v3(0.85, 0.62, 0.28)), Finish::Metal(0.10));
    let globe = b.material(Paint::Picture(4), Finish::Coat(0.06));
    let wood = b.material(Paint::Wood(v3(0.24, 0.12, 0.06), 1), Finish::Coat(0.1));
    b.mesh.lathe(v3(x, y, 3.1), &[(0.09, 0.0), (0.085, 0.02), (0.02, 0.035), (0.015, 0.08), (0.03, 0.10)], wood);
    b.mesh.cushion(v3(x, y + 0.235, 3.1), V3::ONE * 0.135, 1.0, 0.5, globe);
    b.mesh.tube(40, 0.006, brass, |t| {
        let a = t * std::f32::consts::TAU;
        v3(x, y + 0.235, 3.1) + v3(0.15 * a.cos() * 0.6, 0.15 * a.sin(), 0.15 * a.cos() * 0.8)
    });
    for (z, h) in [(3.55, 0.24), (3.70, 0.17)] {
        b.mesh.lathe(
            v3(x, y, z),
            &[
                (0.05, 0.0),
                (0.045, 0.012),
                (0.012, 0.03),
                (0.014, h * 0.5),
                (0.010, h - 0.03),
                (0.03, h - 0.012),
                (0.026, h),
            ],
            brass,
        );
        let wax = b.plain(0.78, 0.72, 0.58);
        b.mesh.lathe(v3(x, y + h, z), &[(0.011, 0.0), (0.011, 0.12), (0.009, 0.14), (0.0, 0.141)], wax);
    }
}
