//! The relief of a scene: the relative depth of each pixel of the reference, and how each frame shows it.
//!
//! In: the depths on a level of the grey pyramid, and the [`View`] of each frame. Out: depths of pixels of the full
//! size. Cost: a few operations for each pixel.

use crate::align::motion::camera::Camera;
use crate::plane::Plane;
use std::ops::Range;

/// The depth of a scene, and the views of the frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Relief {
    /// Level of the grey pyramid that has one depth for each pixel.
    level: usize,
    /// Relative depth of each pixel of the level.
    depths: Plane<f32>,
    /// Neighbours whose depths differ by more than this are on different surfaces.
    jump: f32,
    /// Lowest and highest depth.
    extremes: [f32; 2],
    /// The view of each frame; none for the reference and for frames whose camera is unknown.
    views: Vec<Option<View>>,
}

/// What a frame shows of the relief.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct View {
    /// The camera, in pixels of the full size.
    pub(crate) camera: Camera,
    /// Whether something nearer hides a pixel of the level in this frame.
    pub(crate) hidden: Plane<bool>,
}

impl Relief {
    /// The relief with these `depths` of the pixels of `level`. Neighbours whose depths differ by more than `jump` are
    /// on different surfaces.
    pub(crate) fn new(level: usize, depths: Plane<f32>, jump: f32, views: Vec<Option<View>>) -> Self {
        let extremes = extremes(depths.as_slice());
        Relief { level, depths, jump, extremes, views }
    }

    /// The view of frame `i`.
    pub(crate) fn view(&self, i: usize) -> Option<&View> {
        self.views[i].as_ref()
    }

    /// The pixel of the level before the position `v` of the full size, the one after it, and the fraction between
    /// them. `count` is the number of pixels of the level.
    #[inline(always)]
    fn between(&self, v: f32, count: usize) -> (usize, usize, f32) {
        let v = ((v + 0.5) / (1u64 << self.level) as f32 - 0.5).clamp(0.0, (count - 1) as f32);
        let first = (v as usize).min(count.saturating_sub(2));
        (first, (first + 1).min(count - 1), v - first as f32)
    }

    /// Relative depth at the position (x, y) of the full size; and whether the frame of `view` shows it.
    #[inline(always)]
    pub(crate) fn at(&self, view: &View, x: f32, y: f32) -> (f32, bool) {
        let (left, right, fx) = self.between(x, self.depths.width());
        let (top, bottom, fy) = self.between(y, self.depths.height());
        let (above, below) = (self.depths.row(top), self.depths.row(bottom));
        let four = [above[left], above[right], below[left], below[right]];
        let nearest = (if fx < 0.5 { left } else { right }, if fy < 0.5 { top } else { bottom });
        let [least, most] = extremes(&four);
        let depth = if most - least > self.jump {
            self.depths.at(nearest.0, nearest.1)
        } else {
            let upper = four[0] + fx * (four[1] - four[0]);
            let lower = four[2] + fx * (four[3] - four[2]);
            upper + fy * (lower - upper)
        };
        (depth, !view.hidden.at(nearest.0, nearest.1))
    }

    /// Lowest and highest relative depth of the pixels `columns` x `rows` of the full size.
    pub(crate) fn range(&self, columns: &Range<usize>, rows: &Range<usize>) -> [f32; 2] {
        let span = |range: &Range<usize>, count| {
            let end = range.end.max(range.start + 1) - 1;
            self.between(range.start as f32, count).0..self.between(end as f32, count).1 + 1
        };
        let (columns, rows) = (span(columns, self.depths.width()), span(rows, self.depths.height()));
        let of_rows = rows.map(|y| extremes(&self.depths.row(y)[columns.clone()]));
        of_rows.reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]).unwrap_or(self.extremes)
    }

    /// Lowest and highest relative depth of all pixels.
    pub(crate) fn extremes(&self) -> [f32; 2] {
        self.extremes
    }
}

/// The lowest and the highest of `values`.
#[inline(always)]
fn extremes(values: &[f32]) -> [f32; 2] {
    values.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[least, most], &v| [least.min(v), most.max(v)])
}
