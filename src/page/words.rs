//! What was done to the bracket, in plain sentences, and what to look at, with what to do about it.
//!
//! In: a [`Report`]. Out: HTML. Cost: none.

use super::markup::{escape, file_name, percent, signed};
use crate::align::Status;
use crate::bracket::exposure::ExposureSource;
use crate::merge::local::LocalReport;
use crate::report::{FrameReport, Report, WarningReport};
use std::path::Path;

/// An error of an alignment, in pixels, that cannot be seen, and one that may blur fine detail.
const UNSEEN_PX: f64 = 0.3;
const SOFT_PX: f64 = 1.0;
/// A share of the picture that is worth a sentence.
const WORTH: f64 = 0.005;
/// A correction of an exposure that is worth a sentence, in stops.
const CORRECTED: f64 = 0.15;

/// A warning, of frames that have the same one.
struct Advice {
    /// The names of the frames; none where it is of the bracket.
    names: Vec<String>,
    what: String,
    remedy: String,
    degrades: bool,
}

impl Advice {
    fn of(warning: &WarningReport, report: &Report) -> Self {
        let message = without_folders(&warning.message, report);
        let is_frame = |name: &str| report.frames.iter().any(|frame| name == own_name(&frame.path));
        let (names, text) = match message.split_once(": ") {
            Some((names, text)) if names.split(", ").all(is_frame) => (names.split(", ").map(str::to_owned).collect(), text),
            _ => (Vec::new(), message.as_str()),
        };
        let (what, remedy) = text.rsplit_once("; ").unwrap_or((text, ""));
        Advice { names, what: what.to_owned(), remedy: remedy.to_owned(), degrades: warning.degrades }
    }

    /// What is done about it, for any of its frames.
    fn general(&self) -> String {
        self.names.iter().fold(self.remedy.clone(), |text, name| text.replace(name.as_str(), "FILE"))
    }

    /// Takes the frames of `other`, if that says the same of them but for what is measured.
    fn takes(&mut self, other: &Advice) -> bool {
        if self.names.is_empty() || other.names.is_empty() || self.general() != other.general() {
            return false;
        }
        // What is measured stands behind a colon or between brackets.
        let end = common(&self.what, &other.what);
        let is_end = |text: &str| text.is_empty() || text.trim_start().starts_with([':', '(']);
        let end = match is_end(&self.what[end..]) && is_end(&other.what[end..]) {
            true => Some(end),
            false => self.what[..end].rfind([':', '(']),
        };
        let Some(end) = end else { return false };
        self.what.truncate(self.what[..end].trim_end().len());
        self.remedy = self.general();
        self.names.extend(other.names.iter().cloned());
        true
    }

    fn html(&self) -> String {
        let (class, word) = if self.degrades { ("grave", "Have a look") } else { ("mild", "Good to know") };
        let names = if self.names.is_empty() { String::new() } else { format!(": {}", escape(&self.names.join(", "))) };
        let [what, remedy] = [&self.what, &self.remedy].map(|text| capital(&with_code(&escape(text))));
        let remedy = if remedy.is_empty() { remedy } else { format!("<span class=\"remedy\">{remedy}.</span>") };
        format!("<li class=\"{class}\"><b>{word}{names}.</b> {what}.{remedy}</li>\n")
    }
}

/// Where `a` and `b` begin to differ.
fn common(a: &str, b: &str) -> usize {
    a.char_indices().zip(b.chars()).find(|((_, a), b)| a != b).map_or(a.len().min(b.len()), |((at, _), _)| at)
}

/// What the user should know, each with what to do about it.
pub(super) fn warnings(report: &Report) -> String {
    if report.warnings.is_empty() {
        return "<p class=\"calm\"><b>No warnings.</b> Every frame has its place, the exposures are known, and nothing had to be guessed.</p>\n"
            .into();
    }
    let mut all: Vec<Advice> = Vec::new();
    for warning in &report.warnings {
        let advice = Advice::of(warning, report);
        if !all.iter_mut().any(|other| other.degrades == advice.degrades && other.takes(&advice)) {
            all.push(advice);
        }
    }
    let items: String = all.iter().map(Advice::html).collect();
    format!("<div class=\"warnings\" role=\"note\" aria-label=\"Warnings\">\n<ul>\n{items}</ul>\n</div>\n")
}

/// The name of a file without its folder.
fn own_name(path: &str) -> String {
    Path::new(path).file_name().map_or_else(|| path.to_owned(), |name| name.to_string_lossy().into_owned())
}

/// `text` in which frames are named without their folders.
fn without_folders(text: &str, report: &Report) -> String {
    report.frames.iter().fold(text.to_owned(), |text, frame| text.replace(&frame.path, &own_name(&frame.path)))
}

/// Escaped `text` with options set as code.
fn with_code(text: &str) -> String {
    let word = |word: &str| {
        let bare = word.trim_end_matches([',', '.', ';', ':']);
        match bare.starts_with("--") || bare == "-e" {
            true => format!("<code>{bare}</code>{}", &word[bare.len()..]),
            false => word.to_owned(),
        }
    };
    text.split(' ').map(word).collect::<Vec<_>>().join(" ")
}

/// `text` with a capital at its beginning, unless that is markup.
fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// What was done, one thing after the other.
pub(super) fn done(report: &Report) -> String {
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

/// The frames for which `is`, by name, in bold and with an `and`.
fn named<'a>(frames: impl Iterator<Item = &'a FrameReport>) -> String {
    let names: Vec<String> = frames.map(|frame| format!("<b>{}</b>", file_name(&frame.path))).collect();
    match names.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} and {last}", others.join(", ")),
        None => String::new(),
    }
}

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
    words += &match &report.radiance {
        Some(merged) => format!(
            " Their exposures are {span:.1} stops apart. The result holds {:.1} stops from dark to bright.",
            merged.radiance.dynamic_range_stops
        ),
        None => format!(" Their exposures are {span:.1} stops apart."),
    };
    let out = [
        (Status::Rejected, "did not fit the others, however it was moved", "did not fit the others, however they were moved"),
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
                error => format!(" About {error:.1}\u{a0}px are left in the worst frame: look for soft or double edges."),
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
                " {} is too dark or too bright to be aligned. It was assumed to lie where the others say, and serves only where they show nothing.",
                named(assumed)
            );
        }
        _ => {
            words += &format!(
                " {} are too dark or too bright to be aligned. They were assumed to lie where the others say, and serve only where those show nothing.",
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
        words += &format!(
            " In {} that is white, and was filled from around.",
            percent(ghosts.continued_fraction)
        );
    }
    Some(words)
}

/// What the phone did to the frames; none where it did nothing.
fn local(report: &Report) -> Option<String> {
    let local = report.local_processing.as_ref().filter(|local| local.locally_processed)?;
    let (least, most) = LocalReport::range_stops(local)?;
    Some(format!(
        "The phone or camera brightened and darkened parts of each frame before it saved them. Against the reference that makes {} to {} stops; it was evened \
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
    let is_corrected = |f: &&FrameReport| {
        f.exposure_correction_stops.abs() >= CORRECTED && f.alignment.rejected_by.is_none()
    };
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
        (Some(_), _) if is_local => "Its response cannot be measured from such frames: that of sRGB was assumed.".into(),
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
        .map(|(share, what, add)| format!("{} of the picture is {what}: a {add} exposure would show more.", percent(share)))
        .collect();
    (!words.is_empty()).then(|| words.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn advice(name: &str, what: &str) -> Advice {
        Advice { names: vec![name.into()], what: what.into(), remedy: format!("give --unmoved {name}"), degrades: true }
    }

    #[test]
    fn frames_with_one_warning_but_for_its_numbers_share_it() {
        let mut all = advice("a.jpg", "left out: nothing fits: 3 of 9 parts contradict");
        assert!(all.takes(&advice("b.jpg", "left out: nothing fits: 4 of 9 parts contradict")));
        assert!(all.takes(&advice("c.jpg", "left out: nothing fits: 53 of 99 parts contradict")));
        assert!(!all.takes(&advice("d.jpg", "aligned with low confidence (0.4)")));
        assert_eq!((all.what.as_str(), all.names.len(), all.remedy.as_str()), ("left out: nothing fits", 3, "give --unmoved FILE"));
        let mut low = advice("a.jpg", "aligned with low confidence (0.43)");
        assert!(low.takes(&advice("b.jpg", "aligned with low confidence (0.28)")));
        assert_eq!(low.what, "aligned with low confidence");
    }

    #[test]
    fn options_are_code_and_marks_are_not() {
        assert_eq!(with_code("give --unmoved a.jpg, or --crop none."), "give <code>--unmoved</code> a.jpg, or <code>--crop</code> none.");
        assert_eq!(with_code("give -e to set it; --flare;"), "give <code>-e</code> to set it; <code>--flare</code>;");
        assert_eq!((capital("it is"), capital("")), ("It is".to_owned(), String::new()));
    }
}
