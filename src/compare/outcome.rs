//! The outcome of a comparison: whether the differences exceed the tolerance, and the reason as text.
//!
//! In: differences and the [`Criterion`]. Out: the limits that apply, the pixels beyond them, and the outcome. Cost: a
//! pass over the differences.

use super::input::{Input, Pixels};
use super::{Criterion, DEFAULT_STOPS, Differing, Largest, Limits, Magnitudes, Measured, Outcome, Tolerance, Unit};
use crate::error::{Error, Result};
use crate::plane::fold_bands;

fn refused<T>(option: &'static str, reason: String) -> Result<T> {
    Err(Error::Option { option, reason })
}

/// Checks that the numbers of `criterion` are valid.
///
/// # Errors
/// [`Error::Option`] for the first number that is not valid.
pub(super) fn validate(criterion: &Criterion) -> Result<()> {
    let check = |option, value: f64, most: f64, needed: &str| match (0.0..=most).contains(&value) {
        true => Ok(()),
        false => refused(option, format!("{value} is not {needed}")),
    };
    match *criterion {
        Criterion::Psnr { least_db } => {
            check("--min-psnr", least_db, f64::MAX, "a PSNR; give a finite number of at least 0 dB, for example 40")
        }
        Criterion::Pixels { tolerance, most_differing_percent } => {
            match tolerance {
                Tolerance::ByKind => {}
                Tolerance::Stops(v) => check(
                    "--tolerance-stops",
                    v,
                    f64::MAX,
                    "a tolerance; give a finite number of at least 0 stops, for example 0.01",
                )?,
                Tolerance::DeltaE(v) => check(
                    "--tolerance-de",
                    v,
                    f64::MAX,
                    "a tolerance; give a finite colour difference (dE) of at least 0, for example 1",
                )?,
            }
            check("--max-differing", most_differing_percent, 100.0, "a percentage; give 0 to 100 percent of the pixels")
        }
    }
}

/// Returns the limits that `criterion` sets for a file of the kind of `input`.
///
/// # Errors
/// [`Error::Option`] if the tolerance is for the other kind of file.
pub(super) fn limits(criterion: &Criterion, input: &Input) -> Result<Limits> {
    let (tolerance, share) = match *criterion {
        Criterion::Psnr { least_db } => return Ok(Limits { min_psnr_db: Some(least_db), ..Limits::default() }),
        Criterion::Pixels { tolerance, most_differing_percent } => {
            (tolerance, Limits { max_differing_percent: Some(most_differing_percent), ..Limits::default() })
        }
    };
    let is_radiance = matches!(input.pixels, Pixels::Radiance(..));
    let (stops, de) = match tolerance {
        Tolerance::ByKind if is_radiance => (Some(DEFAULT_STOPS), None),
        Tolerance::ByKind => (None, Some(0.0)),
        Tolerance::Stops(stops) if is_radiance => (Some(stops), None),
        Tolerance::DeltaE(de) if !is_radiance => (None, Some(de)),
        Tolerance::Stops(_) => {
            let reason = format!("is for radiance, but {} is a display picture; use --tolerance-de", input.name());
            return refused("--tolerance-stops", reason);
        }
        Tolerance::DeltaE(_) => {
            let reason = format!("is for display pictures, but {} is radiance; use --tolerance-stops", input.name());
            return refused("--tolerance-de", reason);
        }
    };
    Ok(Limits { tolerance_stops: stops, tolerance_de: de, ..share })
}

/// Counts the pixels beyond the tolerance and finds the largest difference.
pub(super) fn differing(magnitudes: &Magnitudes, limits: &Limits, a: &Input, b: &Input) -> Differing {
    let plane = &magnitudes.plane;
    // NaN and infinity are an infinite difference in `plane`, which must exceed every tolerance.
    let tolerance = (limits.tolerance_stops.or(limits.tolerance_de).unwrap_or(0.0) as f32).min(f32::MAX);
    // Number of pixels beyond the tolerance, number of unequal pixels, largest difference, index of the first pixel
    // with the largest difference.
    type Found = (usize, usize, f32, usize);
    let band = |rows: std::ops::Range<usize>| -> Found {
        let first = rows.start * plane.width();
        let mut found = (0, 0, 0.0, first);
        for (i, &v) in plane.rows(rows).iter().enumerate() {
            found.0 += usize::from(v > tolerance);
            found.1 += usize::from(v > 0.0);
            if v > found.2 {
                (found.2, found.3) = (v, first + i);
            }
        }
        found
    };
    let join = |sum: Found, more: Found| {
        let (most, at) = if more.2 > sum.2 { (more.2, more.3) } else { (sum.2, sum.3) };
        (sum.0 + more.0, sum.1 + more.1, most, at)
    };
    let (beyond, unequal, most, at) = fold_bands(plane.height(), band, (0, 0, 0.0, 0), join);
    let largest = (unequal > 0).then(|| {
        let (x, y) = (at % plane.width(), at / plane.width());
        let number = most.is_finite().then_some(f64::from(most));
        let values = |input: &Input| input.at(x, y).map(|v| v.is_finite().then_some(v));
        Largest {
            x_px: x,
            y_px: y,
            stops: number.filter(|_| magnitudes.unit == Unit::Stops),
            de: number.filter(|_| magnitudes.unit == Unit::DeltaE),
            expected: values(a),
            actual: values(b),
        }
    });
    Differing {
        differing_pixels: beyond,
        differing_percent: 100.0 * beyond as f64 / plane.as_slice().len().max(1) as f64,
        unequal_pixels: unequal,
        largest,
    }
}

/// Returns the outcome and its reason. `differing` and `measured` are `None` if the sizes differ.
pub(super) fn decide(
    limits: &Limits,
    a: &Input,
    b: &Input,
    differing: Option<&Differing>,
    measured: Option<&Measured>,
) -> (Outcome, String) {
    let (Some(differing), Some(measured)) = (differing, measured) else {
        let ((aw, ah), (bw, bh)) = (a.size(), b.size());
        return (Outcome::Differs, format!("expected {aw} x {ah} pixels, found {bw} x {bh}"));
    };
    if differing.unequal_pixels == 0 {
        return (Outcome::Same, "all pixels are equal".into());
    }
    if let Some(least) = limits.min_psnr_db {
        let (name, found) = match &measured.display {
            Some(display) => ("PSNR", display.psnr_db),
            None => ("PU21-PSNR", measured.pu21_psnr_db),
        };
        // The PSNR may miss differences of values outside of its range, such as infinities.
        let not_comparable = measured.radiance.as_ref().map_or(0, |r| r.not_comparable_pixels);
        if not_comparable > 0 {
            return (
                Outcome::Differs,
                format!(
                    "{} different because a value is NaN or infinite, in a file or after conversion to the other colour space",
                    pixels_are(not_comparable)
                ),
            );
        }
        return match found {
            Some(db) => {
                let outcome = if db < least { Outcome::Differs } else { Outcome::Same };
                (outcome, format!("{name} is {db:.2} dB, at least {least} dB required"))
            }
            // Differences outside of the range of PU21, such as between black and a millionth of a cd/m2, have no PSNR.
            None => {
                let unequal = pixels_are(differing.unequal_pixels);
                (Outcome::Differs, format!("{unequal} not equal, but by differences that {name} cannot measure"))
            }
        };
    }
    let most = limits.max_differing_percent.unwrap_or(0.0);
    let outcome = if differing.differing_percent <= most { Outcome::Same } else { Outcome::Differs };
    let tolerance = match (limits.tolerance_stops, limits.tolerance_de) {
        (Some(stops), _) if stops > 0.0 => format!(" by more than {stops} stops"),
        (_, Some(de)) if de > 0.0 => format!(" by more than dE {de}"),
        _ => String::new(),
    };
    let reason = match differing.differing_pixels {
        0 => format!("no pixel differs{tolerance}"),
        count => {
            let (share, verb) = (percent(differing.differing_percent), if count == 1 { "differs" } else { "differ" });
            let allowed = if most > 0.0 { format!("; {most} % are allowed") } else { String::new() };
            format!("{} ({share}) {verb}{tolerance}{allowed}", pixels(count))
        }
    };
    (outcome, reason)
}

fn pixels_are(count: usize) -> String {
    format!("{} {}", pixels(count), if count == 1 { "is" } else { "are" })
}

fn pixels(count: usize) -> String {
    if count == 1 { "1 pixel".into() } else { format!("{count} pixels") }
}

/// Formats a share in percent so that only 0 is shown as 0 and only 100 as 100.
fn percent(share: f64) -> String {
    match share {
        s if (99.5..100.0).contains(&s) => format!("{:.1} %", (10.0 * s).floor() / 10.0),
        s if s >= 10.0 => format!("{s:.0} %"),
        s if s >= 0.1 => format!("{s:.1} %"),
        s if s >= 0.001 => format!("{s:.3} %"),
        _ => "under 0.001 %".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentages_round_to_0_and_100_only_if_exact() {
        let shown = [100.0, 99.999, 99.94, 99.5, 99.4, 12.3, 0.26, 0.004, 0.0001].map(percent);
        let expected = ["100 %", "99.9 %", "99.9 %", "99.5 %", "99 %", "12 %", "0.3 %", "0.004 %", "under 0.001 %"];
        assert_eq!(shown, expected);
    }
}
