//! `.csv`: the response files of luminance-hdr and pfstools.
//!
//! In and out: a [`ResponseCurve`] and a matrix as text. Cost: negligible. Source: luminance-hdr
//! `src/HdrCreation/responses.cpp`, responseSave and responseLoad, with headers for all channels; pfstools
//! `pfshdrcalibrate`, one matrix of three columns for each channel.
//!
//! ```text
//! # Camera response curve, channels Ir, Ig, Ib
//! # data layout: camera output | log10(response Ir) | response Ir | log10(response Ig) | response Ig | log10(response Ib) | response Ib
//! # type: matrix
//! # rows: 256
//! # columns: 7
//!     0    -3.217483944     0.000606060 ...
//! ```
//!
//! Values are relative exposures with nine decimals, 1 at the brightest code. Other programs write 0 for black codes;
//! when a file is read, exposures of 0 are replaced by values that rise from a quarter of the first positive exposure.
//! A quarter is also the ratio of code 0 to code 1 in the built-in curves. If a matrix has more than 256 rows, 256
//! evenly spaced ones are used.

use crate::response::fit::monotone;
use crate::response::{BLACK, CODES, MID, ResponseCurve};
use std::fmt::Write;

/// Smallest rise of g per code: with nine decimals, neighbouring dark codes may be written with equal values.
const RISE: f64 = 1e-6;
/// Returns the text of the file.
pub(crate) fn write(curve: &ResponseCurve) -> String {
    let white = (0..3).map(|c| curve.ln_exposure(c)[CODES - 1]).fold(f64::MIN, f64::max);
    let exposure = |c: usize, z: usize| libm::exp(curve.ln_exposure(c)[z] - white);
    let mut text = String::from(
        "# Camera response curve, channels Ir, Ig, Ib \n\
         # data layout: camera output | log10(response Ir) | response Ir | log10(response Ig) | response Ig | log10(response Ib) | response Ib \n\
         # type: matrix\n# rows: 256\n# columns: 7\n",
    );
    for z in 0..CODES {
        let _ = write!(text, " {z:4}");
        for c in 0..3 {
            let x = exposure(c, z);
            let _ = write!(text, " {:15.9} {x:15.9}", libm::log10(x));
        }
        text.push_str(" \n");
    }
    text.push('\n');
    text
}

/// A matrix in the file.
struct Matrix {
    columns: usize,
    rows: Vec<Vec<f64>>,
}

/// Reads the curve in `text`. The error says why there is no valid curve.
pub(crate) fn read(text: &str) -> Result<ResponseCurve, String> {
    let matrices = matrices(text)?;
    let column = |m: &Matrix, k: usize| m.rows.iter().map(|row| row[k]).collect::<Vec<_>>();
    // The matrices with two columns are the weights of pfstools.
    let curves: Vec<&Matrix> = matrices.iter().filter(|m| m.columns != 2).collect();
    let channels: [Vec<f64>; 3] = match curves[..] {
        [all] if all.columns == 7 => [2, 4, 6].map(|k| column(all, k)),
        [red, green, blue] if curves.iter().all(|m| m.columns == 3) => [red, green, blue].map(|m| column(m, 2)),
        [] => {
            return Err(
                "it contains no matrix with 3 or 7 columns; the header of a matrix has lines such as `# rows: 256` and \
                 `# columns: 7`"
                    .to_owned(),
            );
        }
        _ => {
            let columns: Vec<String> = curves.iter().map(|m| m.columns.to_string()).collect();
            return Err(format!(
                "its matrices have {} columns; hdralign can read one matrix with 7 columns (from luminance-hdr), or three with 3 columns (from pfstools)",
                columns.join(", ")
            ));
        }
    };
    let mut g = [[0.0; CODES]; 3];
    for ((g, x), name) in g.iter_mut().zip(&channels).zip(["red", "green", "blue"]) {
        *g = logarithms(x).ok_or_else(|| {
            format!("the response of {name} is invalid: it must never decrease, its last value must be larger than its first, and it must be positive from pixel value 127 of 255 on")
        })?;
    }
    let mid = g.iter().map(|g| g[MID]).sum::<f64>() / 3.0;
    ResponseCurve::new(g.map(|g| g.map(|v| v - mid))).ok_or_else(|| "its values are too large or too small".to_owned())
}

/// Returns ln of the responses at 256 codes, or `None` if they are not a valid curve.
fn logarithms(x: &[f64]) -> Option<[f64; CODES]> {
    let last = x.len() - 1;
    let at = |z: usize| x[(z * last + (CODES - 1) / 2) / (CODES - 1)];
    let mut values: [f64; CODES] = std::array::from_fn(at);
    let first = values.iter().position(|&v| v > 0.0).filter(|&z| z < CODES / 2)?;
    // Several programs write 0, or the smallest positive number, for black codes.
    (0..first).for_each(|z| values[z] = values[first] * (BLACK + (1.0 - BLACK) * z as f64 / first as f64));
    if values.windows(2).any(|w| w[0].is_nan() || w[0] > w[1] || !w[1].is_finite()) || values[CODES - 1] <= values[0] {
        return None;
    }
    let ln: Vec<f64> = values.iter().map(|&v| libm::log(v)).collect();
    monotone::rising(&ln, &[1.0; CODES], RISE).try_into().ok()
}

/// Reads the matrices in `text`, each after its header; other lines that begin with # are ignored.
fn matrices(text: &str) -> Result<Vec<Matrix>, String> {
    let mut found = Vec::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let Some(rows) = head(line, "# rows:")? else { continue };
        let columns = loop {
            let Some(line) = lines.next() else { return Err("it ends within the header of a matrix".to_owned()) };
            if let Some(columns) = head(line, "# columns:")? {
                break columns;
            }
        };
        if !(CODES..=MOST_ROWS).contains(&rows) || !(2..=7).contains(&columns) {
            return Err(format!(
                "one of its matrices (tables of numbers) has {rows} rows and {columns} columns; {CODES} to {MOST_ROWS} rows and 2, 3 or 7 columns are supported"
            ));
        }
        let mut matrix = Matrix { columns, rows: Vec::with_capacity(rows) };
        while matrix.rows.len() < rows {
            let Some(line) = lines.next() else {
                return Err(format!("it ends after {} of {rows} rows", matrix.rows.len()));
            };
            let row: Vec<f64> = line.split_whitespace().map_while(|word| word.parse().ok()).collect();
            match row.len() {
                0 if line.trim().is_empty() || line.starts_with('#') => continue,
                n if n == columns => matrix.rows.push(row),
                _ => {
                    return Err(format!(
                        "row {} of a matrix does not have {columns} numbers: {line:?}",
                        matrix.rows.len()
                    ));
                }
            }
        }
        found.push(matrix);
    }
    Ok(found)
}

/// Largest number of rows: that of a 16-bit curve.
const MOST_ROWS: usize = 65536;

/// Returns the number after `key`, if the line begins with `key`.
fn head(line: &str, key: &str) -> Result<Option<usize>, String> {
    let Some(value) = line.trim().strip_prefix(key) else { return Ok(None) };
    value.trim().parse().map(Some).map_err(|_| format!("{line:?} has no number"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve() -> ResponseCurve {
        let srgb = *ResponseCurve::srgb().ln_exposure(0);
        ResponseCurve::new([0.0, 0.01, -0.02].map(|d| srgb.map(|v| v * (1.0 + d) + d))).unwrap()
    }

    #[test]
    fn a_curve_comes_back_to_the_last_decimal() {
        let (curve, text) = (curve(), write(&curve()));
        let back = read(&text).unwrap();
        // Reading shifts the mean of the three channels at the middle code to 0.
        let mid = (0..3).map(|c| curve.ln_exposure(c)[MID]).sum::<f64>() / 3.0;
        for (c, z) in (0..3).flat_map(|c| (0..CODES).map(move |z| (c, z))) {
            let (was, is) = (curve.ln_exposure(c)[z] - mid, back.ln_exposure(c)[z]);
            // Rounding to nine decimals is an error of 0.5e-9, which is 7e-6 of the darkest value, exp(g - white) =
            // 7e-5.
            assert!((was - is).abs() < 1e-5, "{c} {z}: {was} {is}");
        }
        assert_eq!(text.lines().filter(|l| l.split_whitespace().count() == 7 && !l.starts_with('#')).count(), CODES);
        let columns = |text: &str| {
            let rows = text.lines().filter(|l| !l.starts_with('#'));
            rows.map(|l| l.split_whitespace().step_by(2).map(str::to_owned).collect::<Vec<_>>()).collect::<Vec<_>>()
        };
        assert!(columns(&write(&back)) == columns(&text), "the responses differ");
    }

    #[test]
    fn zeros_in_a_luminance_hdr_curve_are_read() {
        let head = "# rows: 256\n# columns: 7\n";
        let row = |z: usize| {
            let x = z as f64 / 255.0;
            format!(
                " {z:4} {0:15.9} {x:15.9} {0:15.9} {x:15.9} {0:15.9} {x:15.9} \n",
                if z == 0 { -6.0 } else { libm::log10(x) }
            )
        };
        let text = head.to_owned() + &(0..256).map(row).collect::<String>();
        let read = read(&text).unwrap();
        let linear = ResponseCurve::linear();
        // Rounding 1/255 to nine decimals is a relative error of 1.3e-7.
        assert!((0..CODES).all(|z| (read.ln_exposure(1)[z] - linear.ln_exposure(1)[z]).abs() < 2e-7));
    }

    #[test]
    fn pfstools_has_a_matrix_for_each_channel_and_more_rows_for_more_bits() {
        let matrix = |name: &str, scale: f64, rows: usize| {
            let row = |z: usize| {
                format!(" {:15.9} {z:4} {:e}\n", libm::log10(scale * (z + 1) as f64), scale * (z + 1) as f64)
            };
            let head = format!(
                "# Camera response curve, channel {name}\n# data layout: log10(response) | camera output | response\n# type: matrix\n# rows: {rows}\n# columns: 3\n"
            );
            head + &(0..rows).map(row).collect::<String>() + "\n"
        };
        for rows in [256, 1024] {
            let weights = "# Weighting function\n# rows: 256\n# columns: 2\n".to_owned() + &"0.5 1\n".repeat(256);
            let text = matrix("IR", 1.0, rows) + &matrix("IG", 2.0, rows) + &matrix("IB", 4.0, rows) + &weights;
            let curve = read(&text).unwrap();
            let between = curve.ln_exposure(2)[200] - curve.ln_exposure(0)[200];
            assert!((between - libm::log(4.0)).abs() < 1e-6);
            let steep = curve.ln_exposure(1)[255] - curve.ln_exposure(1)[0];
            assert!((steep - libm::log(rows as f64)).abs() < 1e-6);
        }
    }

    #[test]
    fn invalid_curves_are_rejected_with_a_reason() {
        let rows = |columns: usize, row: &str| format!("# rows: 256\n# columns: {columns}\n") + &row.repeat(256);
        assert!(read("1;2;3\n").unwrap_err().contains("# rows: 256"));
        assert!(read(&rows(7, "0 1 2 3\n")).unwrap_err().contains("not have 7 numbers"));
        assert!(read(&rows(7, "0 1 2 1 2 1 2\n")).unwrap_err().contains("must never decrease"));
        assert!(read("# rows: 16\n# columns: 7\n").unwrap_err().contains("16 rows"));
        assert!(read("# rows: many\n").unwrap_err().contains("many"));
        assert!(read("# rows: 256\n# columns: 7\n0 0 1 0 1 0 1\n").unwrap_err().contains("ends after 1"));
        assert!(read(&rows(3, "1 1 1\n")).unwrap_err().contains("columns"));
    }
}
