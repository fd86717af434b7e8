//! Upsampling of depths: to a finer level of the pyramid, with jumps at the edges of the picture.
//!
//! In: the depths of a level, and the reference on this level and on the next finer one. Out: the depths of the finer
//! level. Cost: some ten operations for each pixel, and some fifty at jumps. Source: joint upsampling (Kopf et al.,
//! "Joint Bilateral Upsampling", SIGGRAPH 2007). At jumps, a pixel takes the depth of one neighbour instead of a mean:
//! between two surfaces, there is nothing.

use crate::align::motion::relief::interpolated;
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
            if let Some(smooth) = interpolated(depths, jump, (u, v)) {
                *depth = smooth;
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A near surface ends at column 21 of the finer level, between two pixels of the coarser one; both surfaces are
    /// tilted.
    #[test]
    fn jumps_are_at_the_edges_of_the_finer_picture_and_planes_stay_planes() {
        let fine = Plane::from_rows(40, 12, |_, row: &mut [u8]| {
            row.iter_mut().enumerate().for_each(|(x, v)| *v = if x < 21 { 200 } else { 60 });
        });
        let coarse = crate::pyramid::halves(fine.clone(), 6).swap_remove(1);
        let truth = |x: f32| if x < 20.5 { 9.0 + 0.02 * x } else { 1.0 - 0.01 * x };
        let depths = Plane::from_rows(20, 6, |_, row: &mut [f32]| {
            row.iter_mut().enumerate().for_each(|(x, q)| *q = truth(2.0 * x as f32 + 0.5));
        });
        let found = finer(&depths, 1.0, &coarse, &fine);
        for x in 0..40 {
            // At the jump, a pixel takes the depth of a neighbour, which is at most three pixels away; at the border,
            // depths are repeated.
            let error = (found.at(x, 5) - truth(x as f32)).abs();
            assert!(error < 0.07, "column {x}: {} instead of {}", found.at(x, 5), truth(x as f32));
        }
    }
}
