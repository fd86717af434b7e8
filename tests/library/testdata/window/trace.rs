//! The path tracer: a view in, layers of radiance (cd/m2) out.
//!
//! Light comes in through the window only, so each diffuse point asks the window (as a portal) for skylight and the
//! sun for sunlight. What a pixel sees is kept in layers, each of which the denoiser can treat as it deserves: what is
//! seen directly or in a mirror, the sun's light, and the light of sky and walls; the last two without the texture.

use rayon::prelude::*;

use super::bvh::Hit;
use super::noise::Sampler;
use super::outdoors;
use super::paint::Finish;
use super::scene::{OUTSIDE, Scene, WINDOW, camera_ray};
use super::vec3::{V3, v3};

/// Diffuse bounces that are followed at most.
const BOUNCES: usize = 7;

/// A rectangle of the reference frame's plane, in its pixels, and how finely to look at it.
#[derive(Clone, Copy)]
pub struct View {
    /// The outer corner of the first pixel, in the frame's pixel coordinates.
    pub left: f64,
    pub top: f64,
    /// Picture pixels for each frame pixel.
    pub scale: f64,
    pub width: usize,
    pub height: usize,
    pub samples: u32,
}

/// What one pixel holds after all its samples.
#[derive(Clone, Copy, Default)]
pub struct Pixel {
    /// Seen straight through the window: exact but for its edges.
    pub direct: V3,
    /// Seen in a coat, a metal, through glass.
    pub mirror: V3,
    /// Mean reflectance of the matt part.
    pub albedo: V3,
    /// Sunlight over the albedo, and all other light over the albedo.
    pub sun: V3,
    pub rest: V3,
    /// Variances of the means of the luminances of `rest` and of `mirror`.
    pub rest_variance: f32,
    pub mirror_variance: f32,
    pub normal: V3,
    pub depth: f32,
    /// The first surface's material; `u16::MAX` outdoors.
    pub material: u16,
    /// Did its samples meet more than one material? Then it is an edge.
    pub mixed: bool,
}

/// Where a path is, on what.
struct Point {
    at: V3,
    /// Unit shading normal on the viewer's side.
    normal: V3,
    colour: V3,
    finish: Finish,
    material: u16,
}

/// One sample of a pixel, in the same layers.
#[derive(Default)]
struct Sample {
    direct: V3,
    mirror: V3,
    albedo: V3,
    sun: V3,
    rest: V3,
    first: Option<(V3, f32, u16)>,
}

/// Renders `view`, row by row; each pixel depends only on its own number.
pub fn render(scene: &Scene, view: View) -> Vec<Pixel> {
    (0..view.height).into_par_iter().flat_map_iter(|y| (0..view.width).map(move |x| pixel(scene, view, x, y))).collect()
}

fn pixel(scene: &Scene, view: View, x: usize, y: usize) -> Pixel {
    let mut sums = Pixel { material: u16::MAX, ..Pixel::default() };
    let (mut rest_lit, mut rest2, mut mirror2, mut seen) = (V3::ZERO, 0.0f32, 0.0f32, 0u32);
    let mut sun_lit = V3::ZERO;
    let mut taken = 0;
    while taken < view.samples {
        let mut s = Sampler::new((y * view.width + x) as u32, taken);
        let (jx, jy) = (f64::from(s.draw()), f64::from(s.draw()));
        let (fx, fy) = (view.left + (x as f64 + jx) / view.scale - 0.5, view.top + (y as f64 + jy) / view.scale - 0.5);
        let (o, d) = camera_ray(fx, fy);
        let one = sample(scene, o, d, &mut s);
        taken += 1;
        sums.direct += one.direct;
        sums.mirror += one.mirror;
        mirror2 += one.mirror.luminance().powi(2);
        sums.albedo += one.albedo;
        sun_lit += one.albedo * one.sun;
        rest_lit += one.albedo * one.rest;
        rest2 += one.rest.luminance().powi(2);
        sums.rest += one.rest;
        if let Some((normal, depth, material)) = one.first {
            // The first sample's surface stands for the pixel: a mean of two surfaces' normals is like neither.
            if seen == 0 {
                (sums.normal, sums.depth, sums.material) = (normal, depth, material);
            }
            sums.mixed |= material != sums.material;
            seen += 1;
        }
        // The view through the window has no noise but its own detail.
        if taken == 12 && seen == 0 {
            break;
        }
    }
    let n = taken as f32;
    let over = |a: V3, b: V3| {
        let r = |x: f32, y: f32| if y > 1e-6 { x / y } else { 0.0 };
        v3(r(a.x, b.x), r(a.y, b.y), r(a.z, b.z))
    };
    sums.rest_variance = ((rest2 / n - (sums.rest.luminance() / n).powi(2)) / n).max(0.0);
    sums.mirror_variance = ((mirror2 / n - (sums.mirror.luminance() / n).powi(2)) / n).max(0.0);
    sums.sun = over(sun_lit, sums.albedo);
    sums.rest = over(rest_lit, sums.albedo);
    sums.direct = sums.direct / n;
    sums.mirror = sums.mirror / n;
    sums.albedo = sums.albedo / n;
    sums
}

fn point(scene: &Scene, o: V3, d: V3, hit: Hit, exact: bool) -> Point {
    let t = &scene.bvh.triangles[hit.triangle as usize];
    let [a, b, c] = t.corners;
    let w = 1.0 - hit.u - hit.v;
    let uv = |i: usize| a.uv[i] * w + b.uv[i] * hit.u + c.uv[i] * hit.v;
    let at = o + d * hit.t;
    let flat = (b.at - a.at).cross(c.at - a.at).unit();
    let flat = if flat.dot(d) > 0.0 { -flat } else { flat };
    let smooth = (a.normal * w + b.normal * hit.u + c.normal * hit.v).unit();
    let smooth = if smooth.dot(flat) < 0.0 { -smooth } else { smooth };
    let normal = if smooth.dot(d) < 0.0 { smooth } else { flat };
    let m = &scene.materials[t.material as usize];
    let colour = if exact { m.paint.colour(at, [uv(0), uv(1)]) } else { m.paint.mean() };
    let colour = colour.max(V3::ZERO).min(V3::ONE * 0.95);
    Point { at, normal, colour, finish: m.finish, material: t.material }
}

/// Follows mirrors and glass until something matt or the outdoors.
fn sample(scene: &Scene, mut o: V3, mut d: V3, s: &mut Sampler) -> Sample {
    let mut out = Sample::default();
    let mut weight = V3::ONE;
    let mut mirrored = false;
    for _ in 0..12 {
        let Some(hit) = scene.bvh.nearest(o, d, 1e9, |_| true) else {
            let seen = outdoors::radiance(d) * weight;
            if mirrored {
                out.mirror += seen
            } else {
                out.direct += seen
            }
            return out;
        };
        let p = point(scene, o, d, hit, true);
        if out.first.is_none() {
            out.first = Some((p.normal, hit.t, p.material));
        }
        let cos = -p.normal.dot(d);
        let bounce = d + p.normal * (2.0 * cos);
        match p.finish {
            Finish::Metal(rough) => {
                out.mirror += weight * p.colour * glint(scene, &p, d, rough, s);
                weight = weight * p.colour;
                d = above(s.cone(bounce.unit(), rough), p.normal);
            }
            Finish::Glass => {
                // Entering or leaving is reported by which way the mesh's own normal points; bodies are closed.
                let t = &scene.bvh.triangles[hit.triangle as usize];
                let [a, b, c] = t.corners;
                let outward = a.normal * (1.0 - hit.u - hit.v) + b.normal * hit.u + c.normal * hit.v;
                let eta = if outward.dot(d) < 0.0 { 1.0 / 1.5 } else { 1.5 };
                let k = 1.0 - eta * eta * (1.0 - cos * cos);
                let f = if k <= 0.0 { 1.0 } else { fresnel(if eta > 1.0 { k.sqrt() } else { cos }) };
                if s.draw() < f {
                    d = bounce.unit();
                } else {
                    d = (d * eta + p.normal * (eta * cos - k.sqrt())).unit();
                    weight = weight * p.colour;
                }
            }
            Finish::Coat(rough) if !mirrored => {
                let f = fresnel(cos);
                let share = (f / (f + 0.35 * (1.0 - f))).clamp(0.15, 0.85);
                out.mirror += weight * glint(scene, &p, d, rough, s) * f;
                if s.draw() < share {
                    // What is matt is still there for the denoiser's sake, unlit by this sample.
                    out.albedo = p.colour;
                    weight = weight * (f / share);
                    d = above(s.cone(bounce.unit(), rough), p.normal);
                } else {
                    let (sun, rest) = gather(scene, &p, s);
                    let k = (1.0 - f) / (1.0 - share);
                    out.albedo = p.colour;
                    (out.sun, out.rest) = (sun * k, rest * k);
                    return out;
                }
            }
            _ => {
                let (sun, rest) = gather(scene, &p, s);
                if mirrored {
                    out.mirror += weight * p.colour * (sun + rest);
                } else {
                    out.albedo = p.colour;
                    (out.sun, out.rest) = (sun, rest);
                }
                return out;
            }
        }
        mirrored = true;
        o = p.at;
    }
    out
}

/// Schlick's reflectance of glass or varnish.
fn fresnel(cos: f32) -> f32 {
    0.04 + 0.96 * (1.0 - cos.clamp(0.0, 1.0)).powi(5)
}

fn above(d: V3, n: V3) -> V3 {
    let k = d.dot(n);
    if k > 0.01 { d } else { (d + n * (0.02 - 2.0 * k.min(0.0))).unit() }
}

/// The sun's reflection in a lobe of width `rough`, as radiance.
fn glint(scene: &Scene, p: &Point, d: V3, rough: f32, s: &mut Sampler) -> V3 {
    let l = outdoors::sun();
    let half = (l - d).unit();
    let spread = rough.max(0.02) * 0.5;
    let tilt2 = 1.0 / half.dot(p.normal).max(1e-3).powi(2) - 1.0;
    let lobe = (-tilt2 / (spread * spread)).exp() / (std::f32::consts::PI * spread * spread * 4.0);
    if lobe < 1e-3 || p.normal.dot(l) <= 0.0 {
        return V3::ZERO;
    }
    let lit = sunlight(scene, p.at, s.cone(l, outdoors::SUN_SPREAD));
    (lit * lobe).min(V3::ONE * 60_000.0)
}

/// Sunlight (lux on a facing surface) that reaches `at` from direction `l`.
fn sunlight(scene: &Scene, at: V3, l: V3) -> V3 {
    let t = (OUTSIDE - at.z) / l.z;
    let q = at + l * t;
    let [x0, x1, y0, y1] = WINDOW;
    if t <= 0.0 || q.x < x0 || q.x > x1 || q.y < y0 || q.y > y1 || shaded(scene, at, l, t) {
        V3::ZERO
    } else {
        outdoors::SUN_LUX
    }
}

/// Is anything but glass in the way? (Glass lets light straight through here: no caustics.)
fn shaded(scene: &Scene, at: V3, d: V3, limit: f32) -> bool {
    scene.bvh.blocked(at, d, limit, |t| scene.finish(t) != Finish::Glass)
}

/// How much of the light from direction `l` a matt point or thin sheet sends to the viewer's side, times pi over albedo.
fn share(p: &Point, l: V3) -> f32 {
    let cos = p.normal.dot(l);
    match p.finish {
        Finish::Sheet(through) if cos < 0.0 => -cos * through,
        Finish::Sheet(through) => cos * (1.0 - through),
        _ => cos.max(0.0),
    }
}

/// Light straight from the sun, and from the sky through the portal, over the albedo.
fn lights(scene: &Scene, p: &Point, s: &mut Sampler) -> (V3, V3) {
    let pi = std::f32::consts::PI;
    let l = s.cone(outdoors::sun(), outdoors::SUN_SPREAD);
    let k = share(p, l);
    let sun = if k > 0.0 { sunlight(scene, p.at, l) * (k / pi) } else { V3::ZERO };
    let [x0, x1, y0, y1] = WINDOW;
    let q = v3(x0 + (x1 - x0) * s.draw(), y0 + (y1 - y0) * s.draw(), OUTSIDE);
    let to = q - p.at;
    let d2 = to.dot(to).max(0.01);
    let l = to / d2.sqrt();
    let k = share(p, l) * l.z.max(0.0) * (x1 - x0) * (y1 - y0) / d2;
    let sky = if k > 1e-5 && !shaded(scene, p.at, l, d2.sqrt() * 0.9999) {
        scene.skylight(l) * (k.min(4.0) / pi)
    } else {
        V3::ZERO
    };
    (sun, sky)
}

/// All light that a matt point sends to the viewer, over its albedo: the sun's own, and the rest.
fn gather(scene: &Scene, p: &Point, s: &mut Sampler) -> (V3, V3) {
    let (sun, mut rest) = lights(scene, p, s);
    let mut weight = V3::ONE;
    let mut here = Point { at: p.at, normal: p.normal, colour: p.colour, finish: p.finish, material: p.material };
    for bounce in 0..BOUNCES {
        let side = match here.finish {
            Finish::Sheet(through) if s.draw() < through => -here.normal,
            _ => here.normal,
        };
        let d = s.cosine(side);
        let Some(hit) = scene.bvh.nearest(here.at, d, 1e9, |t| scene.finish(t) != Finish::Glass) else {
            break;
        };
        here = point(scene, here.at, d, hit, false);
        weight = weight * here.colour;
        let brightest = weight.x.max(weight.y).max(weight.z);
        if bounce >= 1 {
            let survive = brightest.min(0.9);
            if s.draw() >= survive {
                break;
            }
            weight = weight / survive;
        }
        let (a, b) = lights(scene, &here, s);
        rest += weight * (a + b);
    }
    // One sample may not outshine the whole sky: that would be a firefly.
    (sun, rest.min(V3::ONE * 20_000.0))
}
