//! Formats the tables as text in columns.
//!
//! In: [`Tables`]. Out: the content of `tables.txt`. Cost: none. Tables 2 to 6 contain keypoints, matches and the
//! resulting motion, each for the photograph, for its bitmaps, and for both together. Source: tables 4.1 to 4.3 of the
//! thesis that hdralign is based on; here for any bracket and for two detectors.

use super::tables::{FeatureTable, FrameTable, KindTable, MotionComparison, Tables};
use crate::align::grey::Percentile;
use crate::align::{Model, Status};
use crate::bracket::exposure::ExposureSource;
use crate::draw::markup::file_name;

/// Factor and offset for a warning about a probably wrong motion. `before` and `after` are the fractions of bitmap
/// pixels that differ before and after alignment. The warning is given if `after > factor * before + offset`. The two
/// numbers are small enough to detect a wrong motion, and large enough to ignore the effect of rounding to whole
/// pixels.
const AGAINST: (f64, f64) = (1.5, 0.005);

impl Tables {
    /// Returns the tables as text in columns.
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{}: {} frames of {} x {} pixels; reference {}\nBitmaps and keypoints from the pyramid level of {} x {} pixels.\n",
            self.software,
            self.frames.len(),
            self.width_px,
            self.height_px,
            file_name(&self.reference),
            self.level_width_px,
            self.level_height_px,
        );
        let mut add = |title: &str, note: &str, header: &[&str], row: &dyn Fn(&FrameTable) -> Vec<String>| {
            let rows = self.frames.iter().map(|frame| [vec![file_name(&frame.report.path)], row(frame)].concat());
            text += &format!("\n{title}\n{}", columns(&[&["photograph"], header].concat(), rows));
            if !note.is_empty() {
                text += &format!("{note}\n");
            }
        };
        add("Table 1. Exposures", "", &["time", "f", "ISO", "EV to reference", "source"], &exposure_row);
        add(
            "Table 2. Keypoints of SIFT and of SURF",
            "Numbers of keypoints. plain: in the photograph. MTB: in its median threshold bitmaps. merged: in both together, shared keypoints counted once. gain: merged / plain.",
            &["EV", "SIFT: plain", "MTB", "merged", "gain", "SURF: plain", "MTB", "merged", "gain"],
            &keypoint_row,
        );
        type Detected = (&'static str, fn(&FrameTable) -> &FeatureTable);
        let detectors: [Detected; 2] = [("SIFT", |frame| &frame.features), ("SURF", |frame| &frame.surf)];
        for (i, (name, detected)) in detectors.into_iter().enumerate() {
            add(
                &format!("Table {}. {name}: matches with the reference, and inliers among them", 3 + 2 * i),
                "Only mutual matches that pass the ratio test are counted. The alignment also uses other methods.",
                &["EV", "plain", "inliers", "MTB", "inliers", "merged", "inliers"],
                &|frame| match_row(frame, detected(frame)),
            );
            add(
                &format!(
                    "Table {}. {name}: motion found from each kind of keypoint alone, compared with the alignment",
                    4 + 2 * i
                ),
                "px: distance between this motion and the motion that the alignment found (root mean square over the picture).",
                &["EV", "plain", "px", "MTB", "px", "merged", "px"],
                &|frame| comparison_row(frame, detected(frame)),
            );
        }
        add(
            "Table 7. Alignment",
            "dx and dy: shift of the picture centre from the reference to the frame; positive is right and down. rotation: also from the reference to the frame; positive is clockwise.",
            &["status", "model", "dx px", "dy px", "rotation deg", "error px", "confidence"],
            &place_row,
        );
        add(
            "Table 8. Median threshold bitmaps",
            "XOR: percentage of the compared pixels that differ, before and after alignment.",
            &["percentile", "threshold", "excluded %", "XOR before %", "XOR after %"],
            &bitmap_row,
        );
        for frame in &self.frames {
            if frame.mtb.xor.as_ref().is_some_and(|x| x.after_share > AGAINST.0 * x.before_share + AGAINST.1) {
                let name = file_name(&frame.report.path);
                text += &format!(
                    "{name}: the bitmaps differ more after alignment than before; check the drawing of the edges.\n"
                );
            }
        }
        let reasons = self.frames.iter().filter_map(|f| f.report.alignment.reason.as_ref().map(|r| (f, r)));
        for (frame, reason) in reasons {
            let word = status_word(frame.report.alignment.status);
            text += &format!("\n{}: {word}: {reason}\n", file_name(&frame.report.path));
        }
        text
    }
}

/// Formats `rows` below `header`. The first column is left-aligned, the others are right-aligned. There are two
/// spaces between columns.
fn columns(header: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let mut all: Vec<Vec<String>> = vec![header.iter().map(|h| (*h).to_owned()).collect()];
    all.extend(rows);
    let width = |c: usize| all.iter().map(|row| row[c].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let rule: Vec<String> = widths.iter().map(|w| "-".repeat(*w)).collect();
    all.insert(1, rule);
    let mut text = String::new();
    for row in &all {
        let cells = row.iter().zip(&widths).enumerate();
        let line: Vec<String> =
            cells.map(|(c, (cell, &w))| if c == 0 { format!("{cell:<w$}") } else { format!("{cell:>w$}") }).collect();
        text += line.join("  ").trim_end();
        text.push('\n');
    }
    text
}

const NOTHING: &str = "-";

fn or_nothing<T>(value: Option<T>, show: impl Fn(T) -> String) -> String {
    value.map_or_else(|| NOTHING.to_owned(), show)
}

/// Formats an exposure time as cameras show it, such as `1/250 s` or `2 s`.
pub(crate) fn shutter(seconds: f64) -> String {
    if seconds < 0.3 { format!("1/{:.0} s", 1.0 / seconds) } else { format!("{} s", (seconds * 10.0).round() / 10.0) }
}

/// Formats a difference of exposures in stops, with its sign.
pub(crate) fn stops(ev: f64) -> String {
    // Values that round to zero have no sign.
    if ev.abs() < 0.005 { "0.00".into() } else { format!("{ev:+.2}") }
}

fn exposure_row(frame: &FrameTable) -> Vec<String> {
    let report = &frame.report;
    let source = match report.exposure_source {
        ExposureSource::Exif => "EXIF",
        ExposureSource::Given => "-e",
        ExposureSource::Estimated => "estimated",
    };
    vec![
        or_nothing(report.time_s, shutter),
        or_nothing(report.f_number, |n| format!("{}", (n * 10.0).round() / 10.0)),
        or_nothing(report.iso, |s| format!("{s:.0}")),
        stops(frame.relative_ev),
        source.to_owned(),
    ]
}

fn keypoint_row(frame: &FrameTable) -> Vec<String> {
    let cells = |detected: &FeatureTable| {
        let [plain, mtb, merged] = detected.kinds().map(|k| k.keypoints);
        let gain = if plain == 0 { NOTHING.to_owned() } else { format!("{:.1}", merged as f64 / plain as f64) };
        [plain.to_string(), mtb.to_string(), merged.to_string(), gain]
    };
    [stops(frame.relative_ev)].into_iter().chain(cells(&frame.features)).chain(cells(&frame.surf)).collect()
}

fn match_row(frame: &FrameTable, detected: &FeatureTable) -> Vec<String> {
    let count = |n: Option<usize>| or_nothing(n, |n| n.to_string());
    let cells = detected.kinds().into_iter().flat_map(|k| [count(k.matches), count(k.inliers)]);
    [stops(frame.relative_ev)].into_iter().chain(cells).collect()
}

fn comparison_row(frame: &FrameTable, detected: &FeatureTable) -> Vec<String> {
    let word = |v: MotionComparison| match v {
        MotionComparison::Agrees => "agrees".to_owned(),
        MotionComparison::Differs => "differs".to_owned(),
        MotionComparison::NoMotion => "no motion".to_owned(),
        MotionComparison::NoPlace => "no place".to_owned(),
    };
    let cells = |k: &KindTable| [or_nothing(k.verdict, word), or_nothing(k.off_px, |d| format!("{d:.2}"))];
    [stops(frame.relative_ev)].into_iter().chain(detected.kinds().into_iter().flat_map(cells)).collect()
}

/// Returns the status of a frame in words.
pub(crate) fn status_word(status: Status) -> &'static str {
    match status {
        Status::Reference => "reference",
        Status::Aligned => "aligned",
        Status::Unmoved => "unmoved",
        Status::Assumed => "assumed",
        Status::Rejected => "rejected",
        Status::Excluded | Status::Flash => "excluded",
    }
}

fn place_row(frame: &FrameTable) -> Vec<String> {
    let place = &frame.report.alignment;
    let model = place.model.map(|m| match m {
        Model::Unmoved => "none",
        Model::Shift => "shift",
        Model::Rigid => "rigid",
        Model::Homography => "homography",
    });
    let shift = |axis: usize| or_nothing(place.shift_px, |s| format!("{:.2}", s[axis] + 0.0));
    vec![
        status_word(place.status).to_owned(),
        or_nothing(model, str::to_owned),
        shift(0),
        shift(1),
        or_nothing(place.rotation_deg, |a| format!("{a:.3}")),
        or_nothing(place.error_px, |e| format!("{e:.2}")),
        format!("{:.2}", place.confidence),
    ]
}

/// Formats a percentile as an ordinal number, such as `84th`; 50 becomes `median`.
fn percentile_word(percentile: Percentile) -> String {
    match percentile.percent() {
        50 => "median".into(),
        n if n % 10 == 1 && n != 11 => format!("{n}st"),
        n if n % 10 == 2 && n != 12 => format!("{n}nd"),
        n if n % 10 == 3 && n != 13 => format!("{n}rd"),
        n => format!("{n}th"),
    }
}

fn bitmap_row(frame: &FrameTable) -> Vec<String> {
    let mtb = &frame.mtb;
    let percent = |share: f64| format!("{:.2}", 100.0 * share);
    vec![
        percentile_word(mtb.percentile),
        mtb.threshold_level.to_string(),
        percent(mtb.excluded_share),
        or_nothing(mtb.xor.as_ref(), |x| percent(x.before_share)),
        or_nothing(mtb.xor.as_ref(), |x| percent(x.after_share)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned_whatever_is_in_them() {
        let rows = [vec!["Zwölf.jpg".to_owned(), "7".into()], vec!["a".into(), "123456".into()]];
        let text = columns(&["photograph", "n"], rows.into_iter());
        assert_eq!(text, "photograph       n\n----------  ------\nZwölf.jpg        7\na           123456\n");
    }

    #[test]
    fn times_and_stops_are_as_photographers_write_them() {
        assert_eq!([1.0 / 512.0, 0.25, 0.5, 2.0, 32.0].map(shutter), ["1/512 s", "1/4 s", "0.5 s", "2 s", "32 s"]);
        assert_eq!([-2.0, 0.0, -1e-12, 1.333].map(stops), ["-2.00", "0.00", "0.00", "+1.33"]);
    }
}
