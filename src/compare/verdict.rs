//! The verdict: from what pixels differ by to whether that is too much, and a reason in words.
//!
//! In: differences and the [`Criterion`]. Out: what was asked for in numbers, what is beyond it, and why. Cost: a pass over the differences.

use super::input::{Input, Pixels};
use super::{Criterion, DEFAULT_STOPS, Differing, Largest, Limits, Magnitudes, Measured, Tolerance, Unit, Verdict};
use crate::error::{Error, Result};
use crate::plane::fold_bands;

/// Whether the numbers of `criterion` make sense.
///
/// # Errors
/// [`Error::Option`].
pub(super) fn validate(criterion: &Criterion) -> Result<()> {
    let refused = |option, reason: String| Err(Error::Option { option, reason });
    let is_sound = |v: f64| v.is_finite() && v >= 0.0;
    match *criterion {
        Criterion::Psnr { least_db } if !is_sound(least_db) => {
            refused("--min-psnr", format!("{least_db} is no number of dB above 0; give one, as 40"))
        }
        Criterion::Pixels { tolerance: Tolerance::Stops(v), .. } if !is_sound(v) => {
            refused("--tolerance-stops", format!("{v} is no tolerance; give stops from 0 on, as 0.01"))
        }
        Criterion::Pixels { tolerance: Tolerance::DeltaE(v), .. } if !is_sound(v) => {
            refused("--tolerance-de", format!("{v} is no tolerance; give a dE from 0 on, as 1"))
        }
        Criterion::Pixels { most_differing_percent: v, .. } if !is_sound(v) || v > 100.0 => {
            refused("--max-differing", format!("{v} is no share; give 0 to 100 percent of the pixels"))
        }
        _ => Ok(()),
    }
}

/// What `criterion` asks of a file like `input`.
///
/// # Errors
/// [`Error::Option`] for a tolerance that is of the other kind.
pub(super) fn limits(criterion: &Criterion, input: &Input) -> Result<Limits> {
    let refused = |option, reason: String| Err(Error::Option { option, reason });
    let is_radiance = matches!(input.pixels, Pixels::Radiance(..));
    Ok(match *criterion {
        Criterion::Psnr { least_db } => Limits { min_psnr_db: Some(least_db), ..Limits::default() },
        Criterion::Pixels { tolerance, most_differing_percent } => {
            let (stops, de) = match (tolerance, is_radiance) {
                (Tolerance::ByKind, true) => (Some(DEFAULT_STOPS), None),
                (Tolerance::ByKind, false) => (None, Some(0.0)),
                (Tolerance::Stops(stops), true) => (Some(stops), None),
                (Tolerance::DeltaE(de), false) => (None, Some(de)),
                (Tolerance::Stops(_), false) => {
                    let name = input.name();
                    return refused(
                        "--tolerance-stops",
                        format!("is for radiance, and {name} is a display picture; give --tolerance-de"),
                    );
                }
                (Tolerance::DeltaE(_), true) => {
                    let name = input.name();
                    return refused(
                        "--tolerance-de",
                        format!("is for display pictures, and {name} is radiance; give --tolerance-stops"),
                    );
                }
            };
            let share = Some(most_differing_percent);
            Limits { tolerance_stops: stops, tolerance_de: de, max_differing_percent: share, min_psnr_db: None }
        }
    })
}

/// What is beyond the tolerance, and where most.
pub(super) fn differing(magnitudes: &Magnitudes, limits: &Limits, a: &Input, b: &Input) -> Differing {
    let plane = &magnitudes.plane;
    let tolerance = limits.tolerance_stops.or(limits.tolerance_de).unwrap_or(0.0) as f32;
    // Pixels beyond, pixels unequal, the largest and its place; the first of equals.
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

/// The verdict, and why.
pub(super) fn judge(
    limits: &Limits,
    a: &Input,
    b: &Input,
    differing: Option<&Differing>,
    measured: Option<&Measured>,
) -> (Verdict, String) {
    let (Some(differing), Some(measured)) = (differing, measured) else {
        let ((aw, ah), (bw, bh)) = (a.size(), b.size());
        return (Verdict::Differs, format!("{aw} x {ah} pixels are expected, and there are {bw} x {bh}"));
    };
    if differing.unequal_pixels == 0 {
        return (Verdict::Same, "all pixels are equal".into());
    }
    if let Some(least) = limits.min_psnr_db {
        let (name, found) = match &measured.display {
            Some(display) => ("PSNR", display.psnr_db),
            None => ("PU21-PSNR", measured.pu21_psnr_db),
        };
        // Beyond what is compared by it, as infinities are, there may be no difference that the PSNR sees.
        let not_comparable = measured.radiance.as_ref().map_or(0, |r| r.not_comparable_pixels);
        if not_comparable > 0 {
            return (Verdict::Differs, format!("{} no numbers in one file alone", pixels_are(not_comparable)));
        }
        return match found {
            Some(db) if db < least => (Verdict::Differs, format!("{name} {db:.2} dB, and {least} dB are asked for")),
            Some(db) => (Verdict::Same, format!("{name} {db:.2} dB, and {least} dB are asked for")),
            // Beyond what it is made for, as all black and a millionth of a cd/m2 are, it says nothing.
            None => (
                Verdict::Differs,
                format!("{} not equal, and {name} says nothing of them", pixels_are(differing.unequal_pixels)),
            ),
        };
    }
    let most = limits.max_differing_percent.unwrap_or(0.0);
    let is_same = differing.differing_percent <= most;
    let tolerance = match (limits.tolerance_stops, limits.tolerance_de) {
        (Some(stops), _) if stops > 0.0 => format!("differ by more than {stops} stops"),
        (_, Some(de)) if de > 0.0 => format!("differ by more than dE {de}"),
        _ => "differ".into(),
    };
    let reason = if differing.differing_pixels == 0 {
        format!("no pixel differs by more than {}", tolerance.rsplit("than ").next().unwrap_or_default())
    } else {
        let share = percent(differing.differing_percent);
        let allowed = if most > 0.0 { format!(", and {most} % may") } else { String::new() };
        let many = pixels(differing.differing_pixels);
        let tolerance =
            if differing.differing_pixels == 1 { tolerance.replacen("differ", "differs", 1) } else { tolerance };
        format!("{many} ({share}) {tolerance}{allowed}")
    };
    (if is_same { Verdict::Same } else { Verdict::Differs }, reason)
}

fn pixels_are(count: usize) -> String {
    format!("{} {}", pixels(count), if count == 1 { "is" } else { "are" })
}

fn pixels(count: usize) -> String {
    if count == 1 { "1 pixel".into() } else { format!("{count} pixels") }
}

/// A share that is not 0 is not told as 0, and one that is not all not as all.
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
    fn only_all_is_told_as_all_and_only_nothing_as_nothing() {
        let told = [100.0, 99.999, 99.94, 99.5, 99.4, 12.3, 0.26, 0.004, 0.0001].map(percent);
        let expected = ["100 %", "99.9 %", "99.9 %", "99.5 %", "99 %", "12 %", "0.3 %", "0.004 %", "under 0.001 %"];
        assert_eq!(told, expected);
    }
}
