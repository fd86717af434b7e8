//! The room itself: floor, plastered walls, panelling, beams, the window with its bars and curtains.

use super::noise::{fbm, unit};
use super::paint::{Finish, Paint};
use super::scene::{BACK, Builder, CEILING, FRONT, LEFT, OUTSIDE, RIGHT, WINDOW};
use super::vec3::{V3, v3};

/// Adds the room to the scene.
pub fn build(b: &mut Builder) {
    shell(b);
    panelling(b);
    window(b);
    curtains(b);
}

fn shell(b: &mut Builder) {
    let wall = b.material(Paint::Plaster(v3(0.70, 0.60, 0.45)), Finish::Matt);
    let sage = b.material(Paint::Plaster(v3(0.40, 0.46, 0.38)), Finish::Matt);
    let white = b.material(Paint::Plaster(v3(0.80, 0.77, 0.70)), Finish::Matt);
    let floor = b.material(Paint::Planks(0.135), Finish::Coat(0.11));
    let beam = b.material(Paint::Wood(v3(0.20, 0.115, 0.06), 2), Finish::Matt);
    let (wide, deep) = (RIGHT - LEFT, FRONT - BACK);
    let (x, y, z) = (v3(wide, 0.0, 0.0), v3(0.0, CEILING, 0.0), v3(0.0, 0.0, deep));
    let corner = v3(LEFT, 0.0, BACK);
    b.mesh.quad(corner, z, x, floor);
    b.mesh.quad(corner + y, x, z, white);
    b.mesh.quad(corner, y, z, wall);
    b.mesh.quad(corner + x, z, y, wall);
    b.mesh.quad(corner, x, y, wall);
    let [x0, x1, y0, y1] = WINDOW;
    let mut panel = |xa: f32, xb: f32, ya: f32, yb: f32| {
        b.mesh.quad(v3(xa, ya, FRONT), v3(0.0, yb - ya, 0.0), v3(xb - xa, 0.0, 0.0), sage);
    };
    panel(LEFT, x0, 0.0, CEILING);
    panel(x1, RIGHT, 0.0, CEILING);
    panel(x0, x1, 0.0, y0);
    panel(x0, x1, y1, CEILING);
    // The reveal of the window extends a little beyond the plane outside, so that no light enters around the edge.
    let depth = v3(0.0, 0.0, OUTSIDE - FRONT + 0.02);
    for (o, side) in [
        (v3(x0, y0, FRONT), v3(0.0, y1 - y0, 0.0)),
        (v3(x1, y0, FRONT), v3(0.0, y1 - y0, 0.0)),
        (v3(x0, y0, FRONT), v3(x1 - x0, 0.0, 0.0)),
        (v3(x0, y1, FRONT), v3(x1 - x0, 0.0, 0.0)),
    ] {
        b.mesh.quad(o, depth, side, white);
    }
    for x in [-2.0, -0.72, 0.56, 1.84] {
        b.mesh.block(v3(x - 0.07, CEILING - 0.15, BACK), v3(0.14, 0.15, deep), beam);
    }
}

/// Adds painted boards on the side walls, up to the height of a chair's back, and skirting boards on all walls.
fn panelling(b: &mut Builder) {
    let rail = b.material(Paint::Speckle(v3(0.20, 0.27, 0.26), 0.10), Finish::Coat(0.3));
    for k in 0..60 {
        let z = BACK + 0.118 * k as f32;
        if z > FRONT - 0.1 {
            break;
        }
        let tone = 0.9 + 0.2 * unit(k, 1, 2);
        let board = b.material(Paint::Speckle(v3(0.22, 0.30, 0.285) * tone, 0.12), Finish::Coat(0.3));
        b.mesh.block(v3(LEFT, 0.12, z), v3(0.018, 0.82, 0.110), board);
        b.mesh.block(v3(RIGHT - 0.018, 0.12, z), v3(0.018, 0.82, 0.110), board);
    }
    let deep = FRONT - BACK;
    for (y, h, d) in [(0.0, 0.13, 0.03), (0.93, 0.05, 0.045)] {
        b.mesh.block(v3(LEFT, y, BACK), v3(d, h, deep), rail);
        b.mesh.block(v3(RIGHT - d, y, BACK), v3(d, h, deep), rail);
    }
    b.mesh.block(v3(LEFT, 0.0, FRONT - 0.03), v3(RIGHT - LEFT, 0.13, 0.03), rail);
}

fn window(b: &mut Builder) {
    let paint = b.material(Paint::Speckle(v3(0.74, 0.72, 0.66), 0.06), Finish::Coat(0.25));
    let board = b.material(Paint::Wood(v3(0.46, 0.27, 0.13), 0), Finish::Coat(0.12));
    let brass = b.material(Paint::Plain(v3(0.80, 0.58, 0.25)), Finish::Metal(0.2));
    let [x0, x1, y0, y1] = WINDOW;
    let z = 5.14;
    let mut bar = |xa: f32, xb: f32, ya: f32, yb: f32, d: f32| {
        b.mesh.block(v3(xa, ya, z - d / 2.0), v3(xb - xa, yb - ya, d), paint);
    };
    let f = 0.055;
    bar(x0, x1, y0, y0 + f, 0.08);
    bar(x0, x1, y1 - f, y1, 0.08);
    bar(x0, x0 + f, y0, y1, 0.08);
    bar(x1 - f, x1, y0, y1, 0.08);
    // Three casements, each with glazing bars, and a thicker transom across the top third.
    let transom = 1.90;
    bar(x0, x1, transom - 0.028, transom + 0.028, 0.075);
    let third = (x1 - x0) / 3.0;
    for i in 1..3 {
        let x = x0 + third * i as f32;
        bar(x - 0.036, x + 0.036, y0, y1, 0.075);
    }
    for i in 0..3 {
        let x = x0 + third * (i as f32 + 0.5);
        bar(x - 0.011, x + 0.011, y0, y1, 0.035);
    }
    let y = (y0 + transom) / 2.0;
    bar(x0, x1, y - 0.011, y + 0.011, 0.035);
    b.mesh.block(v3(x0 - 0.10, y0 - 0.035, FRONT - 0.13), v3(x1 - x0 + 0.20, 0.035, 0.37), board);
    for i in 1..3 {
        let x = x0 + third * i as f32 + 0.012;
        b.mesh.tube(6, 0.008, brass, |t| v3(x, 1.15 + 0.12 * t, z - 0.06));
    }
}

fn curtains(b: &mut Builder) {
    let cloth = b.material(Paint::Cloth(v3(0.62, 0.40, 0.24), v3(0.42, 0.13, 0.07), 9.0), Finish::Sheet(0.32));
    let pole = b.material(Paint::Wood(v3(0.25, 0.13, 0.06), 0), Finish::Coat(0.15));
    let brass = b.material(Paint::Plain(v3(0.80, 0.58, 0.25)), Finish::Metal(0.2));
    let [x0, x1, _, _] = WINDOW;
    let top = 2.56;
    b.mesh.tube(8, 0.018, pole, |t| v3(x0 - 0.42 + (x1 - x0 + 0.62) * t, top + 0.02, FRONT - 0.14));
    for x in [x0 - 0.44, x1 + 0.22] {
        b.mesh.cushion(v3(x, top + 0.02, FRONT - 0.14), V3::ONE * 0.036, 1.0, 0.0, brass);
    }
    for (from, to, seed, tied) in [(x0 - 0.36, x0 + 0.42, 3.0, -0.02), (x1 - 0.22, x1 + 0.13, 8.0, 0.08)] {
        b.mesh.surface(220, 60, cloth, |u, v| {
            let y = top - (top - 0.06) * v;
            // The curtain is gathered at the tie, a third of the way up; the folds fan out from there.
            let waist = (-((y - 1.05) / 0.42).powi(2)).exp();
            let (middle, half) = ((from + to) / 2.0 + (tied - 0.12) * waist, (to - from) / 2.0 * (1.0 - 0.52 * waist));
            let fold = (u * 40.0 + 1.6 * fbm(u * 4.0, v * 1.5, seed, 2)).sin();
            let deep = 0.032 * (1.0 - 0.4 * waist) * (0.5 + fbm(u * 7.0, v * 2.0, seed, 2));
            v3(middle + half * (2.0 * u - 1.0) + 0.012 * (u * 80.0).cos(), y, FRONT - 0.13 + deep * fold)
        });
        let middle = (from + to) / 2.0 + tied - 0.12;
        b.mesh.cushion(v3(middle, 1.05, FRONT - 0.13), v3((to - from) * 0.27, 0.035, 0.055), 0.7, 0.0, brass);
    }
}
