//! The denoiser: from layers of radiance to one clean picture.
//!
//! An edge-avoiding wavelet filter (Dammertz et al. 2010, with the variance-guided range of Schied et al. 2017) smooths
//! the light without the textures of the surfaces. The light is then multiplied by the textures, so that these lose no
//! detail.

use rayon::prelude::*;

use super::paint::Finish;
use super::scene::Scene;
use super::trace::Pixel;
use super::vec3::V3;

/// Filters the noisy layers and returns the sum of all layers: radiance in cd/m2.
pub fn develop(scene: &Scene, pixels: &[Pixel], width: usize) -> Vec<V3> {
    let rest: Vec<(V3, f32)> = pixels.iter().map(|p| (p.rest, p.rest_variance)).collect();
    let rest = smooth(pixels, rest, width, 5, |_| true);
    let mirror: Vec<(V3, f32)> = pixels.iter().map(|p| (p.mirror, p.mirror_variance)).collect();
    let soft = |p: &Pixel| match scene.materials.get(p.material as usize).map(|m| m.finish) {
        Some(Finish::Coat(rough) | Finish::Metal(rough)) => rough > 0.03,
        _ => false,
    };
    let mirror = smooth(pixels, mirror, width, 3, soft);
    pixels.iter().zip(rest).zip(mirror).map(|((p, r), m)| p.direct + m + p.albedo * (p.sun + r)).collect()
}

/// Returns `layer` without its noise, filtered over the pixels for which `may` returns true.
///
/// The excess light of fireflies (much too bright pixels) is separated first, smoothed over the whole surface, and
/// added again, so that the sum of the light stays the same.
fn smooth(
    pixels: &[Pixel],
    layer: Vec<(V3, f32)>,
    width: usize,
    levels: u32,
    may: impl Fn(&Pixel) -> bool + Sync,
) -> Vec<V3> {
    let calm = despeckled(pixels, &layer, width, &may);
    let excess = layer.iter().zip(&calm).map(|(a, b)| (a.0 - b.0, 0.0)).collect();
    let calm = wavelet(pixels, calm, width, levels, true, &may);
    let excess = wavelet(pixels, excess, width, levels, false, &may);
    calm.into_iter().zip(excess).map(|(a, b)| (a.0 + b.0).max(V3::ZERO)).collect()
}

/// Applies `levels` passes of a 5 x 5 filter, whose taps are twice as far apart in each pass. If `ranged`, it keeps
/// edges that are stronger than the noise.
fn wavelet(
    pixels: &[Pixel],
    mut layer: Vec<(V3, f32)>,
    width: usize,
    levels: u32,
    ranged: bool,
    may: impl Fn(&Pixel) -> bool + Sync,
) -> Vec<(V3, f32)> {
    let height = pixels.len() / width;
    const TAPS: [f32; 5] = [1.0 / 16.0, 1.0 / 4.0, 3.0 / 8.0, 1.0 / 4.0, 1.0 / 16.0];
    for level in 0..levels {
        let step = 1isize << level;
        let spread = blurred_variance(&layer, width);
        let old = &layer;
        let filtered = (0..pixels.len()).into_par_iter().map(|k| {
            let (x, y) = ((k % width) as isize, (k / width) as isize);
            let (p, (value, variance)) = (&pixels[k], old[k]);
            if p.material == u16::MAX || !may(p) {
                return (value, variance);
            }
            let range = if ranged { 4.0 * spread[k].sqrt() + 1e-3 * value.luminance() + 1e-4 } else { f32::INFINITY };
            let (mut sum, mut sum_variance, mut total) = (V3::ZERO, 0.0, 0.0);
            for j in -2..=2 {
                for i in -2..=2 {
                    let (u, v) = (x + i * step, y + j * step);
                    if u < 0 || v < 0 || u >= width as isize || v >= height as isize {
                        continue;
                    }
                    let q = v as usize * width + u as usize;
                    let o = &pixels[q];
                    if o.material == u16::MAX || !may(o) {
                        continue;
                    }
                    let turn = p.normal.dot(o.normal).max(0.0).powi(48);
                    let away = ((p.depth - o.depth).abs()
                        / (0.012 * p.depth * (1 + i.abs().max(j.abs()) * step) as f32).max(1e-4))
                    .min(20.0);
                    let apart = ((value.luminance() - old[q].0.luminance()).abs() / range).min(20.0);
                    let w = TAPS[(i + 2) as usize] * TAPS[(j + 2) as usize] * turn * (-away - apart).exp();
                    sum += old[q].0 * w;
                    sum_variance += old[q].1 * w * w;
                    total += w;
                }
            }
            if total < 1e-6 { (value, variance) } else { (sum / total, sum_variance / (total * total)) }
        });
        layer = filtered.collect();
    }
    layer
}

/// Returns `layer` in which fireflies (and too dark pixels) are limited to the range of the 24 pixels around them. The
/// weights of the filter would keep such pixels, because they differ so much from their neighbours.
fn despeckled(
    pixels: &[Pixel],
    layer: &[(V3, f32)],
    width: usize,
    may: impl Fn(&Pixel) -> bool + Sync,
) -> Vec<(V3, f32)> {
    let height = pixels.len() / width;
    let one = |k: usize| {
        let (p, (value, variance)) = (&pixels[k], layer[k]);
        if p.material == u16::MAX || !may(p) {
            return (value, variance);
        }
        let (x, y) = (k % width, k / width);
        let mut near = [0.0f32; 24];
        let mut n = 0;
        for v in y.saturating_sub(2)..(y + 3).min(height) {
            for u in x.saturating_sub(2)..(x + 3).min(width) {
                let o = &pixels[v * width + u];
                let alike = o.material == p.material && o.normal.dot(p.normal) > 0.9;
                if (u, v) != (x, y) && o.material != u16::MAX && (p.mixed || alike) {
                    near[n] = layer[v * width + u].0.luminance();
                    n += 1;
                }
            }
        }
        if n < 4 {
            return (value, variance);
        }
        near[..n].sort_by(f32::total_cmp);
        // A pixel on an edge may be nearly as dark or light as the extremes around it.
        let spare = if p.mixed { 2.min(n / 4) } else { n / 8 };
        let (low, high, own) = (near[spare], near[n - 1 - spare], value.luminance());
        // The variance is reduced with the value, because a firefly's own estimate of its variance is much too large.
        let kept = own.clamp(low * 0.7, high * 1.3);
        let k = if own > 1e-6 { kept / own } else { 1.0 };
        (value * k, variance * (k * k).min(1.0))
    };
    (0..pixels.len()).into_par_iter().map(one).collect()
}

/// Returns the mean variance over 5 x 5 pixels, because the estimate of a single pixel is too noisy.
fn blurred_variance(layer: &[(V3, f32)], width: usize) -> Vec<f32> {
    let height = layer.len() / width;
    (0..layer.len())
        .into_par_iter()
        .map(|k| {
            let (x, y) = (k % width, k / width);
            let (mut sum, mut n) = (0.0, 0.0);
            for v in y.saturating_sub(2)..(y + 3).min(height) {
                for u in x.saturating_sub(2)..(x + 3).min(width) {
                    sum += layer[v * width + u].1;
                    n += 1.0;
                }
            }
            sum / n
        })
        .collect()
}
