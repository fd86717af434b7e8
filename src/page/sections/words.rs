//! The section "What was done": the processing of the bracket, in plain sentences.
//!
//! In: a [`Report`]. Out: HTML. Cost: none.

use crate::align::{AlignMode, Status};
use crate::bracket::exposure::ExposureSource;
use crate::merge::local::LocalReport;
use crate::page::markup::{escape, file_name, percent, signed};
use crate::report::{FrameReport, Report};

/// An alignment error below this, in px, cannot be seen in the result.
const UNSEEN_PX: f64 = 0.3;
/// With an alignment error of at least this, in px, fine detail may be blurred.
const SOFT_PX: f64 = 1.0;
/// Smallest share of the picture that is mentioned, for example of pixels that are cropped or clipped.
const WORTH: f64 = 0.005;
/// Smallest exposure correction that is mentioned, in stops.
const CORRECTED: f64 = 0.15;

/// Returns the list of processing steps, one sentence or more for each.
pub(in crate::page) fn done(report: &Report) -> String {
    let mut items = vec![("Frames", frames(report))];
    items.push(("Alignment", alignment(report)));
    items.extend(crop(report).map(|words| ("Edges", words)));
    items.extend(movement(report).map(|words| ("Movement", words)));
    items.extend(local(report).map(|words| ("Phone processing", words)));
    items.extend(exposures(report).map(|words| ("Exposures", words)));
    items.extend(response(report).map(|words| ("Camera", words)));
    items.extend(bounds(report).map(|words| ("Limits", words)));
    let item = |(name, words): &(&str, String)| format!("<div><dt>{name}</dt><dd>{words}</dd></div>\n");
    format!("<dl class=\"done\">\n{}</dl>\n", items.iter().map(item).collect::<String>())
}

/// Returns the names of `frames` in bold, joined by commas and a final "and".
fn named<'a>(frames: impl Iterator<Item = &'a FrameReport>) -> String {
    let names: Vec<String> = frames.map(|frame| format!("<b>{}</b>", file_name(&frame.path))).collect();
    match names.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} and {last}", others.join(", ")),
        None => String::new(),
    }
}

/// Returns the frames with the given status.
fn with(report: &Report, status: Status) -> impl Iterator<Item = &FrameReport> + Clone {
    report.frames.iter().filter(move |frame| frame.alignment.status == status)
}

/// Returns the name of the reference frame, in bold.
fn reference(report: &Report) -> String {
    named(with(report, Status::Reference))
}

/// Describes how many frames were merged, and which were not merged and why.
fn frames(report: &Report) -> String {
    let taken: Vec<&FrameReport> = report.frames.iter().filter(|f| f.alignment.rejected_by.is_none()).collect();
    let (count, all) = (taken.len(), report.frames.len());
    let what = if report.radiance.is_some() { "merged" } else { "aligned" };
    let mut words = match count == all {
        true => format!("All {all} frames were {what}."),
        false => format!("{count} of {all} frames were {what}."),
    };
    let stops = |frame: &FrameReport| libm::log2(frame.relative_exposure);
    let span = taken.iter().map(|f| stops(f)).fold(f64::MIN, f64::max)
        - taken.iter().map(|f| stops(f)).fold(f64::MAX, f64::min);
    words += &format!(" Their exposures are {span:.1} stops apart.");
    if let Some(stops) = report.radiance.as_ref().and_then(|merged| merged.range_stops) {
        words +=
            &format!(" The dynamic range of the result is {stops:.1} stops, between the noise floor and clipping.");
    }
    let out = [
        (Status::Rejected, "could not be aligned", "could not be aligned"),
        (Status::Excluded, "was excluded by you", "were excluded by you"),
        (Status::Flash, "was taken with flash, unlike other frames", "were taken with flash, unlike other frames"),
    ];
    for (status, one, several) in out {
        let frames = with(report, status);
        let count = frames.clone().count();
        if count > 0 {
            words += &format!(" {} {}.", named(frames), if count == 1 { one } else { several });
        }
    }
    words
}

/// Describes how the camera moved, and the remaining alignment error.
fn alignment(report: &Report) -> String {
    let mut words = String::new();
    let length = |frame: &FrameReport| frame.alignment.shift_px.map_or(0.0, |[x, y]| (x * x + y * y).sqrt());
    let aligned = with(report, Status::Aligned);
    if aligned.clone().count() > 0 {
        let shift = aligned.clone().map(length).fold(0.0, f64::max);
        let angle = aligned.clone().filter_map(|f| f.alignment.rotation_deg).map(f64::abs).fold(0.0, f64::max);
        let turn = if angle >= 0.05 { format!(" and {angle:.1}°") } else { String::new() };
        let moved = match shift < 1.0 && turn.is_empty() {
            true => "by less than a pixel".to_owned(),
            false => format!("by up to {shift:.1}\u{a0}px{turn}"),
        };
        words += &format!(
            "The camera moved {moved} between the frames. They were aligned to {}, the reference.",
            reference(report)
        );
        if let Some(error) = aligned.filter_map(|f| f.alignment.error_px).reduce(f64::max) {
            words += &match error {
                error if error < UNSEEN_PX => " The remaining error is too small to see.".to_owned(),
                error if error < SOFT_PX => format!(" The remaining error is about {error:.1}\u{a0}px."),
                error => {
                    format!(
                        " The remaining error is about {error:.1}\u{a0}px in the worst frame: look for soft or double edges."
                    )
                }
            };
        }
    } else {
        let was_off = report.options.as_ref().is_some_and(|options| options.align == AlignMode::None);
        let (unmoved, assumed) = (with(report, Status::Unmoved), with(report, Status::Assumed));
        words += &match (was_off, unmoved.clone().next(), assumed.count()) {
            (true, ..) => "The frames were not aligned, as set by <code>--align none</code>.".to_owned(),
            (false, Some(_), 0) => "No frame was moved.".to_owned(),
            // The assumed transform of a frame may contain motion. So only the unmoved frames are listed.
            (false, Some(_), _) => format!("Not moved: {}.", named(unmoved)),
            (false, None, _) => "No frame was aligned to the reference.".to_owned(),
        };
    }
    let assumed = with(report, Status::Assumed);
    let count = assumed.clone().count();
    if count > 0 {
        words += &format!(
            " {} {} too dark or too bright to be aligned. {} position was estimated from the other frames. The radiance \
             uses {} only where the other frames are clipped or black.",
            named(assumed),
            if count == 1 { "is" } else { "are" },
            if count == 1 { "Its" } else { "Their" },
            if count == 1 { "it" } else { "them" }
        );
    }
    if let Some(path) = &report.transforms_from {
        words += &format!(" The alignment was read from {}.", file_name(path));
    }
    words
}

/// Describes the crop. Returns `None` if less than [`WORTH`] was cut off.
fn crop(report: &Report) -> Option<String> {
    let all = report.width_px * report.height_px;
    let share = 1.0 - (report.crop.width_px * report.crop.height_px) as f64 / all.max(1) as f64;
    let why = match report.options.as_ref().map_or("common", |options| &options.crop) {
        "common" => "because not every frame covers this part. <code>--crop none</code> keeps it.",
        _ => "as set by <code>--crop</code>.",
    };
    (share > WORTH).then(|| format!("{} of the reference was cut off, {why}", percent(share)))
}

/// Describes what moved in the scene. Returns `None` if the frames were only aligned.
fn movement(report: &Report) -> Option<String> {
    report.radiance.as_ref()?;
    let Some(ghosts) = &report.ghosts else {
        return Some(
            "Movement was not looked for: people, leaves and water may appear twice or show through. With \
             <code>--deghost=auto</code> one frame is used there."
                .into(),
        );
    };
    let Some(place) = ghosts.place((report.crop.width_px, report.crop.height_px)) else {
        return Some("Nothing moved in the scene.".into());
    };
    let mut words = format!(
        "Something moved in {} of the picture, mostly {place}. Wherever something moved, the picture shows what {} shows, so that nothing appears twice.",
        percent(ghosts.ghost_fraction),
        reference(report)
    );
    if ghosts.continued_fraction > 0.0 {
        words += &format!(
            " {} of the picture moved and is clipped in the reference frame; these places were filled in from their surroundings.",
            percent(ghosts.continued_fraction)
        );
    }
    Some(words)
}

/// Describes local tone mapping by the phone or camera. Returns `None` if there was none.
fn local(report: &Report) -> Option<String> {
    let local = report.local_processing.as_ref().filter(|local| local.locally_processed)?;
    let (least, most) = LocalReport::range_stops(local)?;
    Some(format!(
        "The phone or camera brightened and darkened parts of each frame before it saved them, \
         by {} to {} stops relative to the reference. This was compensated for before merging. The picture is usable, but \
         the measured brightness is approximate.",
        signed(least, 1),
        signed(most, 1)
    ))
}

/// Describes where the exposures come from, and how they were corrected.
fn exposures(report: &Report) -> Option<String> {
    let of = |source| report.frames.iter().filter(move |frame| frame.exposure_source == source);
    let count = |source| of(source).count();
    let mut words = match (count(ExposureSource::Estimated), count(ExposureSource::Given)) {
        (0, 0) => "Read from the files.".to_owned(),
        (0, _) => "As given with <code>-e</code>.".to_owned(),
        (estimated, _) if estimated == report.frames.len() => {
            "Estimated from the pixels, because the files contain no usable exposures. Set them with <code>-e</code>."
                .to_owned()
        }
        _ => format!(
            "The exposures of {} were estimated from the pixels. Set them with <code>-e</code>.",
            named(of(ExposureSource::Estimated))
        ),
    };
    let is_corrected =
        |f: &&FrameReport| f.exposure_correction_stops.abs() >= CORRECTED && f.alignment.rejected_by.is_none();
    let corrected = report.frames.iter().filter(is_corrected);
    let most = corrected.clone().map(|f| f.exposure_correction_stops.abs()).fold(0.0, f64::max);
    if most > 0.0 {
        words += &format!(" These were corrected by up to {most:.1} stops to match the pixels: {}.", named(corrected));
    }
    Some(words)
}

/// Describes the camera response that was used. Returns `None` if the frames were only aligned.
fn response(report: &Report) -> Option<String> {
    let response = report.response.as_ref()?;
    let is_local = report.local_processing.as_ref().is_some_and(|local| local.locally_processed);
    Some(match (&response.fallback, response.model) {
        (Some(_), _) if is_local => {
            "The response cannot be measured, because the camera tone-mapped the frames; a curve like sRGB was used."
                .into()
        }
        (Some(why), model) => {
            format!(
                "The camera response could not be measured ({}): <code>{}</code> was used.",
                escape(why),
                escape(model)
            )
        }
        (None, "file") => "The camera response was read from the given file.".into(),
        (None, "linear") => "Pixel values were assumed to be proportional to the light.".into(),
        (None, "srgb") => "Pixel values were assumed to be sRGB.".into(),
        (None, _) => "The camera response was measured from the frames themselves.".into(),
    })
}

/// Describes what is clipped or black in every frame. Returns `None` if that is less than [`WORTH`].
fn bounds(report: &Report) -> Option<String> {
    let merged = report.radiance.as_ref()?;
    let pixels = (report.crop.width_px * report.crop.height_px).max(1) as f64;
    let words = [
        (merged.all_clipped, "clipped even in the frame with the shortest exposure", "shorter"),
        (merged.all_black, "black even in the frame with the longest exposure", "longer"),
    ];
    let worth = words.iter().map(|(n, what, add)| (*n as f64 / pixels, what, add)).filter(|w| w.0 > WORTH);
    let words: Vec<String> = worth
        .map(|(share, what, add)| {
            format!("{} of the picture is {what}: a {add} exposure would show more.", percent(share))
        })
        .collect();
    (!words.is_empty()).then(|| words.join(" "))
}
