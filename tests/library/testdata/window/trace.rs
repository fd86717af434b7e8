//! The path tracer: from a view to layers of radiance (cd/m2).
//!
//! Light enters only through the window, so each diffuse point samples the window (a portal) for skylight, and the sun
//! for sunlight. The radiance of a pixel is stored in layers, which the denoiser treats differently: what is seen
//! directly, what is seen in a mirror, the light of the sun, and the light of sky and walls. The last two layers are
//! without the texture of the surface.

use rayon::prelude::*;

use super::bvh::Hit;
use super::noise::Sampler;
use super::outdoors;
use super::paint::Finish;
use super::scene::{OUTSIDE, Scene, WINDOW, camera_ray};
use super::vec3::{V3, v3};

/// Largest number of diffuse bounces of a path.
const BOUNCES: usize = 7;

/// A rectangle in the plane of the reference frame, and the resolution and number of samples of its picture.
#[derive(Clone, Copy)]
pub struct View {
    /// Left edge of the first pixel, in pixels from the left edge of the frame.
    pub left: f64,
    /// Upper edge of the first pixel, in pixels from the upper edge of the frame.
    pub top: f64,
    /// Pixels of the picture per pixel of the frame, along each side.
    pub scale: f64,
    pub width: usize,
    pub height: usize,
    pub samples: u32,
}

/// The layers of one pixel, as means over its samples.
#[derive(Clone, Copy, Default)]
pub struct Pixel {
    /// Radiance seen directly through the window; it has no noise except at edges.
    pub direct: V3,
    /// Radiance seen as a reflection in a coat or metal, or through glass.
    pub mirror: V3,
    /// Mean reflectance of the matt part.
    pub albedo: V3,
    /// Reflected sunlight divided by the albedo.
    pub sun: V3,
    /// All other reflected light divided by the albedo.
    pub rest: V3,
    /// Variance of the mean luminance of `rest`.
    pub rest_variance: f32,
    /// Variance of the mean luminance of `mirror`.
    pub mirror_variance: f32,
    pub normal: V3,
    pub depth: f32,
    /// Index of the material of the first surface; `u16::MAX` outdoors.
    pub material: u16,
    /// Whether the samples met more than one material, so that the pixel is on an edge.
    pub mixed: bool,
}

/// A point of a path on a surface.
struct Point {
    at: V3,
    /// Unit shading normal on the side of the viewer.
    normal: V3,
    colour: V3,
    finish: Finish,
    material: u16,
}

/// One sample of a pixel, in the layers of [`Pixel`].
#[derive(Default)]
struct Sample {
    direct: V3,
    mirror: V3,
    albedo: V3,
    sun: V3,
    rest: V3,
    first: Option<(V3, f32, u16)>,
}

/// Renders `view`, row by row; each pixel depends only on its position.
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
            // The pixel has the normal of the first sample's surface, because the mean of the normals of two surfaces
            // is the normal of neither.
            if seen == 0 {
                (sums.normal, sums.depth, sums.material) = (normal, depth, material);
            }
            sums.mixed |= material != sums.material;
            seen += 1;
        }
        // The view through the window has no noise apart from its detail, so 12 samples are enough.
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

/// Follows a path through mirrors and glass until it meets a matt surface or the outdoors.
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
                // Bodies are closed, so the direction of the normal of the mesh shows whether the ray enters or leaves.
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
                    // The albedo of the matt part is recorded for the denoiser, although this sample does not light it.
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

/// Returns the reflectance of glass or varnish, by Schlick's approximation.
fn fresnel(cos: f32) -> f32 {
    0.04 + 0.96 * (1.0 - cos.clamp(0.0, 1.0)).powi(5)
}

fn above(d: V3, n: V3) -> V3 {
    let k = d.dot(n);
    if k > 0.01 { d } else { (d + n * (0.02 - 2.0 * k.min(0.0))).unit() }
}

/// Returns the radiance of the reflection of the sun in a lobe of width `rough`.
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

/// Returns the sunlight (in lux on a surface that faces it) that reaches `at` from direction `l`.
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

/// Returns whether anything but glass blocks the ray. (Light passes straight through glass here; there are no
/// caustics.)
fn shaded(scene: &Scene, at: V3, d: V3, limit: f32) -> bool {
    scene.bvh.blocked(at, d, limit, |t| scene.finish(t) != Finish::Glass)
}

/// Returns the share of the light from direction `l` that a matt point or thin sheet sends to the side of the viewer,
/// times pi / albedo.
fn share(p: &Point, l: V3) -> f32 {
    let cos = p.normal.dot(l);
    match p.finish {
        Finish::Sheet(through) if cos < 0.0 => -cos * through,
        Finish::Sheet(through) => cos * (1.0 - through),
        _ => cos.max(0.0),
    }
}

/// Returns the light that the point reflects directly from the sun, and from the sky through the portal, each divided
/// by the albedo.
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

/// Returns the light that a matt point sends to the viewer, divided by its albedo: the direct light of the sun, and all
/// other light.
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
    // A sample is limited to about the radiance of the sky; a brighter one would be a firefly.
    (sun, rest.min(V3::ONE * 20_000.0))
}
