use super::*;
use crate::bracket::colour::Primaries;
use crate::merge::Photographed;
use crate::tonemap::overview::Overview;

fn shown(map: &Plane<[f32; 3]>, photographed: Option<Photographed>, options: &Options) -> Plane<[u8; 3]> {
    let overview = Overview::new((map.width(), map.height()), &Primaries::SRGB);
    let mut overview = overview.photographed(photographed);
    overview.see(0, map);
    natural(&overview.scene().unwrap(), options).picture(map)
}

fn picture(map: &Plane<[f32; 3]>, options: &Options) -> Plane<[u8; 3]> {
    shown(map, None, options)
}

/// Returns a dark room with a window that is 10 stops brighter; both have texture.
fn room(factor: f32) -> Plane<[f32; 3]> {
    Plane::from_rows(240, 160, |y, row| {
        for (x, p) in row.iter_mut().enumerate() {
            let window = (80..160).contains(&x) && (40..120).contains(&y);
            let wave = 0.5 * libm::sinf(x as f32 * 0.8) * libm::cosf(y as f32 * 0.7);
            let l = factor * libm::exp2f(if window { 10.0 } else { 0.0 } + wave + x as f32 / 200.0);
            *p = [l, 0.9 * l, 0.7 * l];
        }
    })
}

fn mean(codes: &Plane<[u8; 3]>) -> f64 {
    codes.as_slice().iter().map(|p| f64::from(p[1])).sum::<f64>() / codes.as_slice().len() as f64
}

#[test]
fn a_factor_does_not_matter() {
    let one = picture(&room(1.0), &Options::default());
    let other = picture(&room(1024.0), &Options::default());
    let pairs = one.as_slice().iter().zip(other.as_slice());
    assert!(pairs.into_iter().all(|(p, q)| (0..3).all(|c| p[c].abs_diff(q[c]) <= 1)));
}

/// Room and window are both shown: neither is black or white, and the texture is visible in both.
#[test]
fn both_sides_of_an_edge_are_shown() {
    let codes = picture(&room(1.0), &Options::default());
    for (columns, rows) in [(5..60, 10..150), (90..150, 50..110)] {
        let values: Vec<u8> =
            rows.flat_map(|y| columns.clone().map(move |x| (x, y))).map(|(x, y)| codes.at(x, y)[1]).collect();
        let (low, high) = (*values.iter().min().unwrap(), *values.iter().max().unwrap());
        assert!(low > 15 && high - low > 15, "{low} {high}");
        let white = values.iter().filter(|v| **v == 255).count();
        assert!(white < values.len() / 10, "{white} of {}", values.len());
    }
}

/// The night scene is the same room, but its longest photograph is four stops darker. So the picture must be darker
/// too.
#[test]
fn night_scene_stays_dark() {
    let map = room(1.0);
    let to = |longest| Some(Photographed { longest, shortest: 1024.0, contrast: 1.3, white_stops: 2.5 });
    let (day, night) = (shown(&map, to(1.0), &Options::default()), shown(&map, to(16.0), &Options::default()));
    assert!(mean(&night) < 0.7 * mean(&day), "{} {}", mean(&night), mean(&day));
}

/// By default the picture has the mean code value of the fused photographs, and not [`BRIGHTNESS`]. If a brightness is
/// set, it is reached.
#[test]
fn default_brightness_is_that_of_the_fused_photographs() {
    let map = room(1.0);
    let of = |brightness| {
        let photographed = Photographed { longest: 0.001, shortest: 1024.0, contrast: 1.3, white_stops: 2.5 };
        mean(&shown(&map, Some(photographed), &Options { brightness, ..Options::default() })) / 255.0
    };
    let as_fused = of(None);
    assert!((as_fused - BRIGHTNESS).abs() > 0.02, "{as_fused}");
    for asked in [as_fused - 0.03, as_fused + 0.03] {
        assert!((of(Some(asked)) - asked).abs() < 0.02, "{asked}: {}", of(Some(asked)));
    }
}

#[test]
fn settings_have_their_documented_effect() {
    let map = room(1.0);
    let plain = picture(&map, &Options::default());
    assert!((mean(&plain) / 255.0 - BRIGHTNESS).abs() < 0.06, "{}", mean(&plain));
    let brighter = picture(&map, &Options { brightness: Some(0.55), ..Options::default() });
    assert!(mean(&brighter) > mean(&plain) + 5.0);
    let chroma =
        |codes: &Plane<[u8; 3]>| -> i32 { codes.as_slice().iter().map(|p| i32::from(p[0]) - i32::from(p[2])).sum() };
    let grey = picture(&map, &Options { saturation: 0.0, ..Options::default() });
    assert!(grey.as_slice().iter().all(|p| p[0] == p[1] && p[1] == p[2]));
    assert!(chroma(&picture(&map, &Options { saturation: 1.5, ..Options::default() })) > chroma(&plain));
    let deviation = |codes: &Plane<[u8; 3]>| {
        let row = &codes.row(80)[10..60];
        let mean = row.iter().map(|p| f64::from(p[1])).sum::<f64>() / 50.0;
        row.iter().map(|p| (f64::from(p[1]) - mean).powi(2)).sum::<f64>()
    };
    let steep = |contrast| deviation(&picture(&map, &Options { contrast, ..Options::default() }));
    assert!(steep(1.0) > 1.1 * steep(0.0), "{} {}", steep(1.0), steep(0.0));
}

/// Cells have 4 x 4 pixels here; `detail` amplifies contrast that is finer than a cell.
#[test]
fn detail_increases_contrast_finer_than_a_cell() {
    let map = Plane::from_rows(1600, 1200, |y, row| {
        for (x, p) in row.iter_mut().enumerate() {
            let l = libm::exp2f(x as f32 / 200.0 + if (x + y) % 2 == 0 { 0.1 } else { 0.0 });
            *p = [l; 3];
        }
    });
    let steps = |detail| {
        let codes = picture(&map, &Options { detail, ..Options::default() });
        codes.row(600)[700..900].windows(2).map(|p| u32::from(p[0][1].abs_diff(p[1][1]))).sum::<u32>()
    };
    assert!(f64::from(steps(2.0)) > 1.5 * f64::from(steps(1.0)), "{} {}", steps(2.0), steps(1.0));
}

/// Saturated colours over ten stops keep their OkLCh hue to within 10 degrees. Their chroma is at most the chroma of
/// the scene's colour at the same luminance, apart from the rounding of code values.
#[test]
fn hue_is_kept_and_saturation_does_not_increase() {
    let colours = [[1.0, 0.2, 0.06], [0.1, 0.3, 1.0], [0.2, 1.0, 0.1], [1.0, 0.9, 0.3]];
    let map = Plane::from_rows(240, 160, |y, row| {
        for (x, p) in row.iter_mut().enumerate() {
            let l = libm::exp2f(x as f32 / 24.0);
            *p = colours[y / 40].map(|c| c * l);
        }
    });
    let codes = picture(&map, &Options::default());
    let polar = |rgb: [f32; 3]| {
        let [_, a, b] = oklab::from_linear(rgb);
        ((a * a + b * b).sqrt(), b.atan2(a).to_degrees())
    };
    for y in (0..160).step_by(3) {
        for x in 0..240 {
            let shown = codes.at(x, y).map(|code| srgb_to_linear(f64::from(code) / 255.0) as f32);
            let (light, scene) = (luminance(shown), map.at(x, y));
            if light < 0.02 {
                continue;
            }
            let (chroma, hue) = polar(shown);
            let (most, of_scene) = polar(scaled(scene, light / luminance(scene)));
            assert!(chroma < most + 0.004, "{x} {y}: {chroma} of {most}");
            let turn = (hue - of_scene + 540.0).rem_euclid(360.0) - 180.0;
            assert!(chroma < 0.05 || turn.abs() < 10.0, "{x} {y}: {turn} degrees, chroma {chroma}");
        }
    }
}

#[test]
fn the_smallest_and_the_plainest_do_not_fail() {
    for (width, height) in [(1, 1), (2, 3), (40, 30)] {
        let codes = picture(&Plane::filled(width, height, [0.3; 3]), &Options::default());
        assert!(codes.as_slice().iter().all(|p| p[0] == p[1] && p[1] == p[2] && p[0] == codes.at(0, 0)[0]));
    }
}
