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
    /// How this frame shows each pixel of the level.
    pub(crate) visibility: Plane<Visibility>,
}

/// How a frame shows a pixel of the reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Visibility {
    /// It shows what the reference shows.
    #[default]
    Shown,
    /// It may show a little of something nearer, too: the pixel is beside hidden ones.
    Mixed,
    /// Something nearer hides the pixel.
    Hidden,
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

    /// The position on the level of the position `v` of the full size. `count` is the number of pixels of the level.
    #[inline(always)]
    fn on_level(&self, v: f32, count: usize) -> f32 {
        ((v + 0.5) / (1u64 << self.level) as f32 - 0.5).clamp(0.0, (count - 1) as f32)
    }

    /// Relative depth at the position (x, y) of the full size; and how the frame of `view` shows it.
    #[inline(always)]
    pub(crate) fn at(&self, view: &View, x: f32, y: f32) -> (f32, Visibility) {
        let (u, v) = (self.on_level(x, self.depths.width()), self.on_level(y, self.depths.height()));
        let nearest = ((u + 0.5) as usize, (v + 0.5) as usize);
        let depth = interpolated(&self.depths, self.jump, (u, v));
        let depth = depth.unwrap_or_else(|| self.depths.at(nearest.0, nearest.1));
        (depth, view.visibility.at(nearest.0, nearest.1))
    }

    /// Lowest and highest relative depth of the pixels `columns` x `rows` of the full size.
    pub(crate) fn range(&self, columns: &Range<usize>, rows: &Range<usize>) -> [f32; 2] {
        let span = |range: &Range<usize>, count| {
            let end = range.end.max(range.start + 1) - 1;
            let [first, last] = [range.start, end].map(|v| self.on_level(v as f32, count));
            first as usize..(last as usize + 2).min(count)
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

/// Returns the depth at the position (u, v), which must be within the rectangle of pixel centres of `depths`; none if
/// the pixels around it are on different surfaces, because their depths differ by more than `jump`.
#[inline(always)]
pub(crate) fn interpolated(depths: &Plane<f32>, jump: f32, (u, v): (f32, f32)) -> Option<f32> {
    let (left, top) = (u as usize, v as usize);
    let (right, bottom) = ((left + 1).min(depths.width() - 1), (top + 1).min(depths.height() - 1));
    let (above, below) = (depths.row(top), depths.row(bottom));
    let four = [above[left], above[right], below[left], below[right]];
    let [least, most] = extremes(&four);
    let (fx, fy) = (u - left as f32, v - top as f32);
    let upper = four[0] + fx * (four[1] - four[0]);
    let lower = four[2] + fx * (four[3] - four[2]);
    (most - least <= jump).then_some(upper + fy * (lower - upper))
}

/// The lowest and the highest of `values`.
#[inline(always)]
fn extremes(values: &[f32]) -> [f32; 2] {
    values.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[least, most], &v| [least.min(v), most.max(v)])
}
