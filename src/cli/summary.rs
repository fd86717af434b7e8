//! What was done, in words for people, on stderr.

use hdralign::align::Status;
use hdralign::report::{FrameReport, Report};

/// Prints the warnings and a summary of `report`; with `verbose`, a line for each frame and the time of each stage.
pub fn print(report: &Report, verbose: bool) {
    for warning in &report.warnings {
        eprintln!("warning: {}", warning.message);
    }
    if let Some(path) = &report.transforms_from {
        eprintln!("transforms taken from {path}");
    }
    if verbose {
        for frame in &report.frames {
            eprintln!("{}", line(frame));
        }
        let times = &report.time_s;
        let stages = [
            ("load", times.load),
            ("align", times.align),
            ("response", times.response),
            ("merge", times.merge),
            ("tonemap", times.tonemap),
            ("write", times.write),
        ];
        let spent: Vec<String> = stages.iter().filter_map(|(n, t)| t.map(|t| format!("{n} {t:.2} s"))).collect();
        eprintln!("{}", spent.join(", "));
    }
    let count = |status| report.frames.iter().filter(|f| f.alignment.status == status).count();
    let (aligned, unmoved, rejected) = (count(Status::Aligned), count(Status::Unmoved), count(Status::Rejected));
    let mut words = vec![format!("{} frames", report.frames.len())];
    words.extend((aligned > 0).then(|| format!("{aligned} aligned")));
    words.extend((unmoved > 0).then(|| format!("{unmoved} unmoved")));
    words.extend((rejected > 0).then(|| format!("{rejected} left out")));
    words.push(format!("{} x {} pixels", report.crop.width_px, report.crop.height_px));
    if let Some(merged) = &report.radiance {
        let scene = &merged.radiance;
        words.push(format!("{:.1} stops", scene.dynamic_range_stops));
        let calibrated = report.calibration.is_some();
        words.extend(calibrated.then(|| format!("{:.2e} to {:.2e} cd/m2", scene.p0_1, scene.p99_9)));
    }
    words.push(format!("{:.2} s", report.time_s.total));
    eprintln!("{}", words.join(", "));
}

/// One frame on a line.
fn line(frame: &FrameReport) -> String {
    let place = &frame.alignment;
    let ev = frame.relative_exposure.log2();
    let status = match place.status {
        Status::Reference => "reference",
        Status::Aligned => "aligned",
        Status::Unmoved => "unmoved",
        Status::Rejected => "left out",
    };
    let mut text = format!("{}: {ev:+.1} EV", frame.path);
    if frame.exposure_correction_stops != 0.0 {
        text += &format!(" ({:+.2} by the pixels)", frame.exposure_correction_stops);
    }
    text += &format!(", {status}");
    if let (Status::Aligned, Some([dx, dy]), Some(angle)) = (place.status, place.shift_px, place.rotation_deg) {
        text += &format!(" by {dx:+.1}, {dy:+.1} px and {angle:+.2} deg");
    }
    if place.status != Status::Reference {
        if let Some(error) = place.error_px {
            text += &format!(", within {error:.2} px");
        }
        text += &format!(", confidence {:.2}", place.confidence);
    }
    text
}
