//! The summary on stderr: the warnings, then six lines. There is one more line if something moved in the scene, and
//! one if the user changed the white balance.

use super::say;
use super::terminal::{Terminal, shortened};
use hdralign::align::{Cause, Status};
use hdralign::report::{FrameReport, Report, WarningReport};
use hdralign::tonemap::adjust::Light;
use std::path::Path;

/// Width of the label at the start of each line, in columns.
const LABEL: usize = 11;
/// A frame is reported as uncertain if the confidence of its alignment is below this.
const UNCERTAIN: f64 = 0.5;

/// Prints the warnings and the summary of `report`. With `verbose`, also prints a line for each frame and a line with
/// the times of the main stages.
pub fn print(report: &Report, verbose: bool) {
    let terminal = Terminal::of_stderr();
    warn(&report.warnings, &terminal);
    if verbose {
        for frame in &report.frames {
            terminal.wrapped(&line(frame), 0).iter().for_each(say);
        }
        terminal.wrapped(&times(report), 0).iter().for_each(say);
    }
    lines(report, &terminal).iter().for_each(say);
}

/// Prints `warnings`, wrapped to the width of the terminal.
pub fn warn(warnings: &[WarningReport], terminal: &Terminal) {
    for warning in warnings {
        let label = "warning:";
        for (i, line) in terminal.wrapped(&warning.message, label.len() + 1).iter().enumerate() {
            if i == 0 {
                say(format_args!("{} {line}", terminal.doubtful(label)));
            } else {
                say(format_args!("{:1$} {line}", "", label.len()));
            }
        }
    }
}

/// Returns a line with the times of the main stages.
fn times(report: &Report) -> String {
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
    spent.join(", ")
}

/// Returns the lines of the summary: size, alignment, movement, white balance, frames used, range, files, time.
fn lines(report: &Report, terminal: &Terminal) -> Vec<String> {
    let merged = if report.radiance.is_some() { "merged" } else { "read" };
    let problems = problems(report, terminal.room(LABEL));
    let frames = if problems.is_empty() {
        terminal.good(&format!("all {} used", report.frames.len()))
    } else {
        terminal.doubtful(&problems)
    };
    let row = |label: &str, text: &str| {
        let label = terminal.strong(&format!("{label:LABEL$}"));
        format!("{label}{}", shortened(text, terminal.room(LABEL)))
    };
    let all = [
        Some(row(merged, &size(report))),
        Some(row("aligned", &aligned(report, terminal.room(LABEL)))),
        movement(report, terminal.room(LABEL)).map(|moved| row("movement", &moved)),
        report.white_balance.map(|light| row("white", &white(light))),
        Some(format!("{}{frames}", terminal.strong(&format!("{:LABEL$}", "frames")))),
        Some(row("range", &range(report))),
        Some(row("files", &files(&report.outputs, terminal.room(LABEL)))),
        Some(row("time", &duration(report.time_s.total))),
    ];
    all.into_iter().flatten().collect()
}

/// Returns the command-line option that sets the white balance to `light`.
pub fn white(light: Light) -> String {
    format!("--white-balance {light}")
}

/// Returns a text about what moved in the scene: the fraction of the picture in which something moved, where most of
/// it is, and the frame that is shown there. The text has at most `room` columns if possible. Returns `None` if
/// nothing moved or deghosting is off.
fn movement(report: &Report, room: usize) -> Option<String> {
    let ghosts = report.ghosts.as_ref()?;
    let place = ghosts.place((report.crop.width_px, report.crop.height_px))?;
    let percent = match 100.0 * ghosts.ghost_fraction {
        percent if percent < 0.1 => "under 0.1".to_owned(),
        percent => format!("{percent:.1}"),
    };
    let reference = report.frames.iter().find(|frame| frame.alignment.status == Status::Reference);
    let shown = reference.map_or_else(String::new, |frame| format!("; shown as in {}", name(&frame.path)));
    let words = format!("in {percent} % of the picture, mostly {place}{shown}");
    // Where something moved and the reference frame is clipped, the result is filled in from the surroundings.
    let filled = if ghosts.continued_fraction > 0.0 { ", partly filled in" } else { "" };
    Some(if words.chars().count() + filled.len() <= room { words + filled } else { words })
}

/// Returns the number of merged frames and the size of the result as text.
fn size(report: &Report) -> String {
    let (width, height) = (report.crop.width_px, report.crop.height_px);
    let merged = report.frames.iter().filter(|f| f.alignment.status.rejected_by().is_none()).count();
    let all = report.frames.len();
    let count = if merged == all { format!("{all} frames") } else { format!("{merged} of {all} frames") };
    let megapixels = (width * height) as f64 / 1e6;
    let megapixels = if megapixels >= 1.5 { format!(" ({megapixels:.0} megapixels)") } else { String::new() };
    format!("{count}, {width} x {height} pixels{megapixels}")
}

/// Returns a text of at most `room` columns (if possible) that says how far the frames moved.
fn aligned(report: &Report, room: usize) -> String {
    let with = |status| report.frames.iter().filter(move |f| f.alignment.status == status);
    let (moved, unmoved) = (with(Status::Aligned).count(), with(Status::Unmoved).count());
    let largest =
        |value: &dyn Fn(&FrameReport) -> Option<f64>| with(Status::Aligned).filter_map(value).fold(0.0, f64::max);
    let shift = largest(&|f| f.alignment.shift_px.map(|[x, y]| x.hypot(y)));
    let angle = largest(&|f| f.alignment.rotation_deg.map(f64::abs));
    // At least 0.1 px is shown, because error estimates are not more accurate than that.
    let error = largest(&|f| f.alignment.error_px).max(0.1);
    let mut words = Vec::new();
    if moved > 0 {
        let turn = if angle >= 0.05 { format!(" and {angle:.1} degrees") } else { String::new() };
        words.push(format!("{moved} moved, by up to {shift:.1} px{turn}; remaining error {error:.1} px"));
    }
    if let Some(cause) = report.frames.iter().find_map(|frame| frame.alignment.followed) {
        words.push(followed(cause).to_owned());
    }
    if unmoved > 0 {
        words.push(format!("{unmoved} unmoved"));
    }
    let assumed = with(Status::Assumed).count();
    if assumed > 0 {
        words.push(format!("{assumed} assumed (too dark or too bright to align)"));
    }
    if let Some(path) = &report.transforms_from {
        words.push(format!("transforms from {}", name(path)));
    }
    // If the text is too long, its last part is removed, because it is the least important.
    while words.len() > 1 && words.join("; ").chars().count() > room {
        words.pop();
    }
    if words.is_empty() { "only the reference frame".into() } else { words.join("; ") }
}

/// Returns what is followed.
fn followed(cause: Cause) -> &'static str {
    match cause {
        Cause::Lens => "with the distortion of the lens",
        Cause::Shutter => "row by row (rolling shutter)",
        Cause::Depth => "near and far separately",
    }
}

/// Returns a text of at most `room` columns about problems: frames that are not used, frames that are uncertain, and
/// whether values were estimated. The text is empty if there are no problems.
fn problems(report: &Report, room: usize) -> String {
    let which = |is: &dyn Fn(&FrameReport) -> bool| report.frames.iter().filter(|f| is(f)).collect::<Vec<_>>();
    let rejected = which(&|f| f.alignment.status == Status::Rejected);
    let excluded = which(&|f| matches!(f.alignment.status, Status::Excluded | Status::Flash));
    // The transform of an "assumed" frame comes from other frames. If no merged frame moved, the assumption is certain
    // and not a problem.
    let assumed = which(&|f| f.alignment.status == Status::Assumed && !report.stood_still());
    let is_placed = |f: &FrameReport| matches!(f.alignment.status, Status::Aligned | Status::Unmoved);
    // Among these frames, the alignment sets `reason` only where no frame could be aligned and all are left unmoved. A
    // separate warning reports this, so such frames do not count as uncertain here. A file of transforms can contain a
    // `reason` for any frame; these frames do not count as uncertain either.
    let is_uncertain = |f: &FrameReport| f.alignment.reason.is_none() && f.alignment.confidence < UNCERTAIN;
    let uncertain = which(&|f| is_placed(f) && is_uncertain(f));
    let flash = which(&|f| f.alignment.status == Status::Flash);
    let is_local = report.local_processing.as_ref().is_some_and(|local| local.locally_processed);
    let named = rejected.len() + flash.len() + assumed.len() + uncertain.len() + usize::from(is_local);
    let is_guessed = report.warnings.iter().filter(|w| w.degrades).count() > named;
    let listed = |most: usize| {
        let some = |label: &str, frames: &[&FrameReport]| {
            let names: Vec<&str> = frames.iter().take(most).map(|f| name(&f.path)).collect();
            let names = if frames.len() <= most { format!(": {}", names.join(", ")) } else { String::new() };
            (!frames.is_empty()).then(|| format!("{}{label}{names}", frames.len()))
        };
        let guessed = is_guessed.then(|| "some values are uncertain, see the warnings".to_owned());
        let local = is_local.then(|| "tone-mapped locally by the camera".to_owned());
        let parts = [
            some(" rejected", &rejected),
            some(" excluded", &excluded),
            some(" assumed", &assumed),
            some(" uncertain", &uncertain),
            local,
            guessed,
        ];
        parts.into_iter().flatten().collect::<Vec<_>>().join("; ")
    };
    // Each kind of problem names its frames if there are at most 8. If the text is then too long, a kind of problem
    // names its frame only if there is just one. If it is still too long, no frame is named.
    let full = [8, 1].map(listed).into_iter().find(|words| words.chars().count() <= room);
    full.unwrap_or_else(|| shortened(&listed(0), room))
}

/// Returns a text with the range of the exposures and the range of the result.
fn range(report: &Report) -> String {
    let evs = || {
        let merged = report.frames.iter().filter(|f| f.alignment.status.rejected_by().is_none());
        merged.map(|f| f.relative_exposure.log2())
    };
    let span = evs().fold(f64::NEG_INFINITY, f64::max) - evs().fold(f64::INFINITY, f64::min);
    let mut words = vec![format!("exposures span {:.1} stops", span.max(0.0))];
    if let Some(merged) = &report.radiance {
        let scene = &merged.radiance;
        words.extend(merged.range_stops.map(|stops| format!("the result {stops:.1} stops")));
        if report.calibration.is_some() {
            words.push(format!("{} to {} cd/m2", plain(scene.p0_1.into()), plain(scene.p99_9.into())));
        }
    }
    words.join(", ")
}

/// Returns `value` as a decimal number with at least three significant digits. If it is very small or large, returns
/// it in scientific notation.
fn plain(value: f64) -> String {
    if !(1e-3..1e7).contains(&value) {
        return format!("{value:.2e}");
    }
    format!("{value:.*}", (2.0 - value.log10().floor()).max(0.0) as usize)
}

/// Returns a text with the paths of the files. If they do not fit into `room` columns, the names are listed without
/// folders; a name that differs from the previous one only in its extension is listed as this extension. If this does
/// not fit either, only the number of files and the first name are given. The common folder is listed once at the end
/// if at least 12 columns remain for it.
fn files(outputs: &[String], room: usize) -> String {
    let Some(first) = outputs.first() else { return "none written".into() };
    let whole = outputs.join(", ");
    if whole.chars().count() <= room {
        return whole;
    }
    let folder = |path: &str| Path::new(path).parent().map(Path::to_path_buf).unwrap_or_default();
    let is_in_one = outputs.iter().all(|path| folder(path) == folder(first));
    let mut names = name(first).to_owned();
    for pair in outputs.windows(2) {
        let [before, path] = [&pair[0], &pair[1]].map(|path| Path::new(name(path)));
        let extension = path.extension().filter(|_| before.file_stem() == path.file_stem());
        let short = extension.map(|e| format!(".{}", e.to_string_lossy()));
        names += &format!(", {}", short.unwrap_or_else(|| path.to_string_lossy().into_owned()));
    }
    if names.chars().count() > room {
        names = format!("{} files, {}", outputs.len(), name(first));
    }
    let place = folder(first).to_string_lossy().into_owned();
    let left = room.saturating_sub(names.chars().count() + 4);
    if is_in_one && !place.is_empty() && left >= 12 { format!("{names} in {}", shortened(&place, left)) } else { names }
}

/// Returns the file name, the last part of a path.
fn name(path: &str) -> &str {
    Path::new(path).file_name().and_then(|n| n.to_str()).unwrap_or(path)
}

/// Returns a duration as text, such as `8.5 s` or `3 min 20 s`.
pub fn duration(seconds: f64) -> String {
    if seconds < 90.0 {
        format!("{seconds:.1} s")
    } else {
        format!("{} min {:02} s", (seconds / 60.0) as u64, (seconds % 60.0) as u64)
    }
}
/// Returns the line for one frame, as printed with --verbose.
fn line(frame: &FrameReport) -> String {
    let place = &frame.alignment;
    let ev = frame.relative_exposure.log2();
    let status = match place.status {
        Status::Reference => "reference",
        Status::Aligned => "aligned",
        Status::Unmoved => "unmoved",
        Status::Assumed => "assumed",
        Status::Rejected => "rejected",
        Status::Excluded => "excluded",
        Status::Flash => "excluded (the flash fired)",
    };
    let mut text = format!("{}: {ev:+.1} EV", frame.path);
    if frame.exposure_correction_stops != 0.0 {
        text += &format!(" ({:+.2} by correction)", frame.exposure_correction_stops);
    }
    text += &format!(", {status}");
    if let (Status::Aligned | Status::Assumed, Some([dx, dy]), Some(angle)) =
        (place.status, place.shift_px, place.rotation_deg)
    {
        text += &format!(" by {dx:+.1}, {dy:+.1} px and {angle:+.2} deg");
    }
    if place.status != Status::Reference {
        if let Some(error) = place.error_px {
            text += &format!(", within {error:.2} px");
        }
        // The confidence of an excluded frame is not shown: it is 1, although the frame was not aligned.
        if !matches!(place.status, Status::Excluded | Status::Flash) {
            text += &format!(", confidence {:.2}", place.confidence);
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use hdralign::align::{AlignMode, AlignOptions};
    use hdralign::pipeline::{self, Options};
    use std::path::PathBuf;

    /// Returns the report of a real bracket of three photographs.
    fn report() -> Report {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/testdata/window");
        let images: Vec<PathBuf> = [2, 3, 4].iter().map(|i| format!("{folder}/window_{i}.jpg").into()).collect();
        let align = AlignOptions { mode: AlignMode::None, ..AlignOptions::default() };
        pipeline::align_only(&images, &Options { align, ..Options::default() }, &pipeline::unwatched).unwrap()
    }

    #[test]
    fn luminance_is_a_plain_number_unless_it_is_extreme() {
        let shown = [2.0512, 11_934.0, 0.0123, 445.4, 99.99, 1e-5, 3e8].map(plain);
        assert_eq!(shown, ["2.05", "11934", "0.0123", "445", "100.0", "1.00e-5", "3.00e8"]);
    }

    #[test]
    fn summary_has_six_lines_within_the_terminal_width() {
        let mut report = report();
        let long = format!("/home/someone/{}", "photographs/".repeat(12));
        let mut seen = Vec::new();
        for case in 0..4 {
            match case {
                1 => report.outputs = vec!["room.exr".into(), "room.png".into()],
                2 => {
                    report.outputs =
                        ["exr", "png", "hdr"].iter().map(|e| format!("{long}IMG_0001-IMG_0003.{e}")).collect();
                    report.frames[0].alignment.status = Status::Rejected;
                    report.frames[0].path = format!("{long}{}.jpg", "IMG_".repeat(30));
                    report.transforms_from = Some(format!("{long}transforms.json"));
                }
                3 => {
                    report.frames[0].path = "deep/dark.jpg".into();
                    report.frames[2].path = "deep/bright.jpg".into();
                    report.frames[2].alignment.status = Status::Aligned;
                    report.frames[2].alignment.confidence = 0.2;
                    report.frames[2].alignment.shift_px = Some([-3.0, 4.0]);
                    report.time_s.total = 200.0;
                }
                _ => {}
            }
            for width in [60, 80, 200] {
                let lines = lines(&report, &Terminal::plain(width));
                assert!(lines.iter().all(|line| line.chars().count() < width), "{lines:#?}");
                if width == 80 {
                    seen.push(lines);
                }
            }
        }
        assert_eq!(seen[0][0], "read       3 frames, 1200 x 800 pixels");
        assert_eq!(seen[0][1], "aligned    2 unmoved");
        assert_eq!(seen[0][2], "frames     all 3 used");
        assert!(
            seen[0][3].starts_with("range      exposures span ") && seen[0][3].ends_with(" stops"),
            "{}",
            seen[0][3]
        );
        assert_eq!([&seen[0][4], &seen[1][4]], ["files      none written", "files      room.exr, room.png"]);
        assert!(seen[2][0].contains("2 of 3") && seen[2][2] == "frames     1 rejected", "{:?}", seen[2]);
        assert!(seen[2][4].contains("IMG_0001-IMG_0003.exr, .png, .hdr in /home"), "{}", seen[2][4]);
        assert!(seen[3][1].contains("1 moved, by up to 5.0 px"), "{}", seen[3][1]);
        assert_eq!(seen[3][2], "frames     1 rejected: dark.jpg; 1 uncertain: bright.jpg");
        assert_eq!(seen[3][5], "time       3 min 20 s");
    }
}
