use super::*;
use crate::bracket::raw::lossless_jpeg::tests::uniform;
use crate::bracket::raw::stretch::Scale;

/// Length of the averages of differences, including the pixel itself.
const LENGTH: usize = 5;

/// All pixels of `linear`.
fn whole(linear: &Plane<f32>, pattern: &Pattern, balance: Balance) -> Plane<[f32; 3]> {
    let (width, height) = (linear.width(), linear.height());
    let area = Area { left: 0, top: 0, width, height };
    Plane::from_vec(width, height, demosaic(linear, pattern, balance, area, |rgb| rgb))
}

/// The method of the paper, pixel by pixel: some rows of a mosaic, with a border on all sides.
struct Band<'a> {
    pattern: &'a Pattern,
    /// Row of the picture at the first row of the band.
    first: usize,
    rows: usize,
    /// Size with the border.
    width: usize,
    height: usize,
    /// Stretched values of the mosaic.
    mosaic: Vec<f32>,
}

impl<'a> Band<'a> {
    fn new(linear: &Plane<f32>, pattern: &'a Pattern, balance: Balance, first: usize, rows: usize) -> Self {
        let (width, height) = (linear.width() + 2 * BORDER, rows + 2 * BORDER);
        let mut mosaic = Vec::with_capacity(width * height);
        for y in 0..height {
            let v = mirrored((first + y) as isize - BORDER as isize, linear.height());
            let row = linear.row(v);
            mosaic.extend((0..width).map(|x| {
                let u = mirrored(x as isize - BORDER as isize, linear.width());
                balance.stretched(row[u] * balance.factor(pattern.at(u, v)))
            }));
        }
        Band { pattern, first, rows, width, height, mosaic }
    }

    /// The colour of the pixel (x, y) of the band.
    fn colour(&self, x: usize, y: usize) -> usize {
        // The border has an even width, so the colours in it are those of the pattern.
        self.pattern.at(x + BORDER, self.first + y + BORDER)
    }

    /// The difference between green and the other colour, along a direction in which neighbours are `step` apart.
    fn differences(&self, step: usize) -> Vec<f32> {
        let (m, mut all) = (&self.mosaic, vec![0.0; self.mosaic.len()]);
        for y in 2..self.height - 2 {
            for x in 2..self.width - 2 {
                let i = y * self.width + x;
                let between = 0.5 * (m[i - step] + m[i + step]);
                let bend = 0.25 * (2.0 * m[i] - m[i - 2 * step] - m[i + 2 * step]);
                let other = between + bend;
                all[i] = if self.colour(x, y) == 1 { m[i] - other } else { other - m[i] };
            }
        }
        all
    }

    /// How much `differences` change along a direction: sums over squares of five pixels.
    fn changes(&self, differences: &[f32], step: usize) -> Vec<f32> {
        let (width, height) = (self.width, self.height);
        let mut change = vec![0.0; differences.len()];
        for i in (3 * width + 3)..(differences.len() - 3 * width - 3) {
            change[i] = (differences[i - step] - differences[i + step]).abs();
        }
        let mut along = vec![0.0; change.len()];
        for i in 2..change.len() - 2 {
            along[i] = change[i - 2] + change[i - 1] + change[i] + change[i + 1] + change[i + 2];
        }
        for y in 2..height - 2 {
            for i in y * width..(y + 1) * width {
                change[i] =
                    along[i - 2 * width] + along[i - width] + along[i] + along[i + width] + along[i + 2 * width];
            }
        }
        change
    }

    /// Writes the colours of the rows of the band.
    fn interpolate(&self, rows: &mut [[f32; 3]]) {
        let width = self.width;
        let steps = [1, width];
        let differences = steps.map(|step| self.differences(step));
        let changes = [0, 1].map(|d| self.changes(&differences[d], steps[d]));
        // Green minus the pixel's own colour: 0 at green pixels.
        let mut difference = vec![0.0f32; self.mosaic.len()];
        for y in 5..self.height - 5 {
            for x in (5..width - 5).filter(|&x| self.colour(x, y) != 1) {
                let i = y * width + x;
                let (mut sum, mut weights) = (0.0, 0.0);
                for ((differences, changes), step) in differences.iter().zip(&changes).zip(steps) {
                    for is_before in [true, false] {
                        let first = if is_before { i - (LENGTH - 1) * step } else { i };
                        let mean = (0..LENGTH).map(|k| differences[first + k * step]).sum::<f32>() / LENGTH as f32;
                        let centre = if is_before { i - 2 * step } else { i + 2 * step };
                        let change = changes[centre] + LEAST_CHANGE;
                        let weight = 1.0 / (change * change);
                        (sum, weights) = (sum + weight * mean, weights + weight);
                    }
                }
                difference[i] = sum / weights;
            }
        }
        let m = &self.mosaic;
        let out_width = width - 2 * BORDER;
        for (y, row) in rows.chunks_exact_mut(out_width).enumerate().take(self.rows) {
            for (x, rgb) in row.iter_mut().enumerate() {
                let (x, y) = (x + BORDER, y + BORDER);
                let (i, own) = (y * width + x, self.colour(x, y));
                let green = m[i] + difference[i];
                let d = |dx: isize, dy: isize| difference[i.wrapping_add_signed(dy * width as isize + dx)];
                *rgb = [green; 3];
                if own == 1 {
                    let across = self.colour(x + 1, y);
                    rgb[across] = green - 0.5 * (d(-1, 0) + d(1, 0));
                    rgb[2 - across] = green - 0.5 * (d(0, -1) + d(0, 1));
                } else {
                    // The filter of the paper, equation 10.
                    let near = d(-1, -1) + d(1, -1) + d(-1, 1) + d(1, 1);
                    let far = d(-3, -1) + d(3, -1) + d(-3, 1) + d(3, 1) + d(-1, -3) + d(1, -3) + d(-1, 3) + d(1, 3);
                    rgb[own] = m[i];
                    rgb[2 - own] = green - (10.0 * near - far) / 32.0;
                }
                *rgb = rgb.map(|v| v.min(1.0));
            }
        }
    }
}

/// The mosaic of a scene, whose colours at (x, y) are `scene`.
fn mosaic(pattern: &Pattern, size: (usize, usize), scene: impl Fn(usize, usize) -> [f32; 3] + Sync) -> Plane<f32> {
    Plane::from_rows(size.0, size.1, |y, row| {
        row.iter_mut().enumerate().for_each(|(x, v)| *v = scene(x, y)[pattern.at(x, y)]);
    })
}

fn patterns() -> impl Iterator<Item = Pattern> {
    [[0, 1, 1, 2], [2, 1, 1, 0], [1, 0, 2, 1], [1, 2, 0, 1]].into_iter().map(|p| Pattern::new((2, 2), &p).unwrap())
}

#[test]
fn smooth_planes_are_exact_in_all_phases_and_sizes() {
    let scene = |x: usize, y: usize| {
        let v = 0.2 + 0.003 * x as f32 + 0.002 * y as f32;
        [v + 0.1, v, v - 0.1]
    };
    for (pattern, size) in patterns().flat_map(|p| [(31, 70), (40, 2), (64, 65)].map(move |size| (p.clone(), size))) {
        let linear = |x: usize, y: usize| scene(x, y).map(|v: f32| Scale::of_sensor().linear(v));
        let found = whole(&mosaic(&pattern, size, linear), &pattern, Balance::new([1.0; 3], [1.0; 3]));
        // The stretched values are planes. At the border, they are mirrored, which bends them: 6 pixels from it, they
        // are exact but for the rounding of sums of some dozen floats.
        for (x, y) in (6..size.1.saturating_sub(6)).flat_map(|y| (6..size.0 - 6).map(move |x| (x, y))) {
            let (found, true_value) = (found.at(x, y), scene(x, y));
            assert!((0..3).all(|c| (found[c] - true_value[c]).abs() < 1e-5), "{pattern:?} ({x}, {y}): {found:?}");
        }
    }
}

#[test]
fn edges_have_no_false_colours() {
    // A grey vertical edge: interpolation across it would give colours.
    let scene = |x: usize, _: usize| if x < 20 { [0.1; 3] } else { [0.9; 3] };
    for pattern in patterns() {
        let found = whole(&mosaic(&pattern, (40, 40), scene), &pattern, Balance::new([1.0; 3], [1.0; 3]));
        for (x, y) in (6..34).flat_map(|y| (6..34).map(move |x| (x, y))) {
            let [r, g, b] = found.at(x, y);
            assert!((r - g).abs().max((b - g).abs()) < 0.02, "{pattern:?} ({x}, {y}): {r} {g} {b}");
        }
    }
}

#[test]
fn white_is_neutral_where_the_first_colour_clips() {
    let (neutral, clip) = ([0.5, 1.0, 0.7f32], [0.98, 0.95, 1.0f32]);
    let balance = Balance::new(neutral, clip);
    let pattern = Pattern::new((2, 2), &[0, 1, 1, 2]).unwrap();
    // Twice as bright as green can be.
    let bright = mosaic(&pattern, (30, 30), |_, _| [0, 1, 2].map(|c| (2.0 * neutral[c]).min(clip[c])));
    let found = whole(&bright, &pattern, balance);
    assert!(found.as_slice().iter().flatten().all(|&v| (v - 1.0).abs() < 1e-5), "{:?}", found.at(9, 9));
    // Half as bright as green can be.
    let half = mosaic(&pattern, (30, 30), |_, _| neutral.map(|n| 0.5 * 0.95 * n));
    let found = whole(&half, &pattern, balance);
    assert!(
        found.as_slice().iter().flatten().all(|&v| (Scale::of_sensor().linear(v) - 0.475).abs() < 1e-5),
        "{:?}",
        found.at(9, 9)
    );
}

/// The method of the paper for all pixels of `linear`, as one band.
fn textbook(linear: &Plane<f32>, pattern: &Pattern, balance: Balance) -> Plane<[f32; 3]> {
    let (width, height) = (linear.width(), linear.height());
    let mut pixels = vec![[0.0f32; 3]; width * height];
    Band::new(linear, pattern, balance, 0, height).interpolate(&mut pixels);
    Plane::from_vec(width, height, pixels)
}

#[test]
fn tiles_are_those_of_the_textbook() {
    for (pattern, size) in patterns().zip([(300, 150), (231, 20), (7, 300), (464, 128)]) {
        let noise = |x: usize, y: usize, c: usize| uniform(5, (y * 1000 + x) as u64, c as u64) as f32;
        let scene = |x: usize, y: usize| {
            let level = if (x / 9 + y / 7).is_multiple_of(2) { 0.02 } else { 0.7 };
            [0, 1, 2].map(|c| level * (0.5 + noise(x, y, c)))
        };
        let (linear, balance) = (mosaic(&pattern, size, scene), Balance::new([0.6, 1.0, 0.8], [1.0; 3]));
        let (found, expected) = (whole(&linear, &pattern, balance), textbook(&linear, &pattern, balance));
        for (i, (found, expected)) in found.as_slice().iter().zip(expected.as_slice()).enumerate() {
            // The sums have other orders, so changes of about 1e-4 and more have a relative error of up to 1e-3, and
            // twice that have the weights. Where they are so small, the differences that they weigh are equal within
            // about 1e-3.
            let error = (0..3).map(|c| (found[c] - expected[c]).abs()).fold(0.0, f32::max);
            assert!(error < 1e-5, "{size:?}, pixel {i}: {found:?} instead of {expected:?}");
        }
        // A part is equal to the same part of the whole.
        let area = Area { left: 3, top: 5, width: size.0 - 4, height: size.1 - 6 };
        let part = demosaic(&linear, &pattern, balance, area, |rgb| rgb);
        for (y, row) in part.chunks_exact(area.width).enumerate() {
            assert!(row == &found.row(area.top + y)[area.left..][..area.width], "row {y}");
        }
    }
}
