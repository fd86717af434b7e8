use super::*;
use crate::align::Transform;
use crate::bracket::Samples;
use crate::bracket::exposure::Exposure;
use crate::merge::weight::Weight;
use crate::merge::{MergeOptions, merge};
use crate::response::tests::still;

const SIZE: (usize, usize) = (240, 180);

/// Returns the radiance of tiles of several brightnesses, from 0.02 to 1.3.
fn background(x: usize, y: usize) -> [f64; 3] {
    let e = libm::exp2(((x / 24) * 5 + (y / 20) * 3) as f64 % 13.0 / 2.0 - 5.6);
    [e, 0.9 * e, 0.7 * e]
}

/// Whether a pixel is in a disc with a radius of 24 pixels around `about`.
fn disc(x: usize, y: usize, about: (usize, usize)) -> bool {
    let (dx, dy) = (x as f64 - about.0 as f64, y as f64 - about.1 as f64);
    dx * dx + dy * dy < 24.0 * 24.0
}

/// Returns a bracket of three frames; frame 0 (the shortest) shows `scenes[0]` and so on.
fn bracket(scenes: [&dyn Fn(usize, usize) -> [f64; 3]; 3]) -> (Bracket, Alignment) {
    let times = [0.25, 1.0, 4.0];
    let frames = (0..3).map(|i| still(SIZE, &times, scenes[i]).0.frames()[i].clone()).collect();
    let bracket = Bracket::new(frames, &crate::bracket::ReferenceChoice::Number(2)).unwrap();
    let alignment = Alignment::unmoved(&bracket);
    (bracket, alignment)
}

fn seek(bracket: &Bracket, alignment: &Alignment) -> Ghosts {
    find(bracket, alignment, &ResponseCurve::srgb(), alignment.overlap, AUTO, None).unwrap()
}

fn merged(bracket: &Bracket, alignment: &Alignment, ghosts: Option<&Ghosts>) -> Plane<[f32; 3]> {
    let options = MergeOptions { weight: Weight::Hat, region: alignment.overlap };
    merge(bracket, alignment, &ResponseCurve::srgb(), &options, ghosts).unwrap().0.pixels
}

#[test]
fn deghosting_without_motion_changes_nothing() {
    let (bracket, alignment) = bracket([&background; 3]);
    let ghosts = seek(&bracket, &alignment);
    let report = ghosts.report();
    assert_eq!((report.ghost_fraction, report.frames.len()), (0.0, 2));
    assert!(ghosts.mask().as_slice().iter().all(|&m| m == 0));
    let options = MergeOptions { weight: Weight::Hat, region: alignment.overlap };
    let plain = merge(&bracket, &alignment, &ResponseCurve::srgb(), &options, None).unwrap().0.pixels;
    assert_eq!(merged(&bracket, &alignment, Some(&ghosts)), plain);
}

#[test]
fn a_mover_is_left_out_and_the_rest_is_untouched() {
    for frame in [0, 2] {
        // The disc is neither black in the shortest frame nor clipped in the longest: it must be removed.
        let mover = |x, y| if disc(x, y, (100, 80)) { [0.12, 0.1, 0.14] } else { background(x, y) };
        let mut scenes: [&dyn Fn(usize, usize) -> [f64; 3]; 3] = [&background; 3];
        scenes[frame] = &mover;
        let (with_mover, alignment) = bracket(scenes);
        let (without, _) = bracket([&background; 3]);
        let ghosts = seek(&with_mover, &alignment);
        let found = merged(&with_mover, &alignment, Some(&ghosts));
        let (truth, plain) = (merged(&without, &alignment, None), merged(&with_mover, &alignment, None));
        let error = |map: &Plane<[f32; 3]>| {
            let ratio = |(a, b): (&[f32; 3], &[f32; 3])| (a[1] / b[1]).max(b[1] / a[1]) - 1.0;
            let all: Vec<f32> = map.as_slice().iter().zip(truth.as_slice()).map(ratio).collect();
            all.iter().sum::<f32>() / all.len() as f32
        };
        assert!(error(&found) < 0.1 * error(&plain), "frame {frame}: {} of {}", error(&found), error(&plain));
        // Far from the disc all three frames are merged as without deghosting.
        assert_eq!(found.rows(150..180), plain.rows(150..180));
        let shares: Vec<f64> = ghosts.report().frames.iter().map(|f| f.ghost_fraction).collect();
        let (moved, other) = if frame == 0 { (shares[0], shares[1]) } else { (shares[1], shares[0]) };
        // The disc is 4.2 % of the picture. Less may be found, because some tiles behind it have the same brightness;
        // more may be found, because a margin of up to 14 pixels is also removed.
        assert!((0.02..0.105).contains(&moved) && other == 0.0, "frame {frame}: {shares:?}");
    }
}

#[test]
fn clipped_reference_is_replaced_as_standard_by_the_next_frame_that_agrees() {
    // The reference is clipped at 1. One of the two shorter frames has a dark object in front of the sky: in the first
    // case the shortest frame, in the second case the next longer one.
    let sky = |_: usize, _: usize| [2.5, 2.6, 2.8];
    let times = [0.0625, 0.25, 1.0, 4.0];
    for frame in [0, 1] {
        let scene = |i: usize| {
            move |x: usize, y: usize| {
                if i == frame && disc(x, y, (120, 90)) { [0.3, 0.2, 0.2] } else { sky(x, y) }
            }
        };
        let frames = (0..4).map(|i| still(SIZE, &times, scene(i)).0.frames()[i].clone()).collect();
        let bracket = Bracket::new(frames, &crate::bracket::ReferenceChoice::Number(3)).unwrap();
        let alignment = Alignment::unmoved(&bracket);
        let ghosts = seek(&bracket, &alignment);
        let (found, plain) = (merged(&bracket, &alignment, Some(&ghosts)), merged(&bracket, &alignment, None));
        let far = plain.at(5, 5)[1];
        // In the shortest frame (exposure 1/16), the sky of 2.6 has code value 112, where a step of one code value is 2
        // % of the radiance.
        assert!((found.at(120, 90)[1] / far - 1.0).abs() < 0.03, "frame {frame}: {} for {far}", found.at(120, 90)[1]);
        assert!(plain.at(120, 90)[1] < 0.9 * far, "the mover is no test: {} for {far}", plain.at(120, 90)[1]);
    }
}

#[test]
fn sky_that_is_clipped_in_all_frames_has_no_outlines_of_what_moved() {
    // The sky is clipped in all three frames. In each of the two shorter frames, a dark object is elsewhere.
    let sky = |_: usize, y: usize| if y < 150 { [40.0; 3] } else { [0.2; 3] };
    let with =
        |at: (usize, usize)| move |x: usize, y: usize| if disc(x, y, at) { [0.2, 0.15, 0.15] } else { sky(x, y) };
    let times = [1.0 / 16.0, 0.25, 1.0];
    let frames = vec![
        still(SIZE, &times, with((150, 90))).0.frames()[0].clone(),
        still(SIZE, &times, with((60, 90))).0.frames()[1].clone(),
        still(SIZE, &times, sky).0.frames()[2].clone(),
    ];
    let bracket = Bracket::new(frames, &crate::bracket::ReferenceChoice::Number(3)).unwrap();
    let alignment = Alignment::unmoved(&bracket);
    let found = merged(&bracket, &alignment, Some(&seek(&bracket, &alignment)));
    // The shortest frame is clipped, so it gives a lower bound of the radiance of the sky. Where an object hides the
    // sky in that frame, and around the objects, the result is about this bound, too.
    let bound = found.at(5, 5)[1];
    for x in 0..SIZE.0 {
        assert!(found.at(x, 90)[1] > 0.9 * bound, "{x}: {} for {bound}", found.at(x, 90)[1]);
    }
}

#[test]
fn clipped_reference_is_continued_where_shorter_frames_show_motion() {
    // The scene is a sky that doubles in radiance from left to right, and is clipped in the reference. The only shorter
    // frame has a dark object in front of the sky. Below the sky is ground that no frame clips.
    let sky = |x: usize, y: usize| if y < 150 { [2.0 + 2.0 * x as f64 / SIZE.0 as f64; 3] } else { [0.2; 3] };
    let mover = |x: usize, y: usize| if disc(x, y, (120, 90)) { [0.2, 0.15, 0.15] } else { sky(x, y) };
    let times = [0.125, 1.0];
    let (shorter, reference) =
        (still(SIZE, &times, mover).0.frames()[0].clone(), still(SIZE, &times, sky).0.frames()[1].clone());
    let bracket = Bracket::new(vec![shorter, reference], &crate::bracket::ReferenceChoice::Number(2)).unwrap();
    let alignment = Alignment::unmoved(&bracket);
    let ghosts = seek(&bracket, &alignment);
    let found = merged(&bracket, &alignment, Some(&ghosts));
    let scale = f64::from(found.at(20, 20)[1]) / sky(20, 20)[1];
    for (x, y) in [(120, 90), (110, 80), (135, 95), (98, 90), (142, 90)] {
        // The tolerance of 12 % has two parts. A difference of one code value is 2 % of the radiance at code value 120.
        // And the hole is filled with means of areas that are at most 64 pixels wide. In such an area, the sky differs
        // from its mean by up to a tenth.
        let expected = scale * sky(x, y)[1];
        assert!(
            (f64::from(found.at(x, y)[1]) / expected - 1.0).abs() < 0.12,
            "{x} {y}: {} for {expected}",
            found.at(x, y)[1]
        );
    }
    let fraction = ghosts.report().continued_fraction;
    // The disc is 4.2 % of the picture, and a margin of up to 14 pixels around it is also removed.
    assert!((0.04..0.1).contains(&fraction), "{fraction}");
    // The ground is merged as without deghosting. In a bracket without motion nothing is filled.
    assert_eq!(found.row(170), merged(&bracket, &alignment, None).row(170));
    let (still, alignment) = self::bracket([&sky; 3]);
    assert_eq!(seek(&still, &alignment).report().continued_fraction, 0.0);
}

#[test]
fn continuation_has_the_surrounding_colour_without_seam() {
    // The scene is a sunny wall that is white in the reference. The shorter frame shows a shadow with a soft edge on
    // the wall.
    let sun = [3.0, 2.4, 1.4];
    let shadow = |x: usize, y: usize| {
        let (dx, dy) = (x as f64 - 120.0, y as f64 - 90.0);
        let lit = ((libm::sqrt(dx * dx + dy * dy) - 20.0) / 24.0).clamp(0.05, 1.0);
        sun.map(|e| lit * e)
    };
    let wall = |_: usize, _: usize| sun;
    let (bracket, alignment) = bracket([&shadow, &wall, &wall]);
    let ghosts = seek(&bracket, &alignment);
    let found = merged(&bracket, &alignment, Some(&ghosts));
    let lit = found.at(10, 90);
    let share = |x: usize| [0, 1, 2].map(|c| found.at(x, 90)[c] / lit[c]);
    for x in 60..180 {
        // The outer part of the shadow's edge is brighter than the clipping level of the reference. In red, this level
        // is a third of the sunlight. There the frame with the shadow does not contradict the reference, which only shows
        // that the radiance is at least this level. So part of the edge remains; it has at least half of the sunlight.
        // The level is the same in all channels, so blue, which has least sunlight, is raised by up to a tenth.
        let [r, g, b] = share(x);
        assert!(r > 0.5 && (g / r - 1.0).abs() < 0.04 && (b / r - 1.0).abs() < 0.12, "{x}: {:?}", share(x));
        // The tolerance allows for the edge of the shadow, which rises by 0.04 per pixel.
        assert!((r - share(x - 1)[0]).abs() < 0.1, "{x}: {r} after {}", share(x - 1)[0]);
    }
}

#[test]
fn bright_object_beside_motion_keeps_its_shape() {
    // The reference clips the bars, and the shorter frame shows them. In the shorter frame, a moving object is just
    // below the bars.
    let bars = |x: usize, y: usize| match (x / 8 % 2, y < 60) {
        (_, false) => [0.2, 0.25, 0.3],
        (0, true) => [3.0; 3],
        (_, true) => [2.0; 3],
    };
    let mover = |x, y: usize| if disc(x, y, (120, 90)) && y >= 66 { [0.9, 0.6, 0.5] } else { bars(x, y) };
    let (bracket, alignment) = bracket([&mover, &bars, &bars]);
    let ghosts = seek(&bracket, &alignment);
    assert!(ghosts.report().ghost_fraction > 0.02);
    let (found, plain) = (merged(&bracket, &alignment, Some(&ghosts)), merged(&bracket, &alignment, None));
    // The bars begin within the margin of the motion. Only the shorter frame shows them, so it keeps its weight there.
    let ratio = |x| found.at(x, 56)[1] / plain.at(x, 56)[1];
    assert!((100..140).all(|x| (0.99..1.01).contains(&ratio(x))), "{:?}", &found.row(56)[100..140]);
    assert!(found.at(120, 90)[0] < 0.5 * plain.at(120, 90)[0]);
}

#[test]
fn a_wall_that_is_black_in_a_short_frame_is_not_merged_with_who_stands_before_it() {
    // In the reference a dark person stands in front of a wall that the other two frames show. In the shortest frame
    // the wall has code value 3, which counts as black.
    let wall = |_: usize, _: usize| [0.03; 3];
    let before = |x: usize, y: usize| if disc(x, y, (100, 80)) { [0.004; 3] } else { wall(x, y) };
    let times = [0.03125, 1.0, 4.0];
    let scenes: [&dyn Fn(usize, usize) -> [f64; 3]; 3] = [&wall, &before, &wall];
    let frames = (0..3).map(|i| still(SIZE, &times, scenes[i]).0.frames()[i].clone()).collect();
    let bracket = Bracket::new(frames, &crate::bracket::ReferenceChoice::Number(2)).unwrap();
    let alignment = Alignment::unmoved(&bracket);
    let ghosts = seek(&bracket, &alignment);
    let at = |ghosts: Option<&Ghosts>| merged(&bracket, &alignment, ghosts).at(100, 80)[1];
    let shown = |ghosts| at(ghosts) / merged(&bracket, &alignment, None).at(200, 150)[1];
    // The person has radiance 0.004 and the wall 0.03. The tolerance is 6 %: in the reference the person has code value
    // 13, where half a code value is 4.5 %.
    assert!((shown(Some(&ghosts)) / (0.004 / 0.03) - 1.0).abs() < 0.06, "{}", shown(Some(&ghosts)));
    // The shortest frame keeps its weight where nothing moved.
    assert_eq!(ghosts.kept(0, 150..151).get(200).copied().unwrap_or(1.0), 1.0);
    assert!(ghosts.kept(0, 80..81)[100] == 0.0);
}

#[test]
fn mixed_channels_are_not_motion() {
    // In the long frame, blue is brighter by 0.02 in a disc. That is two thirds of the blue, but only a twenty-fifth of
    // a red of 0.5.
    let found = |red: f64| {
        let scene =
            move |more: f64| move |x, y| if disc(x, y, (100, 80)) { [red, 0.1, 0.03 + more] } else { [red, 0.1, 0.03] };
        let (still, mixed) = (scene(0.0), scene(0.02));
        let (bracket, alignment) = bracket([&still, &still, &mixed]);
        seek(&bracket, &alignment).report().ghost_fraction
    };
    assert_eq!(found(0.5), 0.0);
    assert!(found(0.03) > 0.02, "{}", found(0.03));
}

#[test]
fn a_faint_large_mover_is_found() {
    // The moving object is a disc that is 35 % brighter than its background.
    let smooth = |x: usize, y: usize| [0.1 + 0.0004 * x as f64, 0.1 + 0.0003 * y as f64, 0.12];
    let faint = |x: usize, y: usize| if disc(x, y, (100, 80)) { smooth(x, y).map(|e| 1.35 * e) } else { smooth(x, y) };
    let (moved, alignment) = bracket([&smooth, &smooth, &faint]);
    let found = seek(&moved, &alignment).report().ghost_fraction;
    assert!((0.03..0.105).contains(&found), "{found}");
}

#[test]
fn a_mover_before_a_wall_whose_colour_misfits_does_not_take_the_wall_along() {
    let wall = |x: usize, y: usize| if x < 80 { background(x, y) } else { [0.3, 0.12, 0.06] };
    let speck = |x: usize, y: usize| (180..192).contains(&x) && (80..92).contains(&y);
    let misfit = |x: usize, y: usize| {
        let [r, g, b] = wall(x, y);
        if speck(x, y) { [0.02; 3] } else { [if x < 80 { r } else { 1.2 * r }, g, b] }
    };
    let (bracket, alignment) = bracket([&wall, &wall, &misfit]);
    let found = seek(&bracket, &alignment).report().ghost_fraction;
    // The speck is a third of a percent of the picture. With its margin it is up to 32 pixels square, which is 2.4 %.
    assert!((0.002..0.025).contains(&found), "{found}");
}

#[test]
fn clipping_in_a_locally_processed_frame_is_no_bound() {
    // The reference clips the sky at 1. The shortest frame shows something darker there, such as a window that a phone
    // has darkened, or a moving object.
    let sky = |_: usize, _: usize| [2.5, 2.6, 2.8];
    let darker = |x, y| if disc(x, y, (120, 90)) { [0.3, 0.2, 0.2] } else { sky(x, y) };
    let (bracket, alignment) = bracket([&darker, &sky, &sky]);
    assert!(seek(&bracket, &alignment).report().frames[0].ghost_fraction > 0.02);
    let (curve, region) = (ResponseCurve::srgb(), alignment.overlap);
    let local = find(&bracket, &alignment, &curve, region, AUTO, Some(&|_, _| Vec::new())).unwrap();
    assert!(local.report().frames.iter().all(|frame| frame.ghost_fraction == 0.0), "{:?}", local.report());
}

#[test]
fn a_frame_that_is_brighter_all_over_has_not_moved() {
    // The exposure of the longest frame has an error of a sixth of a stop. That is 12 %, twice the 6 %
    // (`evidence::LEAST`) that are accepted in any case.
    let (mut frames, alignment) = bracket([&background; 3]);
    let brighter = |x, y| background(x, y).map(|e| 1.12 * e);
    let off = still(SIZE, &[0.25, 1.0, 4.0], brighter).0.frames()[2].clone();
    let list = vec![frames.frames()[0].clone(), frames.frames()[1].clone(), off];
    frames = Bracket::new(list, &crate::bracket::ReferenceChoice::Number(2)).unwrap();
    assert_eq!(seek(&frames, &alignment).report().ghost_fraction, 0.0);
}

#[test]
fn the_same_on_any_number_of_threads_and_in_any_region_size() {
    let mover = |x, y| if disc(x, y, (100, 80)) { [0.35, 0.3, 0.4] } else { background(x, y) };
    let (bracket, alignment) = bracket([&background, &background, &mover]);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| seek(&bracket, &alignment))
    };
    assert_eq!(on(1), on(3));
    for (width, height) in [(1, 1), (2, 3), (17, 1), (61, 67)] {
        let region = Rect { x0: 3, y0: 5, x1: 3 + width, y1: 5 + height };
        let curve = ResponseCurve::srgb();
        let ghosts = find(&bracket, &alignment, &curve, region, AUTO, None).unwrap();
        let mask = ghosts.mask();
        assert_eq!((mask.width(), mask.height()), (width, height));
    }
}

#[test]
fn the_strength_has_a_range_and_is_obeyed() {
    for strength in [-0.1, 1.1, f64::NAN] {
        assert!(Deghost::Strength(strength).validate().unwrap_err().is_usage());
    }
    let faint = |x, y| if disc(x, y, (100, 80)) { background(x, y).map(|e| 1.6 * e) } else { background(x, y) };
    let (bracket, alignment) = bracket([&background, &background, &faint]);
    let share = |strength| {
        let ghosts = find(&bracket, &alignment, &ResponseCurve::srgb(), alignment.overlap, strength, None).unwrap();
        ghosts.report().ghost_fraction
    };
    assert!(share(0.0) < share(0.5) && share(0.5) < share(1.0), "{} {} {}", share(0.0), share(0.5), share(1.0));
}

#[test]
fn cells_are_the_means_of_exposures() {
    let curve = ResponseCurve::srgb();
    let (width, height) = (13, 9);
    let codes: Vec<u8> = (0..3 * width * height).map(|i| (i * 89 % 256) as u8).collect();
    let deep = codes.iter().map(|&z| u16::from(z) * 257).collect();
    let region = Rect { x0: 2, y0: 1, x1: 10, y1: 9 };
    for samples in [Samples::Eight(codes.clone()), Samples::Sixteen(deep)] {
        let frame = Frame::new("a".into(), width, height, samples, Exposure::given(0.0).unwrap());
        for side in [2, 4] {
            let seen = |transform| {
                let (motion, meaning) = (Motion::new(&transform, (width, height)), Meaning::of(&curve, 0.5));
                cells::average(
                    &Layer { frame: &frame, motion, meaning, astray_px: 1.2, is_assumed: false },
                    region,
                    side,
                    0,
                )
                .unwrap()
            };
            let cells = seen(Transform::Identity);
            // A shift by 0 pixels, which uses other code, gives the same cells.
            let still = Transform::Rigid { dx: 0.0, dy: 0.0, angle: 0.0 };
            assert_eq!(cells, seen(still));
            // In cells of up to 4x4 pixels, all pixels are read.
            for (j, i, c) in [(0, 0, 0), (1, 1, 2), (0, 1, 1)] {
                let pixels = (0..side * side).map(|k| (2 + i * side + k % side, 1 + j * side + k / side));
                let code = |(x, y): (usize, usize)| f32::from(codes[3 * (y * width + x) + c]);
                let black = pixels.clone().any(|p| code(p) <= 5.0);
                let clipped = pixels.clone().any(|p| code(p) > 248.0);
                let mean = pixels.map(|p| 2.0 * curve.exposure(c, code(p))).sum::<f32>() / (side * side) as f32;
                let cell = cells.at(i, j);
                // The tolerance allows for sixteen roundings of one part in 2^24, and for a code value that is smaller
                // by 2^-16 when it is read from 16 bits.
                assert!(black || (cell.radiance[c] / mean - 1.0).abs() < 1e-4, "{} for {mean}", cell.radiance[c]);
                assert_eq!((cell.is_black(c), cell.is_clipped(c)), (black, clipped));
            }
        }
    }
}

#[test]
fn factors_between_cells_are_bilinear() {
    let map = Plane::from_vec(3, 2, vec![0u8, 255, 51, 102, 0, 204]);
    let region = Rect { x0: 0, y0: 0, x1: 5, y1: 4 };
    let ghosts = Ghosts {
        region,
        side: 2,
        strength: 0.5,
        frames: vec![("a".into(), Some(map)), ("r".into(), None)],
        holes: None,
    };
    let kept = ghosts.kept(0, 1..3);
    // By hand: the cells are centred on columns 0.5, 2.5 and 4.5, and on rows 0.5 and 2.5. Row 1 is a quarter of the
    // way from the first row of centres to the second. Column 2 is three quarters of the way from the first column of
    // centres to the second.
    let (left, right) = (0.25 * 0.4, 0.75);
    assert!((kept[2] - (0.25 * left + 0.75 * right)).abs() < 1e-6, "{kept:?}");
    assert!((kept[0] - 0.1).abs() < 1e-6);
    assert_eq!((kept.len(), ghosts.kept(1, 0..4).len()), (10, 0));
    // Only one frame is compared with the reference, so the mask is the fraction of this frame's weight that is
    // removed.
    assert_eq!(ghosts.mask().at(0, 1), (255.0f32 * 0.9 + 0.5) as u8);
}

#[test]
fn of_large_cells_a_quarter_is_looked_at() {
    let codes: Vec<u8> = (0..64).flat_map(|i| [if (i / 8, i % 8) == (1, 1) { 255 } else { 100 }; 3]).collect();
    let frame = Frame::new("a".into(), 8, 8, Samples::Eight(codes), Exposure::given(0.0).unwrap());
    let curve = ResponseCurve::srgb();
    let layer = Layer {
        frame: &frame,
        motion: Motion::unmoved((8, 8)),
        meaning: Meaning::of(&curve, 1.0),
        astray_px: 1.2,
        is_assumed: false,
    };
    let cell = cells::average(&layer, Rect { x0: 0, y0: 0, x1: 8, y1: 8 }, 8, 0).unwrap().at(0, 0);
    // Four blocks of 2x2 pixels are read; one of their 16 pixels is clipped.
    let mean = (15.0 * curve.exposure(0, 100.0) + curve.exposure(0, 255.0)) / 16.0;
    assert!((cell.radiance[0] / mean - 1.0).abs() < 1e-5 && cell.is_clipped(0), "{} for {mean}", cell.radiance[0]);
}

#[test]
fn strength_is_parsed_and_printed_as_typed() {
    for (text, expected) in [("auto", Deghost::Auto), ("off", Deghost::Off), ("0.25", Deghost::Strength(0.25))] {
        assert_eq!((text.parse(), expected.to_string().as_str()), (Ok(expected), text));
    }
    assert!("much".parse::<Deghost>().is_err());
    assert!(Deghost::default().strength() == Some(AUTO) && !Deghost::Off.is_on());
}

#[test]
fn flare_and_saturated_colours_are_not_motion() {
    // The long frame is brighter by up to a third towards the right, as with flare. In addition, its red is 15 % higher
    // everywhere. This happens with saturated colours, because one response for all frames cannot describe them.
    let veiled = |x: usize, y: usize| {
        let [r, g, b] = background(x, y).map(|e| e * (1.0 + 0.33 * x as f64 / SIZE.0 as f64));
        [1.15 * r, g, b]
    };
    let (bracket, alignment) = bracket([&background, &background, &veiled]);
    assert_eq!(seek(&bracket, &alignment).report().ghost_fraction, 0.0);
}
