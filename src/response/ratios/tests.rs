use super::super::samples::View;
use super::super::tests::still;
use super::*;
use crate::align::Alignment;
use crate::bracket::exposure::Exposure;
use crate::bracket::{Frame, ReferenceChoice};

/// Returns a number in -0.5..0.5 that depends only on the seed.
fn noise(seed: usize) -> f64 {
    let x = (seed as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let x = (x ^ (x >> 31)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    ((x ^ (x >> 29)) >> 11) as f64 / (1u64 << 53) as f64 - 0.5
}

/// Returns places of evenly spread brightness, photographed at `exposures` by a camera with a steeper curve than
/// sRGB's. The recorded exposures are `written`. In an eighth of the places something moved.
fn scene(exposures: &[f64], written: &[f64]) -> [Vec<Sample>; 3] {
    std::array::from_fn(|c| {
        let place = |i: usize| {
            let ln_e = (11.0 * i as f64 / 500.0 - 9.0) * LN_2;
            let views = exposures.iter().zip(written).enumerate().filter_map(|(j, (stops, written))| {
                let moved = if i % 8 == 3 && j == 1 { 0.3 } else { 0.0 };
                let light = libm::exp(ln_e + (stops + moved) * LN_2).min(1.0);
                let z = 255.0 * libm::pow(light, 1.0 / (2.9 + 0.1 * c as f64)) + 1.5 * noise(31 * i + 7 * j + c);
                (2.0..=253.0).contains(&z).then_some(View { code: z, ln_time: written * LN_2 })
            });
            Sample { views: views.collect() }
        };
        (0..500).map(place).filter(|s| s.views.len() >= 2).collect()
    })
}

fn found(exposures: &[f64], written: &[f64]) -> Vec<f64> {
    let times: Vec<f64> = written.iter().map(|s| s * LN_2).collect();
    fit(&scene(exposures, written), &times, 0.07).unwrap()
}

/// Returns the part of the errors `wrong` that can be determined from pixels. Two parts cannot: a factor that is common
/// to all exposures, and a power to which all exposures `written` are raised.
fn knowable(wrong: &[f64], written: &[f64]) -> Vec<f64> {
    let v = DVector::from_row_slice(wrong);
    free_directions(written).iter().fold(DVector::zeros(wrong.len()), |sum, b| sum + b * b.dot(&v)).as_slice().to_vec()
}

#[test]
fn wrong_exposures_are_corrected_as_far_as_determined() {
    let (exact, wrong) = ([-4.0, -2.5, -1.0, 0.5, 2.0], [0.09, -0.12, 0.05, 0.1, -0.07]);
    let written: Vec<f64> = exact.iter().zip(wrong).map(|(e, w)| e + w).collect();
    let (got, wanted) = (found(&exact, &written), knowable(&wrong.map(|w| -w), &written));
    // Noise of half a code over 500 places causes an error far below the tolerance. The prior and motion cause an
    // error of a hundredth of a stop.
    assert!(got.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 0.012), "{got:?} for {wanted:?}");
    assert!(wanted.iter().any(|w| w.abs() > 0.08));
}

#[test]
fn exact_exposures_are_not_corrected() {
    let exact = [-4.0, -2.5, -1.0, 0.5, 2.0];
    assert!(found(&exact, &exact).iter().all(|d| d.abs() < STILL / 2.0));
}

#[test]
fn a_common_factor_and_a_common_power_are_kept_as_written() {
    let written = [-4.3, -2.0, -0.9, 0.2, 2.2];
    let got = found(&[-4.0, -2.0, -1.0, 0.3, 2.0], &written);
    let (sum, along) = (got.iter().sum::<f64>(), got.iter().zip(written).map(|(d, t)| d * t).sum::<f64>());
    assert!(sum.abs() < 1e-9 && along.abs() < 1e-9, "{got:?}");
    assert!(free_directions(&[0.0, 1.0]).is_empty() && free_directions(&[0.0]).is_empty());
    assert_eq!(free_directions(&[0.0, 1.0, 3.0]).len(), 1);
}

/// The expected result is from one dense system of normal equations with all unknowns: neither ln E nor the splines are
/// eliminated, and there is no separate projection.
#[test]
fn elimination_gives_the_solution_of_the_whole_system() {
    let written = [-3.0, -1.4, 0.0, 1.6];
    let exact = [-3.1, -1.5, 0.1, 1.5];
    let samples = scene(&exact, &written).map(|s| s.into_iter().step_by(9).collect::<Vec<_>>());
    let times: Vec<f64> = written.iter().map(|s| s * LN_2).collect();
    let free = DMatrix::from_columns(&free_directions(&times));
    let trust: Vec<Vec<f64>> = samples.iter().map(|s| vec![1.0; s.len()]).collect();
    let sums: Vec<Sums> = (0..3).map(|c| Sums::of(&samples[c], &trust[c], &times)).collect();
    let (sigma, error) = (0.07 * LN_2, 0.02);
    let (_, d) = solve(&sums, &free, error, sigma).unwrap();

    let places: usize = samples.iter().map(Vec::len).sum();
    let unknowns = 3 * SPLINE + free.ncols() + places;
    let weight: f64 = samples.iter().flatten().flat_map(|s| &s.views).map(|v| hat(v.code) * hat(v.code)).sum();
    // An equation: its unknowns with their coefficients, its right side, its weight.
    type Row = (Vec<(usize, f64)>, f64, f64);
    let mut rows: Vec<Row> = Vec::new();
    let mut place = 3 * SPLINE + free.ncols();
    for (c, channel) in samples.iter().enumerate() {
        for sample in channel {
            for view in &sample.views {
                let j = times.iter().position(|&t| t == view.ln_time).unwrap();
                let (first, b) = spline(view.code);
                let mut row: Vec<(usize, f64)> = (0..4).map(|k| (c * SPLINE + first + k, b[k])).collect();
                row.extend((0..free.ncols()).map(|k| (3 * SPLINE + k, -free[(j, k)])));
                row.push((place, -1.0));
                rows.push((row, view.ln_time - base(view.code), hat(view.code).powi(2) / weight));
            }
            place += 1;
        }
        for k in 1..SPLINE - 1 {
            let at = c * SPLINE + k;
            rows.push((vec![(at - 1, 1.0), (at, -2.0), (at + 1, 1.0)], 0.0, SMOOTHNESS));
        }
        rows.push((vec![(c * SPLINE + SPLINE / 2, 1.0)], 0.0, 1.0));
        rows.extend((0..SPLINE).map(|k| (vec![(c * SPLINE + k, 1.0)], 0.0, 1e-10)));
    }
    let prior = error * error / (INDEPENDENT * sigma * sigma);
    rows.extend((0..free.ncols()).map(|k| (vec![(3 * SPLINE + k, 1.0)], 0.0, prior)));
    let (mut matrix, mut right) = (DMatrix::zeros(unknowns, unknowns), DVector::zeros(unknowns));
    for (row, value, w) in rows {
        for &(k, a) in &row {
            right[k] += w * a * value;
            for &(l, b) in &row {
                matrix[(k, l)] += w * a * b;
            }
        }
    }
    let x = matrix.cholesky().unwrap().solve(&right);
    let whole = &free * x.rows(3 * SPLINE, free.ncols());
    // The tolerance is the condition number of either system of normal equations, about 1e9, times the rounding error
    // of 2e-16, with a margin.
    assert!((&whole - &d).amax() < 1e-6, "{whole} {d}");
}

/// Returns the radiance of tiles of 20 pixels, over ten stops.
fn tiles(x: usize, y: usize) -> [f64; 3] {
    let e = libm::exp2(((x / 20) * 7 + (y / 20) * 13) as f64 % 101.0 / 10.0 - 8.0);
    [e, 1.1 * e, 0.8 * e]
}

/// Returns `frame` with another exposure.
fn exposed(frame: &Frame, exposure: Exposure) -> Frame {
    let mut frame = frame.clone();
    frame.exposure = exposure;
    frame
}

/// Returns a bracket of exposures `times`, with the exposure times `written` in its EXIF.
fn written(times: &[f64], written: &[f64]) -> (Bracket, Alignment) {
    let (bracket, alignment) = still((400, 300), times, tiles);
    let frames = bracket.frames().iter().zip(written).map(|(frame, &time)| {
        let exposure = Exposure::from_camera(time, None, None, String::new()).unwrap();
        exposed(frame, exposure)
    });
    (Bracket::new(frames.collect(), &ReferenceChoice::Number(2)).unwrap(), alignment)
}

#[test]
fn a_bracket_is_corrected_within_bounds_but_not_against_the_user() {
    let times = [0.0625, 0.25, 1.0, 4.0];
    let (exact, alignment) = written(&times, &times);
    assert!(corrections(&exact, &Places::of(&exact, &alignment).unwrap()).0.iter().all(|c| c.stops == 0.0));

    let (rounded, alignment) = written(&times, &[0.0625, 0.23, 1.08, 4.0]);
    let mut places = Places::of(&rounded, &alignment).unwrap();
    let (tuned, warnings) = fine_tuned(rounded, &mut places);
    // The places have the corrected exposures: there is nothing left to correct.
    assert!(corrections(&tuned, &places).0.iter().all(|c| c.stops == 0.0));
    let ev: Vec<f64> = tuned.frames().iter().map(|f| f.exposure.ev()).collect();
    // Twice the second exposure step minus the first and the third is 0 for three equal steps, for any common power.
    assert!((ev[0] - 3.0 * ev[1] + 3.0 * ev[2] - ev[3]).abs() < 0.03, "{ev:?}");
    assert!(warnings.is_empty() && tuned.frames()[1].exposure.correction_stops() > 0.05);

    let (wild, alignment) = written(&times, &[0.0625, 0.12, 1.9, 4.0]);
    let (found, warnings) = corrections(&wild, &Places::of(&wild, &alignment).unwrap());
    assert!(found.iter().all(|c| c.stops.abs() <= 1.0 / 6.0 + 1e-12) && !warnings.is_empty(), "{found:?}");

    let (given, alignment) = still((400, 300), &times, tiles);
    let exposures = [0.0625, 0.23, 1.08, 4.0].map(|t| Exposure::given(libm::log2(t)).unwrap());
    let frames = given.frames().iter().zip(exposures).map(|(frame, exposure)| exposed(frame, exposure));
    let given = Bracket::new(frames.collect(), &ReferenceChoice::Number(2)).unwrap();
    assert!(corrections(&given, &Places::of(&given, &alignment).unwrap()).0.iter().all(|c| c.stops == 0.0));
}
