//! Exact exposure values for the nominal values (dial markings) that cameras write.
//!
//! In: the tags of a bracket. Out: the tags with exact values where the written values are nominal, else nothing. Cost:
//! a search in short tables. Source: the preferred numbers of ISO 2720 and of APEX (EXIF 2.32, annex C): times are
//! powers of 2^(1/3) or 2^(1/2) s, f-numbers are powers of the square roots of 2^(1/3) or 2^(1/2), sensitivities are
//! 100 times a power of 2^(1/3).
//!
//! Nominal values are rounded: a shutter at 1/30 is open for 1/32 s, one at 15 s for 16 s, f/11 is 11.31, ISO 250 is
//! 252. A Canon EOS that writes 1/30 s into ExposureTime confirms this: it writes 5, which is 1/32 s, into
//! ShutterSpeedValue.
//!
//! Measured or computed values must not be changed: phones write 1/33 s, 16666667/1000000000 s, f/1.79. So exact values
//! are used only if all times of the bracket are nominal and in one series (thirds or halves of a stop). In addition,
//! either all f-numbers and sensitivities must be nominal, or ShutterSpeedValue must confirm the exact times.

use super::{ExposureTags, Tagged};

/// Nominal values that stand for successive powers of 2^(1/3). They are times in seconds from 1 s up, and denominators
/// of times below 1 s.
const THIRDS: [f64; 43] = [
    1.0, 1.3, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.0, 8.0, 10.0, 13.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 60.0, 80.0,
    100.0, 125.0, 160.0, 200.0, 250.0, 320.0, 400.0, 500.0, 640.0, 800.0, 1000.0, 1250.0, 1600.0, 2000.0, 2500.0,
    3200.0, 4000.0, 5000.0, 6400.0, 8000.0, 10_000.0, 12_800.0, 16_000.0,
];
/// Alternative markings of times: the value in seconds, and the number of thirds of a stop by which it is above 1 s;
/// negative below 1 s.
const OTHER_THIRDS: [(f64, i32); 5] = [(0.8, -1), (0.6, -2), (0.3, -5), (1.0 / 3.0, -5), (3.0, 5)];
/// `HALVES` and `OTHER_HALVES` are like [`THIRDS`] and [`OTHER_THIRDS`], but in halves of a stop: powers of 2^(1/2).
const HALVES: [f64; 27] = [
    1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0, 15.0, 22.0, 30.0, 45.0, 60.0, 90.0, 125.0, 180.0, 250.0, 350.0, 500.0,
    750.0, 1000.0, 1500.0, 2000.0, 3000.0, 4000.0, 6000.0, 8000.0,
];
const OTHER_HALVES: [(f64, i32); 6] = [(0.7, -1), (0.3, -3), (10.0, 7), (0.1, -7), (20.0, 9), (0.05, -9)];
/// Nominal f-numbers from 1 up. `F_THIRDS` stand for successive powers of 2^(1/6), `F_HALVES` for successive powers of
/// 2^(1/4).
const F_THIRDS: [f64; 34] = [
    1.0, 1.1, 1.2, 1.4, 1.6, 1.8, 2.0, 2.2, 2.5, 2.8, 3.2, 3.5, 4.0, 4.5, 5.0, 5.6, 6.3, 7.1, 8.0, 9.0, 10.0, 11.0,
    13.0, 14.0, 16.0, 18.0, 20.0, 22.0, 25.0, 29.0, 32.0, 36.0, 40.0, 45.0,
];
const F_HALVES: [f64; 21] =
    [1.0, 1.2, 1.4, 1.7, 2.0, 2.4, 2.8, 3.3, 4.0, 4.8, 5.6, 6.7, 8.0, 9.5, 11.0, 13.0, 16.0, 19.0, 22.0, 27.0, 32.0];
/// Nominal sensitivities from ISO 25 up. They stand for successive powers of 2^(1/3), times 25.
const ISO_THIRDS: [f64; 37] = [
    25.0, 32.0, 40.0, 50.0, 64.0, 80.0, 100.0, 125.0, 160.0, 200.0, 250.0, 320.0, 400.0, 500.0, 640.0, 800.0, 1000.0,
    1250.0, 1600.0, 2000.0, 2500.0, 3200.0, 4000.0, 5000.0, 6400.0, 8000.0, 10_000.0, 12_800.0, 16_000.0, 20_000.0,
    25_600.0, 32_000.0, 40_000.0, 51_200.0, 64_000.0, 80_000.0, 102_400.0,
];

/// Relative tolerance for matching a nominal value. Written decimals are truncated: 333/10000 s is 0.1 % below 1/30 s.
/// Neighbouring nominal values differ by 7 % or more.
const SAME: f64 = 2e-3;
/// ShutterSpeedValue confirms the exact time if the two differ by at most this, in stops. Some cameras round
/// ShutterSpeedValue to eighths of a stop. This changes multiples of a third of a stop by at most 0.042 stops, and
/// other values by at most 0.0625 stops.
const CONFIRMED: f64 = 0.05;
/// The nominal time is certainly rounded if ShutterSpeedValue differs from it by at least this, in stops. For
/// comparison: 1/30 s and 1/32 s differ by 0.093 stops.
const APART: f64 = 0.06;

/// Returns `written` with exact values: exact times, and exact f-numbers and sensitivities where all of them are
/// nominal. `None` unless the conditions at the top of this file are met.
pub(super) fn exact(written: &[ExposureTags]) -> Option<Vec<ExposureTags>> {
    if !written.iter().all(|n| n.is_time_printed) {
        return None;
    }
    let times = of_series(written, |n| n.time_s, &[thirds_of_time, halves_of_time])?;
    let f_numbers = of_series(written, |n| n.f_number, &[thirds_of_f_number, halves_of_f_number]);
    let isos = of_series(written, |n| n.iso, &[thirds_of_iso]);
    // An f-number that is not nominal, such as f/4.9, may be from a phone, whose times are not rounded. Then exact
    // times are used only if ShutterSpeedValue confirms them.
    if (f_numbers.is_none() || isos.is_none()) && !is_confirmed(written, &times) {
        return None;
    }
    let exact = written.iter().enumerate().map(|(i, n)| ExposureTags {
        time_s: times[i],
        f_number: f_numbers.as_ref().map_or(n.f_number, |exact| exact[i]),
        iso: isos.as_ref().map_or(n.iso, |exact| exact[i]),
        ..*n
    });
    Some(exact.collect())
}

/// Whether ShutterSpeedValue agrees with the exact time of every frame, and differs from the nominal time of at least
/// one frame.
fn is_confirmed(written: &[ExposureTags], times: &[Tagged]) -> bool {
    let off = |n: &ExposureTags, time: Tagged| Some((n.shutter_speed? + libm::log2(time?.0)).abs());
    let is_exact = |(n, time): (&ExposureTags, &Tagged)| off(n, *time).is_some_and(|stops| stops <= CONFIRMED);
    let is_rounded = |n: &ExposureTags| off(n, n.time_s).is_some_and(|stops| stops >= APART);
    written.iter().zip(times).all(is_exact) && written.iter().any(is_rounded)
}

/// Returns the exact values of all frames, taken from the first of the `series` that contains all of them. A missing
/// value stays missing.
fn of_series(
    written: &[ExposureTags],
    value: impl Fn(&ExposureTags) -> Tagged,
    series: &[fn(f64) -> Option<f64>],
) -> Option<Vec<Tagged>> {
    series.iter().find_map(|exact| {
        let of = |n: &ExposureTags| match value(n) {
            None => Some(None),
            Some((v, tag)) => Some(Some((exact(v)?, tag))),
        };
        written.iter().map(of).collect()
    })
}

fn is_same(value: f64, printed: f64) -> bool {
    (value - printed).abs() <= SAME * printed
}

fn index(value: f64, printed: &[f64]) -> Option<i32> {
    Some(printed.iter().position(|&p| is_same(value, p))? as i32)
}

/// Returns the index of a nominal time in its series: 0 for 1 s, positive for longer times, negative for shorter ones.
fn time_index(time: f64, printed: &[f64], others: &[(f64, i32)]) -> Option<i32> {
    let other = others.iter().find(|(p, _)| is_same(time, *p)).map(|(_, k)| *k);
    other.or_else(|| index(time, printed)).or_else(|| Some(-index(1.0 / time, printed)?))
}

fn thirds_of_time(time: f64) -> Option<f64> {
    Some(libm::exp2(f64::from(time_index(time, &THIRDS, &OTHER_THIRDS)?) / 3.0))
}

fn halves_of_time(time: f64) -> Option<f64> {
    Some(libm::exp2(f64::from(time_index(time, &HALVES, &OTHER_HALVES)?) / 2.0))
}

fn thirds_of_f_number(f_number: f64) -> Option<f64> {
    Some(libm::exp2(f64::from(index(f_number, &F_THIRDS)?) / 6.0))
}

fn halves_of_f_number(f_number: f64) -> Option<f64> {
    Some(libm::exp2(f64::from(index(f_number, &F_HALVES)?) / 4.0))
}

fn thirds_of_iso(iso: f64) -> Option<f64> {
    Some(100.0 * libm::exp2(f64::from(index(iso, &ISO_THIRDS)? - 6) / 3.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(time: f64, f_number: f64, iso: f64) -> ExposureTags {
        ExposureTags {
            time_s: Some((time, "")),
            f_number: Some((f_number, "")),
            iso: Some((iso, "")),
            is_time_printed: true,
            ..ExposureTags::default()
        }
    }

    fn times(printed: &[f64]) -> Option<Vec<f64>> {
        let frames: Vec<_> = printed.iter().map(|&t| frame(t, 8.0, 100.0)).collect();
        Some(exact(&frames)?.iter().map(|t| t.time_s.unwrap().0).collect())
    }

    #[test]
    fn printed_numbers_are_rounded_steps() {
        // The largest relative error of these nominal times is 6.7 %: 15, 30 and 60 stand for 16, 32 and 64. Nominal
        // f-numbers and sensitivities have smaller errors.
        let near = |exact: Option<f64>, printed: f64, most: f64| (exact.unwrap() / printed - 1.0).abs() < most;
        for n in THIRDS {
            assert!(near(thirds_of_time(n), n, 0.068) && near(thirds_of_time(1.0 / n), 1.0 / n, 0.068), "{n}");
        }
        for n in HALVES {
            assert!(near(halves_of_time(n), n, 0.068) && near(halves_of_time(1.0 / n), 1.0 / n, 0.068), "{n}");
        }
        for (n, ..) in OTHER_THIRDS {
            assert!(near(thirds_of_time(n), n, 0.06), "{n}");
        }
        // The marking 0.3 stands for half a stop below 0.5 s, which is 0.354 s: 18 % more than 0.3 s.
        for (n, ..) in OTHER_HALVES {
            assert!(near(halves_of_time(n), n, 0.19), "{n}");
        }
        assert!(F_THIRDS.iter().all(|&n| near(thirds_of_f_number(n), n, 0.051)));
        assert!(F_HALVES.iter().all(|&n| near(halves_of_f_number(n), n, 0.035)));
        assert!(ISO_THIRDS.iter().all(|&n| near(thirds_of_iso(n), n, 0.024)));
    }

    #[test]
    fn a_bracket_by_the_dials_is_exact() {
        let powers = |v: &[i32]| v.iter().map(|&k| libm::exp2(f64::from(k))).collect::<Vec<_>>();
        assert_eq!(times(&[1.0 / 125.0, 1.0 / 30.0, 1.0 / 8.0, 30.0]), Some(powers(&[-7, -5, -3, 5])));
        let thirds = times(&[1.0 / 20.0, 1.0 / 80.0, 0.3]).unwrap();
        assert!((thirds[0] - 0.049606).abs() < 1e-6 && (thirds[2] - 0.314980).abs() < 1e-6);
        // The marking 1/6 s stands for 1/6.35 s in the series of thirds of a stop, and for 1/5.66 s in that of halves.
        assert!((times(&[1.0 / 6.0, 1.0 / 60.0]).unwrap()[0] * 6.3496 - 1.0).abs() < 1e-4);
        assert!((times(&[1.0 / 6.0, 1.0 / 45.0]).unwrap()[0] * 5.6569 - 1.0).abs() < 1e-4);
        let stained_glass: Vec<_> =
            [(4000.0, 11.0), (1000.0, 5.6), (60.0, 1.4)].map(|(n, f)| frame(1.0 / n, f, 250.0)).into();
        let exact = exact(&stained_glass).unwrap();
        assert_eq!(exact[0].f_number, Some((libm::exp2(3.5), "")));
        assert_eq!(exact[2].time_s, Some((1.0 / 64.0, "")));
        assert!((exact[1].iso.unwrap().0 - 251.984).abs() < 1e-3);
    }

    #[test]
    fn measured_or_mixed_values_have_no_exact_steps() {
        assert_eq!(times(&[1.0 / 33.0, 1.0 / 60.0]), None);
        assert_eq!(times(&[1.0 / 1243.0, 1.0 / 60.0]), None);
        // 1/45 is only in the series of halves, and 1/40 only in that of thirds.
        assert_eq!(times(&[1.0 / 45.0, 1.0 / 40.0]), None);
        let computed = ExposureTags { is_time_printed: false, ..frame(1.0 / 60.0, 1.8, 50.0) };
        assert_eq!(exact(&[computed, frame(1.0 / 30.0, 1.8, 50.0)]), None);
        assert_eq!(exact(&[frame(1.0 / 30.0, 1.79, 50.0), frame(1.0 / 60.0, 1.79, 50.0)]), None);
    }

    #[test]
    fn shutter_speed_confirms_exact_times_if_the_f_number_is_no_step() {
        let with = |time, shutter_speed| ExposureTags { shutter_speed: Some(shutter_speed), ..frame(time, 4.9, 100.0) };
        let exact_tags = exact(&[with(1.0 / 30.0, 5.0), with(1.0 / 125.0, 7.0)]).unwrap();
        assert_eq!((exact_tags[0].time_s.unwrap().0, exact_tags[0].f_number.unwrap().0), (1.0 / 32.0, 4.9));
        // A ShutterSpeedValue that was computed from the nominal time does not confirm the exact time.
        assert_eq!(exact(&[with(1.0 / 30.0, 4.907), with(1.0 / 125.0, 6.966)]), None);
    }
}
