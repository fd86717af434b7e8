//! Upsampling of depths: to a finer level of the pyramid, with jumps at the edges of the picture.
//!
//! In: the depths of a level, and the reference on this level and on the next finer one. Out: the depths of the finer
//! level. Cost: some ten operations for each pixel, and some fifty at jumps. Source: joint upsampling (Kopf et al.,
//! "Joint Bilateral Upsampling", SIGGRAPH 2007). At jumps, a pixel takes the depth of one neighbour instead of a mean:
//! between two surfaces, there is nothing.

use crate::plane::Plane;

/// A neighbour at the distance of one pixel of the coarser level is as good as one with a grey value that differs by
/// this.
const GREYS_PER_PIXEL: f32 = 6.0;

/// Returns the depths of the pixels of the finer level. Neighbours whose depths differ by more than `jump` are on
/// different surfaces.
pub(super) fn finer(depths: &Plane<f32>, jump: f32, reference: &Plane<u8>, fine: &Plane<u8>) -> Plane<f32> {
    let (width, height) = (depths.width(), depths.height());
    Plane::from_rows(fine.width(), fine.height(), |y, row| {
        let v = ((y as f32 - 0.5) / 2.0).clamp(0.0, (height - 1) as f32);
        let rows = (v as usize).saturating_sub(1)..(v as usize + 3).min(height);
        for (x, depth) in row.iter_mut().enumerate() {
            let u = ((x as f32 - 0.5) / 2.0).clamp(0.0, (width - 1) as f32);
            let (left, top) = ((u as usize).min(width.saturating_sub(2)), (v as usize).min(height.saturating_sub(2)));
            let (right, bottom) = ((left + 1).min(width - 1), (top + 1).min(height - 1));
            let four = [(left, top), (right, top), (left, bottom), (right, bottom)].map(|(x, y)| depths.at(x, y));
            let (least, most) = four.iter().fold((f32::MAX, f32::MIN), |(a, b), &q| (a.min(q), b.max(q)));
            if most - least <= jump {
                let (fx, fy) = (u - left as f32, v - top as f32);
                let (upper, lower) = (four[0] + fx * (four[1] - four[0]), four[2] + fx * (four[3] - four[2]));
                *depth = upper + fy * (lower - upper);
                continue;
            }
            let grey = f32::from(fine.at(x, y));
            let mut best = f32::MAX;
            for i in rows.clone() {
                for k in (u as usize).saturating_sub(1)..(u as usize + 3).min(width) {
                    let (dx, dy) = (k as f32 - u, i as f32 - v);
                    let difference = (f32::from(reference.at(k, i)) - grey).abs();
                    let cost = difference + GREYS_PER_PIXEL * (dx * dx + dy * dy).sqrt();
                    if cost < best {
                        (best, *depth) = (cost, depths.at(k, i));
                    }
                }
            }
        }
    })
}
