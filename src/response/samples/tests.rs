use super::super::tests::still;
use super::*;
use crate::bracket::Frame;

/// Returns the radiance of tiles of 20 pixels, over ten stops.
fn tiles(x: usize, y: usize) -> [f64; 3] {
    [libm::exp2(((x / 20) * 7 + (y / 20) * 13) as f64 % 101.0 / 10.0 - 8.0); 3]
}

#[test]
fn samples_are_unclipped_brighten_and_cover_the_codes() {
    let (bracket, alignment) = still((400, 300), &[0.25, 1.0, 4.0], tiles);
    let drawn = draw(&[&Places::of(&bracket, &alignment).unwrap()], 500);
    for samples in &drawn.channels {
        assert!(samples.len() > 100 && samples.len() <= 500, "{}", samples.len());
        for s in samples {
            assert!(s.views.len() >= 2 && s.views.iter().all(|v| (SEEN.0..=SEEN.1).contains(&v.code)));
            assert!(s.views.windows(2).all(|v| v[0].code < v[1].code && v[0].ln_time < v[1].ln_time));
        }
        let seen = |from: f64| samples.iter().flat_map(|s| &s.views).any(|v| (from..from + 16.0).contains(&v.code));
        assert!((0..15).all(|k| seen(8.0 + 16.0 * k as f64)));
    }
}

#[test]
fn thinned_places_are_even_and_give_the_same_curve() {
    let (bracket, alignment) = still((400, 300), &[0.25, 1.0, 4.0], tiles);
    let all = Places::of(&bracket, &alignment).unwrap();
    let mut same = all.clone();
    same.thin(3 * all.places.len());
    assert_eq!(draw(&[&same], 500), draw(&[&all], 500), "there is room for all");
    let mut few = all.clone();
    few.thin(3 * 100 + 2);
    assert_eq!(few.places.len(), 100);
    // The places that are kept are spread evenly, up to the last row.
    let step = all.places.len() / 100;
    let kept = |place: &Candidate| {
        few.places.iter().filter(|p| p.patches[1].unwrap()[0].mean == place.patches[1].unwrap()[0].mean).count()
    };
    assert!(step > 3 && kept(all.places.last().unwrap()) > 0);
    let drawn = draw(&[&few], 500);
    assert!(drawn.channels.iter().all(|samples| samples.len() > 30 && samples.len() <= 100));
    few.thin(0);
    assert!(few.places.is_empty());
}

#[test]
fn edges_and_darkening_places_are_not_sampled() {
    let (bracket, alignment) = still((200, 200), &[0.5, 1.0], |x, _| [if x % 4 < 2 { 0.05 } else { 0.4 }; 3]);
    assert!(draw(&[&Places::of(&bracket, &alignment).unwrap()], 500).channels.iter().all(Vec::is_empty));
    let patch = |mean| Some([Patch { mean, deviation: 1.0, seen: true }; 3]);
    assert!(brightens(&[patch(50.0), None, patch(49.0)], 0));
    assert!(!brightens(&[patch(50.0), None, patch(40.0)], 0));
}

#[test]
fn film_base_is_black() {
    // A camera whose black is code 18: short exposures of dark places are not used.
    let (bracket, alignment) =
        still((400, 300), &[1.0 / 64.0, 1.0 / 8.0, 1.0], |x, y| tiles(x, y).map(|e| e.max(1e-9)));
    assert!(draw(&[&Places::of(&bracket, &alignment).unwrap()], 500).black.iter().all(|&b| b < 4.0));
    let frames = bracket.frames().iter().map(|frame| {
        let whole = frame.whole().unwrap();
        let Codes::Eight(codes) = whole.codes() else { unreachable!() };
        let lifted = codes.iter().map(|&z| (18.0 + f64::from(z) * 237.0 / 255.0) as u8).collect();
        Frame::new(frame.path().to_owned(), 400, 300, crate::bracket::Samples::Eight(lifted), frame.exposure.clone())
    });
    let lifted = Bracket::new(frames.collect(), &crate::bracket::ReferenceChoice::Number(2)).unwrap();
    assert!(draw(&[&Places::of(&lifted, &alignment).unwrap()], 500).black.iter().all(|&b| (18.0..24.0).contains(&b)));
}

#[test]
fn a_mover_is_not_black() {
    // In the second frame somebody stands in front of a dim wall, as dark as the wall is in the first frame: the
    // place becomes no brighter.
    let wall = |x: usize, y: usize| if x < 200 && y < 150 { [0.04; 3] } else { tiles(x, y) };
    let coat = |x: usize, y: usize| if x < 200 && y < 150 { [0.01; 3] } else { tiles(x, y) };
    let times = [0.25, 1.0, 4.0];
    let scenes: [&dyn Fn(usize, usize) -> [f64; 3]; 3] = [&wall, &coat, &wall];
    let frames = (0..3).map(|i| still((400, 300), &times, scenes[i]).0.frames()[i].clone()).collect();
    let bracket = Bracket::new(frames, &crate::bracket::ReferenceChoice::Number(2)).unwrap();
    let alignment = crate::align::Alignment::unmoved(&bracket);
    let places = Places::of(&bracket, &alignment).unwrap();
    let is_silent = |place: &&Candidate| telling(place, &places.frames, 0).start > 0;
    assert!(places.places.iter().filter(is_silent).count() > BLACK.0, "the mover is no test");
    assert_eq!(draw(&[&places], 500).black, [0.0; 3]);
}

#[test]
fn codes_are_parted_where_the_fewest_are_on_the_wrong_side() {
    let parted = |below: &[f64], above: &[f64]| parting(below.iter().copied(), above.to_vec());
    assert_eq!(parted(&[1.0, 2.0, 3.0], &[4.0, 5.0]), 3.0);
    // 9.0 and 2.5 are on the wrong side.
    assert_eq!(parted(&[1.0, 2.0, 3.0, 3.5, 9.0], &[2.5, 4.0, 5.0, 6.0]), 3.5);
    assert_eq!(parted(&[9.0], &[1.0, 2.0]), f64::MIN);
    assert_eq!(parted(&[], &[]), f64::MIN);
}

#[test]
fn blocks_of_noise_in_black_are_black() {
    // Nine exposures of a scene of which a third is black. JPEG leaves blocks of codes 0 to 2 there, different in
    // each frame, sometimes darker and sometimes brighter.
    let times: Vec<f64> = (0..9).map(|i| libm::exp2(f64::from(i) - 4.0)).collect();
    let (bracket, alignment) =
        still((400, 300), &times, |x, y| if x < 130 { [1e-6; 3] } else { tiles(x, y).map(|e| e * 0.1) });
    let noisy = bracket.frames().iter().enumerate().map(|(i, frame)| {
        let whole = frame.whole().unwrap();
        let Codes::Eight(codes) = whole.codes() else { unreachable!() };
        let block =
            |pixel: usize| (pixel % 400 / 8 * 37 + pixel / 400 / 8 * 101 + i * 53).wrapping_mul(2654435761) >> 7;
        let lifted = codes.iter().enumerate().map(|(k, &z)| z.max([0, 1, 1, 2][block(k / 3) % 4])).collect();
        let samples = crate::bracket::Samples::Eight(lifted);
        Frame::new(frame.path().to_owned(), 400, 300, samples, frame.exposure.clone())
    });
    let noisy = Bracket::new(noisy.collect(), &crate::bracket::ReferenceChoice::Number(5)).unwrap();
    let black = draw(&[&Places::of(&noisy, &alignment).unwrap()], 500).black;
    assert!(black.iter().all(|b| (1.0..3.0).contains(b)), "{black:?}");
}
