//! The depth stages against textbook versions, and against scenes with known depth.

use super::semi_global::Choice;
use super::*;
use crate::align::following::observations::Observation;
use crate::align::following::{Start, observed};
use crate::align::local::patches;
use crate::align::motion::coordinates::Coordinates;
use crate::align::motion::{Cause, Followed, Motion};
use crate::align::scene::{Scene, Shot, photograph, shift, uniform};
use crate::align::tests::frame;
use crate::align::transform::Transform;
use crate::align::transforms_file::SavedAlignment;
use crate::align::{AlignOptions, Alignment, Local, align};
use crate::bracket::{Bracket, ReferenceChoice};
use nalgebra::{Matrix2, Matrix3, SVector, Vector2};
use std::path::Path;
use std::sync::Arc;

const SIZE: (usize, usize) = (360, 240);

fn motion(p: [f64; 11]) -> CameraMotion {
    CameraMotion(SVector::from(p))
}

/// Two frames of a scene with depth: shifts, turns, and epipoles in different directions.
fn two_motions() -> [CameraMotion; 2] {
    [
        motion([0.8, -1.2, 2.0, 0.5, 0.3, -1.0, 0.4, -0.2, 1.5, 0.6, 0.1]),
        motion([-0.5, 0.6, -1.0, 0.2, -0.4, 0.7, 0.1, 0.3, -0.4, 1.8, -0.2]),
    ]
}

#[test]
fn camera_maps_pixels_as_the_motion_displaces_them() {
    let coordinates = Coordinates::new(SIZE);
    let [motion, _] = two_motions();
    let h = shift(3.0, -2.0).matrix(SIZE.0, SIZE.1);
    let camera = motion.camera(&h, &coordinates);
    // The same camera in pixels of a picture that is twice as large.
    let large = camera.between(&full_to_level(1), &level_to_full(1));
    for (x, y, q) in [(0.0, 0.0, 0.0), (100.0, 200.0, 1.5), (359.0, 120.0, -2.0)] {
        let [dx, dy] = motion.displacement(coordinates.of([x, y]), q, coordinates.unit);
        let (u, v) = camera.position(x, y, q);
        assert!((u - (x + dx + 3.0)).abs() < 1e-9 && (v - (y + dy - 2.0)).abs() < 1e-9);
        let (s, t) = large.position(2.0 * x + 0.5, 2.0 * y + 0.5, q);
        assert!((s - (2.0 * u + 0.5)).abs() < 1e-9 && (t - (2.0 * v + 0.5)).abs() < 1e-9);
    }
}

/// Observations of `patches` patches in frames with these motions; `depth` gives the relative depth of a patch at a
/// position. Each displacement has an error of up to 0.1 pixels along each axis; every tenth is wrong by up to 8
/// pixels.
fn observations(motions: &[CameraMotion], patches: usize, depth: impl Fn([f64; 2]) -> f64) -> Vec<Vec<Observation>> {
    let unit = Coordinates::new(SIZE).unit;
    let number = |seed: u64, i: usize, j: usize| 2.0 * uniform(seed, i as i64, j as i64) - 1.0;
    let observation = |frame: usize, i: usize| {
        let at = [number(1, i, 0), 0.6 * number(1, i, 1)];
        let error = if (i + frame).is_multiple_of(10) { 8.0 } else { 0.1 };
        let wrong = [0, 1].map(|axis| error * number(2 + axis as u64, i, frame));
        let [dx, dy] = motions[frame].displacement(at, depth(at), unit);
        Observation {
            patch: i,
            at,
            displacement: Vector2::new(dx + wrong[0], dy + wrong[1]),
            precision: Matrix2::identity() * 40.0,
        }
    };
    (0..motions.len()).map(|frame| (0..patches).map(|i| observation(frame, i)).collect()).collect()
}

fn fit(frames: &[Vec<Observation>], patches: usize) -> Option<Geometry> {
    let frames: Vec<&[Observation]> = frames.iter().map(Vec::as_slice).collect();
    geometry::fit(&frames, patches, Coordinates::new(SIZE).unit)
}

#[test]
fn a_rejected_frame_joins_if_it_agrees_and_a_frame_of_another_scene_does_not() {
    let coordinates = Coordinates::new(SIZE);
    let motions = two_motions();
    let mut frames = observations(&[motions[0], motions[1], motions[1]], 600, two_planes);
    // In the first frame, a pattern repeats along the direction in which depth displaces: the depths of a sixth of the
    // patches are wrong if they are measured from this frame alone.
    for observation in frames[0].iter_mut().filter(|o| o.patch % 6 == 1) {
        observation.displacement += Vector2::from(motions[0].by_depth(observation.at)) * 4.0;
    }
    // The third frame shows another scene.
    for observation in &mut frames[2] {
        let number = |seed: u64| 24.0 * uniform(seed, observation.patch as i64, 0) - 12.0;
        observation.displacement += Vector2::new(number(7), number(8));
    }
    let observed = |(i, observations): (usize, &Vec<Observation>)| {
        let start = Start { transform: Transform::Identity, is_rejected: i > 0 };
        Some(Observed::new(observations.clone(), start, Matrix3::identity()))
    };
    let observed: Vec<Option<Observed>> = frames.iter().enumerate().map(observed).collect();
    let found = geometry(&observed, coordinates.unit).unwrap();
    assert_eq!([0, 1, 2].map(|i| found.motions[i].is_some()), [true, true, false]);
    // Of the frame alone, a tenth of the patches is wrong.
    let unexplained = found.explained[1].unexplained();
    assert!(unexplained < 0.3, "{unexplained}");
}

/// Two planes, one of them tilted.
fn two_planes([u, v]: [f64; 2]) -> f64 {
    if u + 0.3 * v > 0.2 { 3.0 + u } else { -1.0 }
}

#[test]
fn motions_and_depths_explain_the_displacements() {
    let unit = Coordinates::new(SIZE).unit;
    let truth = two_motions();
    let frames = observations(&truth, 600, two_planes);
    let found = fit(&frames, 600).unwrap();
    // The depths and motions are known up to a change of the plane of depth 0, so displacements are compared. The error
    // of a patch is that of its own displacements, about 0.06 px: it has one depth for four coordinates.
    let mut errors = Vec::new();
    for (frame, (observations, truth)) in frames.iter().zip(&truth).enumerate() {
        let motion = found.motions[frame].unwrap();
        for s in observations {
            let a = motion.displacement(s.at, found.depths[s.patch].unwrap(), unit);
            let b = truth.displacement(s.at, two_planes(s.at), unit);
            errors.push(((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1])).sqrt());
        }
    }
    let near = errors.iter().filter(|&&e| e < 0.2).count() as f64 / errors.len() as f64;
    // A patch of which one of the two displacements is wrong may follow it along its epipolar line.
    assert!(near > 0.85, "{near}");
}

#[test]
fn nothing_is_measured_without_depth_or_with_independent_motion() {
    let flat = observations(&two_motions(), 600, |_| 0.0);
    let is_depth = |frames: &[Vec<Observation>]| fit(frames, 600).is_some_and(|g| g.is_depth());
    assert!(!is_depth(&flat), "one homography suffices");
    // A quarter of the patches move by themselves, in each frame in another way.
    let mut leaves = flat;
    for (frame, observations) in leaves.iter_mut().enumerate() {
        for s in observations.iter_mut().filter(|s| s.patch.is_multiple_of(4)) {
            let own = [0, 1].map(|axis| 10.0 * (uniform(7 + axis, s.patch as i64, frame as i64) - 0.5));
            s.displacement += Vector2::from(own);
        }
    }
    assert!(!is_depth(&leaves), "depth does not explain it");
    // Two frames are smeared, one of them much more: each disagrees with its homography, but not as the other.
    let still = motion([0.0; 11]);
    let mut smeared = observations(&[still, still], 600, |_| 0.0);
    for (frame, along) in [(0, Vector2::new(0.2, 0.1)), (1, Vector2::new(3.0, -5.0))] {
        for s in &mut smeared[frame] {
            s.displacement += along * (2.0 * uniform(9, s.patch as i64, frame as i64) - 1.0);
        }
    }
    assert!(fit(&smeared, 600).is_some_and(|g| Explained::are_better(&g.explained)), "depth explains one of them");
    assert!(!is_depth(&smeared), "the frames do not agree");
    let few = observations(&two_motions(), 20, two_planes);
    assert!(fit(&few, 20).is_none(), "too few patches");
}

/// A volume with pseudorandom costs.
fn noisy_volume(width: usize, height: usize, labels: usize) -> CostVolume {
    let costs = (0..width * height * labels).map(|i| (256.0 * uniform(5, i as i64, 0)) as u8).collect();
    CostVolume { width, height, labels, costs, scale: 40.0 }
}

/// A picture with pseudorandom grey values.
fn noisy_grey(width: usize, height: usize) -> Plane<u8> {
    Plane::from_rows(width, height, |y, row: &mut [u8]| {
        row.iter_mut().enumerate().for_each(|(x, v)| *v = (255.0 * uniform(6, x as i64, y as i64)) as u8);
    })
}

#[test]
fn semi_global_matching_is_that_of_the_paper() {
    let (width, height, labels) = (13, 9, 6);
    let volume = noisy_volume(width, height, labels);
    let grey = noisy_grey(width, height);
    let inside = |x: isize, y: isize| x >= 0 && y >= 0 && x < width as isize && y < height as isize;
    let mut sums = vec![0u32; width * height * labels];
    for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)] {
        // Equation 13 of the paper, by recursion from the border.
        fn path(
            at: (isize, isize),
            by: (isize, isize),
            volume: &CostVolume,
            grey: &Plane<u8>,
            inside: &dyn Fn(isize, isize) -> bool,
        ) -> Vec<u32> {
            let own = volume.at(at.1 as usize * volume.width + at.0 as usize);
            let before = (at.0 - by.0, at.1 - by.1);
            if !inside(before.0, before.1) {
                return own.iter().map(|&c| u32::from(c)).collect();
            }
            let last = path(before, by, volume, grey, inside);
            let value = |(x, y): (isize, isize)| grey.at(x as usize, y as usize);
            let [p1, p2] = semi_global::penalties(volume.scale, value(at), value(before)).map(u32::from);
            let least = *last.iter().min().unwrap();
            let of = |d: usize| {
                let mut best = last[d].min(least + p2);
                if d > 0 {
                    best = best.min(last[d - 1] + p1);
                }
                if d + 1 < last.len() {
                    best = best.min(last[d + 1] + p1);
                }
                u32::from(own[d]) + best - least
            };
            (0..own.len()).map(of).collect()
        }
        for y in 0..height {
            for x in 0..width {
                let found = path((x as isize, y as isize), (dx, dy), &volume, &grey, &inside);
                for (d, v) in found.into_iter().enumerate() {
                    sums[(y * width + x) * labels + d] += v;
                }
            }
        }
    }
    let choices = semi_global::choose(&volume, &grey);
    for (i, sums) in sums.chunks_exact(labels).enumerate() {
        let best = (0..labels).min_by_key(|&d| sums[d]).unwrap();
        let found = choices.at(i % width, i / width).label;
        assert!((found - best as f32).abs() <= 0.5, "pixel {i}: {found} instead of {best}");
    }
}

#[test]
fn strips_of_a_volume_are_matched_with_the_rows_beside_them() {
    // There are 6 x 2^20 costs to a strip, so it has 1536 rows, of which 16 on each side belong to its neighbours.
    let (width, height, labels) = (64, 1600, 64);
    let volume = noisy_volume(width, height, labels);
    let grey = noisy_grey(width, height);
    let part = |rows: std::ops::Range<usize>| {
        let costs = volume.costs[rows.start * width * labels..rows.end * width * labels].to_vec();
        let grey = Plane::from_vec(width, rows.len(), grey.rows(rows.clone()).to_vec());
        semi_global::choose(&CostVolume { width, height: rows.len(), labels, costs, scale: volume.scale }, &grey)
    };
    let all = semi_global::choose(&volume, &grey);
    assert_eq!(all.rows(0..1504), part(0..1520).rows(0..1504));
    assert_eq!(all.rows(1504..1600), part(1488..1600).rows(16..112));
}

#[test]
fn costs_follow_the_correlation_of_windows() {
    let size = (40, 30);
    let take = |dx: f64| Scene::new(3).photograph(size, &shift(dx, 0.0), Shot { noise: 0.0, ..Shot::at(0.0) });
    // At relative depth q, the frame is shifted by q pixels.
    let towards = motion([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    let camera = towards.camera(&Matrix3::identity(), &Coordinates::new(size));
    let (reference, frame) = (take(0.0), take(2.0));
    let tones = ToneTables::between(&reference, &frame, &Matrix3::identity());
    let compared = [Compared::new(&reference, &frame, &tones, camera)];
    let labels = Labels { first: 0.0, step: 1.0, count: 5 };
    let volume = CostVolume::new(size, &compared, &labels);
    for (x, y) in [(5, 5), (20, 12), (30, 25), (17, 3)] {
        for label in 0..5 {
            let window = |plane: &Plane<f32>, dx: usize| -> Vec<f64> {
                let rows = (y - 2..=y + 2).flat_map(|row| (x - 2..=x + 2).map(move |column| (column, row)));
                rows.map(|(column, row)| f64::from(plane.at(column + dx, row))).collect()
            };
            let (a, b) = (window(&compared[0].reference, 0), window(&compared[0].frame, label));
            if a.iter().chain(&b).any(|v| v.is_nan()) {
                continue;
            }
            let mean = |v: &[f64]| v.iter().sum::<f64>() / 25.0;
            let covariance =
                |v: &[f64], w: &[f64]| v.iter().zip(w).map(|(p, q)| (p - mean(v)) * (q - mean(w))).sum::<f64>() / 25.0;
            let square =
                covariance(&a, &b).max(0.0).powi(2) / ((covariance(&a, &a) + 2.0) * (covariance(&b, &b) + 2.0));
            let gain = (-0.5 * (1.03 - square).ln()).max(0.0);
            let most = -0.5 * 0.03f64.ln() + 0.06;
            let expected = 255.0 - 255.0 / most * (0.06 + gain);
            let found = f64::from(volume.at(y * size.0 + x)[label]);
            // Both the gain and the offset are rounded to whole units. Sums of 25 floats of up to 255^2 have an error
            // of about 1e-6 of their size, which is 0.1 in a variance and moves the cost by less than a unit.
            assert!((found - expected).abs() <= 2.0, "({x}, {y}), label {label}: {found} instead of {expected}");
        }
    }
}

#[test]
fn unexpected_labels_cost_up_to_a_limit() {
    let mut volume = CostVolume { width: 1, height: 1, labels: 12, costs: vec![100; 12], scale: 400.0 };
    volume.expect(|_, _| [(1.0, 0.0), (9.0, 2.0)].into_iter());
    // The limit is 0.06 natural units, which are 24 units of cost, and is reached four labels away.
    assert_eq!(volume.costs, [106, 100, 106, 112, 118, 124, 124, 124, 118, 112, 118, 124]);
}

#[test]
fn planes_stay_planes_and_jumps_stay_sharp() {
    let (width, height) = (60, 40);
    let truth = |x: usize, y: usize| if x < 30 { 4.0 + 0.1 * x as f32 } else { 12.0 - 0.05 * y as f32 };
    let is_hole = |x: usize, y: usize| (8..18).contains(&x) && (10..20).contains(&y);
    let choices = Plane::from_rows(width, height, |y, row: &mut [Choice]| {
        for (x, c) in row.iter_mut().enumerate() {
            // A wrong label without certainty does not count.
            let noise = 0.6 * (uniform(9, x as i64, y as i64) as f32 - 0.5);
            *c = if is_hole(x, y) {
                Choice { label: truth(x, y) + 1.2, certainty: 0.0 }
            } else {
                Choice { label: truth(x, y) + noise, certainty: 0.5 }
            };
        }
    });
    let grey = Plane::from_rows(width, height, |_, row: &mut [u8]| {
        row.iter_mut().enumerate().for_each(|(x, v)| *v = if x < 30 { 50 } else { 120 });
    });
    let smooth = smoothing::smooth(&choices, &grey);
    for y in 0..height {
        for x in 0..width {
            let error = (smooth.at(x, y) - truth(x, y)).abs();
            // The iteration stops before the plane around a hole fills all of it.
            assert!(
                error < if is_hole(x, y) { 0.8 } else { 0.4 },
                "({x}, {y}): {} instead of {}",
                smooth.at(x, y),
                truth(x, y)
            );
        }
    }
}

/// Photographs of a far scene and of a near disc before it, by a camera that moved sideways. The far scene moves by
/// `far`, and the disc by `near`, in pixels.
fn photographs(exposures: [f64; 3], far: [[f64; 2]; 3], near: [[f64; 2]; 3]) -> Vec<Plane<u8>> {
    let take = |i: usize| {
        photograph(SIZE, &Transform::Identity, Shot::at(exposures[i]), |x, y| {
            let (u, v) = (x - near[i][0], y - near[i][1]);
            let (a, b) = (u - 150.0, v - 120.0);
            if a * a + b * b < 70.0 * 70.0 {
                Scene::new(8).radiance(u, v)
            } else {
                Scene::new(4).radiance(x - far[i][0], y - far[i][1])
            }
        })
    };
    (0..3).map(take).collect()
}

/// The relief of three frames; the second is the reference.
fn relief_of(pyramids: &[GreyPyramid], starts: &[Option<Start>], threads: usize) -> Option<Relief> {
    let picture = Picture::of(&pyramids[1]);
    let frames = observed(pyramids, 1, starts, &picture, patches, threads);
    Some(relief(pyramids, 1, &frames, &picture)?.0)
}

const EXPOSURES: [f64; 3] = [-1.5, 0.0, 1.5];
const FAR: [[f64; 2]; 3] = [[-2.0, 1.0], [0.0, 0.0], [3.0, 2.0]];
const NEAR: [[f64; 2]; 3] = [[-7.0, 1.0], [0.0, 0.0], [3.0, 7.0]];

#[test]
fn near_disc_and_far_scene_are_both_followed_on_any_number_of_threads() {
    let (far, near) = (FAR, NEAR);
    let pyramids: Vec<GreyPyramid> = photographs(EXPOSURES, far, near).into_iter().map(GreyPyramid::new).collect();
    let start = |i: usize| Start { transform: shift(far[i][0], far[i][1]), is_rejected: i == 2 };
    let starts = [Some(start(0)), None, Some(start(2))];
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| relief_of(&pyramids, &starts, threads).unwrap())
    };
    let found = on(2);
    assert!([1, 5].map(on).iter().all(|other| *other == found));
    let found = Followed::Depth(Arc::new(found));
    for i in [0, 2] {
        let motion = Motion::unmoved(SIZE).following(Some(&found), i);
        let (mut right, mut all) = (0, 0);
        for (x, y) in (10..SIZE.1 - 10).step_by(3).flat_map(|y| (10..SIZE.0 - 10).step_by(3).map(move |x| (x, y))) {
            let (a, b) = (x as f64 - 150.0, y as f64 - 120.0);
            let distance = (a * a + b * b).sqrt();
            // Pixels next to the edge of the disc may be hidden in the frame: the disc moves by 5 px, see below.
            if (distance - 70.0).abs() < 12.0 {
                continue;
            }
            let [dx, dy] = if distance < 70.0 { near[i] } else { far[i] };
            let is_near = |(u, v): (f64, f64)| {
                let (ex, ey) = (u - x as f64 - dx, v - y as f64 - dy);
                ex * ex + ey * ey < 1.0
            };
            all += 1;
            right += usize::from(motion.position(x as f64, y as f64).is_some_and(is_near));
        }
        assert!(right as f64 > 0.97 * all as f64, "frame {i}: {right} of {all}");
        // A far pixel is hidden if the frame shows the disc at its position. The edge of the disc is found with an
        // error of some pixels, because both surfaces have the same grey values, and what a frame shows within two
        // pixels can hide a pixel. By chance, both have the same grey value at some of the hidden pixels.
        let from_disc = |x: f64, y: f64| ((x - 150.0) * (x - 150.0) + (y - 120.0) * (y - 120.0)).sqrt() - 70.0;
        let (mut hidden, mut missed, mut shown, mut masked, mut mixed) = (0, 0, 0, 0, 0);
        for (x, y) in (10..SIZE.1 - 10).flat_map(|y| (10..SIZE.0 - 10).map(move |x| (x as f64, y as f64))) {
            let inside = -from_disc(x + far[i][0] - near[i][0], y + far[i][1] - near[i][1]);
            let is_hidden = motion.position(x, y).is_none();
            mixed += usize::from(is_hidden && motion.seen(x, y).is_some());
            if from_disc(x, y) > 2.0 && inside > 2.0 {
                (hidden, missed) = (hidden + 1, missed + usize::from(!is_hidden));
            } else if from_disc(x, y) < -4.0 || inside < -6.0 {
                (shown, masked) = (shown + 1, masked + usize::from(is_hidden));
            }
        }
        assert!(hidden > 30 && 4 * missed < hidden, "frame {i}: {missed} of {hidden}");
        assert!(100 * masked < shown, "frame {i}: {masked} of {shown}");
        // Around the hidden pixels, there are mixed ones: they are seen, but not merged.
        assert!(mixed > 30, "frame {i}: {mixed} mixed");
    }
    let flat: Vec<GreyPyramid> = photographs(EXPOSURES, far, far).into_iter().map(GreyPyramid::new).collect();
    assert!(relief_of(&flat, &starts, 2).is_none(), "one shift fits everywhere");
}

#[test]
fn bracket_is_aligned_at_its_depths_and_again_from_its_transforms() {
    let photographs = photographs(EXPOSURES, FAR, NEAR);
    let frames = photographs.iter().zip(EXPOSURES).enumerate();
    let frames = frames.map(|(i, (grey, ev))| frame(&format!("{i}"), grey, ev)).collect();
    let bracket = Bracket::new(frames, &ReferenceChoice::Number(2)).unwrap();
    let (first, warnings) = align(&bracket, &AlignOptions::default()).unwrap();
    assert!(warnings.is_empty(), "{warnings:?}");
    assert!(
        [0, 2].iter().all(|&i| first.cause(i) == Some(Cause::Depth) && first.placements[i].confidence() > 0.9),
        "{first:?}"
    );
    let saved = SavedAlignment::of(&bracket, &first).to_json();
    let given = SavedAlignment::from_json(&saved, Path::new("t.json")).unwrap().frames;
    let (again, _) = align(&bracket, &AlignOptions { given, ..AlignOptions::default() }).unwrap();
    assert!(again.followed == first.followed && again.overlap == first.overlap);
    // A frame covers less of the reference if each pixel may have any of the depths.
    let (flat, warnings) = align(&bracket, &AlignOptions { local: Local::Off, ..AlignOptions::default() }).unwrap();
    assert!(flat.followed.is_none() && !warnings.is_empty(), "{warnings:?}");
    let area = |alignment: &Alignment| alignment.overlap.width() * alignment.overlap.height();
    assert!(area(&first) < area(&flat));
}
