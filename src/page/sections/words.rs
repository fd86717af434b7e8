//! What was done to the bracket, in plain sentences.
//!
//! In: a [`Report`]. Out: HTML. Cost: none.

use crate::align::Status;
use crate::bracket::exposure::ExposureSource;
use crate::merge::local::LocalReport;
use crate::page::markup::{escape, file_name, percent, signed};
use crate::report::{FrameReport, Report};

/// An error of an alignment, in pixels, that cannot be seen, and one that may blur fine detail.
const UNSEEN_PX: f64 = 0.3;
const SOFT_PX: f64 = 1.0;
/// A share of the picture that is worth a sentence.
const WORTH: f64 = 0.005;
/// A correction of an exposure that is worth a sentence, in stops.
const CORRECTED: f64 = 0.15;

/// What was done, one thing after the other.
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

/// `frames` by name, in bold and with an `and`.
fn named<'a>(frames: impl Iterator<Item = &'a FrameReport>) -> String {
    let names: Vec<String> = frames.map(|frame| format!("<b>{}</b>", file_name(&frame.path))).collect();
    match names.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} and {last}", others.join(", ")),
        None => String::new(),
    }
}

/// The frames of that status.
fn with(report: &Report, status: Status) -> impl Iterator<Item = &FrameReport> + Clone {
    report.frames.iter().filter(move |frame| frame.alignment.status == status)
}

/// The reference, by name.
fn reference(report: &Report) -> String {
    named(with(report, Status::Reference))
}

/// How many frames were merged, and which were left out and why.
fn frames(report: &Report) -> String {
    let taken: Vec<&FrameReport> = report.frames.iter().filter(|f| f.alignment.rejected_by.is_none()).collect();
    let (count, all) = (taken.len(), report.frames.len());
    let what = if report.radiance.is_some() { "merged" } else { "aligned" };
    let mut words = match count == all {
        true => format!("All {all} frames were {what}."),
        false => format!("{count} of {all} frames were {what}, {} left out.", all - count),
    };
    let stops = |frame: &FrameReport| libm::log2(frame.relative_exposure);
    let span = taken.iter().map(|f| stops(f)).fold(f64::MIN, f64::max)
        - taken.iter().map(|f| stops(f)).fold(f64::MAX, f64::min);
    words += &format!(" Their exposures are {span:.1} stops apart.");
    if let Some(stops) = report.radiance.as_ref().and_then(|merged| merged.range_stops) {
        words += &format!(" The result holds {stops:.1} stops above the noise and below clipping.");
    }
    let out = [
        (
            Status::Rejected,
            "did not fit the others, however it was moved",
            "did not fit the others, however they were moved",
        ),
        (Status::Excluded, "was excluded by you", "were excluded by you"),
        (Status::Flash, "was taken with flash, unlike the others", "were taken with flash, unlike the others"),
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

/// How the camera moved, and what is left of that.
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
            "The camera moved {moved} between the frames. They were fitted to {}, the reference.",
            reference(report)
        );
        if let Some(error) = aligned.filter_map(|f| f.alignment.error_px).reduce(f64::max) {
            words += &match error {
                error if error < UNSEEN_PX => " What is left of that cannot be seen.".to_owned(),
                error if error < SOFT_PX => format!(" What is left is about {error:.1}\u{a0}px."),
                error => {
                    format!(" About {error:.1}\u{a0}px are left in the worst frame: look for soft or double edges.")
                }
            };
        }
    } else {
        words += "The camera stood still: the frames fit as they are.";
    }
    let assumed = with(report, Status::Assumed);
    match assumed.clone().count() {
        0 => {}
        1 => {
            words += &format!(
                " {} is too dark or too bright to be aligned. It was assumed to lie where the others say, and serves only where \
                 they show nothing.",
                named(assumed)
            );
        }
        _ => {
            words += &format!(
                " {} are too dark or too bright to be aligned. They were assumed to lie where the others say, and serve only \
                 where those show nothing.",
                named(assumed)
            );
        }
    }
    if let Some(path) = &report.transforms_from {
        words += &format!(" The places were taken from {}.", file_name(path));
    }
    words
}

/// What was cut off; none where nothing was.
fn crop(report: &Report) -> Option<String> {
    let all = report.width_px * report.height_px;
    let share = 1.0 - (report.crop.width_px * report.crop.height_px) as f64 / all.max(1) as f64;
    (share > WORTH).then(|| {
        format!(
            "{} of the reference was cut off, where not every frame reaches. <code>--crop none</code> keeps it.",
            percent(share)
        )
    })
}

/// What moved in the scene; none where frames were only aligned.
fn movement(report: &Report) -> Option<String> {
    report.radiance.as_ref()?;
    let Some(ghosts) = &report.ghosts else {
        return Some(
            "Movement was not looked for: people, leaves and water may show through. <code>--deghost=auto</code> removes them."
                .into(),
        );
    };
    let Some(place) = ghosts.place((report.crop.width_px, report.crop.height_px)) else {
        return Some("Nothing moved in the scene.".into());
    };
    let mut words = format!(
        "Something moved in {} of the picture, most of it {place}. There the picture shows what {} shows, so that nothing appears twice.",
        percent(ghosts.ghost_fraction),
        reference(report)
    );
    if ghosts.continued_fraction > 0.0 {
        words += &format!(" In {} that is white, and was filled from around.", percent(ghosts.continued_fraction));
    }
    Some(words)
}

/// What the phone did to the frames; none where it did nothing.
fn local(report: &Report) -> Option<String> {
    let local = report.local_processing.as_ref().filter(|local| local.locally_processed)?;
    let (least, most) = LocalReport::range_stops(local)?;
    Some(format!(
        "The phone or camera brightened and darkened parts of each frame before it saved them. Against the reference that makes \
         {} to {} stops; it was evened \
         out before merging. The picture is sound, but the measured light is approximate.",
        signed(least, 1),
        signed(most, 1)
    ))
}

/// Where exposures are from.
fn exposures(report: &Report) -> Option<String> {
    let of = |source| report.frames.iter().filter(move |frame| frame.exposure_source == source);
    let count = |source| of(source).count();
    let mut words = match (count(ExposureSource::Estimated), count(ExposureSource::Given)) {
        (0, 0) => "Read from the files.".to_owned(),
        (0, _) => "As given with <code>-e</code>.".to_owned(),
        (estimated, _) if estimated == report.frames.len() => {
            "Assumed from the pixels, because the files do not have them. <code>-e</code> sets them.".to_owned()
        }
        _ => format!(
            "Those of {} were assumed from the pixels. <code>-e</code> sets them.",
            named(of(ExposureSource::Estimated))
        ),
    };
    let is_corrected =
        |f: &&FrameReport| f.exposure_correction_stops.abs() >= CORRECTED && f.alignment.rejected_by.is_none();
    let corrected = report.frames.iter().filter(is_corrected);
    let most = corrected.clone().map(|f| f.exposure_correction_stops.abs()).fold(0.0, f64::max);
    if most > 0.0 {
        words += &format!(" Corrected by up to {most:.1} stops, as the pixels show: {}.", named(corrected));
    }
    Some(words)
}

/// What codes were taken to mean; none where frames were only aligned.
fn response(report: &Report) -> Option<String> {
    let response = report.response.as_ref()?;
    let is_local = report.local_processing.as_ref().is_some_and(|local| local.locally_processed);
    Some(match (&response.fallback, response.model) {
        (Some(_), _) if is_local => {
            "Its response cannot be measured from such frames: that of sRGB was assumed.".into()
        }
        (Some(why), model) => {
            format!("Its response could not be measured ({}): <code>{}</code> was assumed.", escape(why), escape(model))
        }
        (None, "file") => "Its response was read from the file given.".into(),
        (None, "linear") => "Pixel values were taken as proportional to the light.".into(),
        (None, "srgb") => "Pixel values were taken as sRGB.".into(),
        (None, _) => "Its response to light was measured from the frames themselves.".into(),
    })
}

/// What no frame shows.
fn bounds(report: &Report) -> Option<String> {
    let merged = report.radiance.as_ref()?;
    let pixels = (report.crop.width_px * report.crop.height_px).max(1) as f64;
    let words = [
        (merged.all_clipped, "white even in the shortest frame", "shorter"),
        (merged.all_black, "black even in the longest frame", "longer"),
    ];
    let worth = words.iter().map(|(n, what, add)| (*n as f64 / pixels, what, add)).filter(|w| w.0 > WORTH);
    let words: Vec<String> = worth
        .map(|(share, what, add)| {
            format!("{} of the picture is {what}: a {add} exposure would show more.", percent(share))
        })
        .collect();
    (!words.is_empty()).then(|| words.join(" "))
}
