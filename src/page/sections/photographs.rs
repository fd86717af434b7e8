//! The frames: exposures, alignment and median threshold bitmaps.
//!
//! In: a [`Page`] and its [`Report`]. Out: HTML. Cost: none.

use super::summary;
use crate::align::{Model, Status};
use crate::bracket::exposure::ExposureSource;
use crate::inspect::text::{shutter, status_word};
use crate::page::markup::{escape, figure, file_name, img, percent, signed};
use crate::page::pictures::evidence::{Evidence, Overlay, Xor};
use crate::page::{FramePage, Page, frame_css, is_searched};
use crate::report::{FrameReport, Report};
use std::fmt::Write;

/// Returns the exposure of each frame relative to the reference, in stops.
pub(in crate::page) fn stops_over_reference(report: &Report) -> Vec<f64> {
    let reference = report.frames.iter().find(|f| f.alignment.status == Status::Reference);
    let unit = reference.map_or(1.0, |f| f.relative_exposure);
    report.frames.iter().map(|f| libm::log2(f.relative_exposure / unit)).collect()
}

/// Returns the frames as cards.
pub(in crate::page) fn frames(page: &Page, report: &Report) -> String {
    let mut out = String::from(
        "<p class=\"intro\">From the shortest exposure to the longest, each aligned to the reference and cropped like \
         the result. Each frame has one colour throughout the page. EV is relative to the reference.</p>\n",
    );
    let ratio = report.crop.width_px as f64 / report.crop.height_px.max(1) as f64;
    let _ = writeln!(out, "<ul class=\"cards\" style=\"--ratio:{ratio:.4}\">");
    let stops = stops_over_reference(report);
    for (i, (frame, shown)) in report.frames.iter().zip(&page.frames).enumerate() {
        let colour = frame_css(i, report.frames.len());
        let (name, status) = (file_name(&frame.path), status_word(frame.alignment.status));
        let class = status.replace(' ', "-");
        let photograph = img(&shown.photograph, &format!("Frame {}.", frame.path));
        let lies = match frame.alignment.status {
            Status::Reference => "the reference",
            Status::Unmoved => "as photographed",
            Status::Aligned | Status::Assumed => "aligned",
            Status::Rejected | Status::Excluded | Status::Flash => "not used, shown without alignment",
        };
        let ghosts =
            report.ghosts.iter().flat_map(|g| &g.frames).find(|g| g.path == frame.path && g.ghost_fraction > 0.0);
        let left_out = ghosts.map_or_else(String::new, |ghost| {
            format!("<div><dt>not used</dt><dd>{}, because of movement</dd></div>\n", percent(ghost.ghost_fraction))
        });
        let share = shown.share.as_ref().map_or_else(String::new, |(share, _)| {
            format!("<div><dt>share</dt><dd>{} of the result</dd></div>\n", percent(*share))
        });
        let _ = write!(
            out,
            "<li class=\"card {class}\" style=\"--own:{colour}\" data-caption=\"{name}, {ev} EV, {lies}\">\n{photograph}\n\
             <div class=\"about\">\n<h3>{name}</h3>\n\
             <p class=\"stops\">{ev} <small>EV</small> <span class=\"chip\">{status}</span></p>\n<dl>\n\
             <div><dt>exposure</dt><dd>{}</dd></div>\n<div><dt>motion</dt><dd>{}</dd></div>\n{share}{left_out}</dl>\n</div>\n</li>\n",
            exposure(frame),
            summary::motion(frame),
            ev = signed(stops[i], 2),
        );
    }
    out + "</ul>\n"
}

/// Returns the exposure of a frame, and its source if that is not EXIF.
fn exposure(frame: &FrameReport) -> String {
    let time = frame.time_s.map(|t| escape(&shutter(t)).replace(' ', "\u{a0}"));
    let aperture = frame.f_number.map(|n| format!("f/{}", (n * 10.0).round() / 10.0));
    let iso = frame.iso.map(|s| format!("ISO\u{a0}{s:.0}"));
    let mut parts: Vec<String> = [time, aperture, iso].into_iter().flatten().collect();
    match frame.exposure_source {
        ExposureSource::Exif => {}
        ExposureSource::Given => parts.push("given with -e".into()),
        ExposureSource::Estimated => parts.push("estimated from the pixels".into()),
    }
    if frame.exposure_correction_stops.abs() >= 0.005 {
        parts.push(format!("corrected by {} EV", signed(frame.exposure_correction_stops, 2)));
    }
    parts.join(" · ")
}

/// Returns the pictures and plots that show the alignment of each frame but the reference, then the keypoints of the
/// reference.
pub(in crate::page) fn moved(page: &Page, report: &Report) -> String {
    let all: Vec<(&FrameReport, &FramePage)> = report.frames.iter().zip(&page.frames).collect();
    let mut out = String::new();
    if !all.iter().any(|(frame, _)| is_searched(frame.alignment.status)) {
        out += "<p class=\"intro\">No frame was moved. The measurements are below.</p>\n";
    } else {
        out += "<p class=\"intro\">Edges of the reference in orange, edges of the frame in blue; where both \
                coincide they are white. Move the slider: left of it the frame is as photographed, right of it as \
                aligned. Right of the slider nearly all edges should be white. A single blue or orange edge means \
                that the other frame is clipped or black there, or that something moved in the scene.</p>\n";
    }
    for (frame, shown) in all.iter().filter(|(frame, _)| frame.alignment.status != Status::Reference) {
        let status = status_word(frame.alignment.status);
        let class = status.replace(' ', "-");
        let mut heading = format!("<b>{}</b> <span class=\"chip\">{status}</span>", file_name(&frame.path));
        if matches!(frame.alignment.status, Status::Aligned | Status::Assumed) {
            let _ = write!(heading, " <span class=\"n\">{}</span>", summary::motion(frame));
        }
        let _ = write!(out, "<details class=\"frame {class}\">\n<summary>{heading}</summary>\n");
        if let Some(reason) = frame.alignment.reason.as_ref() {
            let what = match frame.alignment.status {
                Status::Assumed => "Assumed",
                Status::Rejected | Status::Excluded | Status::Flash => "Left out",
                Status::Unmoved => "Not aligned",
                Status::Reference | Status::Aligned => "Note",
            };
            let _ = writeln!(out, "<p class=\"reason\">{what}: {}</p>", escape(reason));
        }
        if let Some(overlay) = &shown.evidence.overlay {
            out += &compare(overlay, &file_name(&frame.path));
        }
        out += &comparison(frame);
        if let Some(xor) = &shown.evidence.xor {
            out += &curves(xor, frame);
        }
        out += &features(&shown.evidence, frame);
        out += "</details>\n";
    }
    if let Some((frame, shown)) = all.iter().find(|(frame, _)| frame.alignment.status == Status::Reference)
        && shown.evidence.keypoints.is_some()
    {
        let _ = write!(
            out,
            "<details class=\"frame\">\n<summary><b>{}</b> <span class=\"chip\">reference</span></summary>\n",
            file_name(&frame.path)
        );
        out += &features(&shown.evidence, frame);
        out += "</details>\n";
    }
    out
}

/// Returns the edges before and after alignment, with a slider between them.
fn compare(overlay: &Overlay, name: &str) -> String {
    let before_words = "The edges before alignment.";
    let Some(after) = &overlay.after else {
        let caption =
            "The edges before alignment. The frame could not be aligned, so there is no picture after alignment.";
        return figure(&overlay.before, before_words, caption);
    };
    let ratio = overlay.before.width as f64 / overlay.before.height as f64;
    let details = match overlay.has_details {
        true => " Below: the three marked areas at 200\u{a0}%, where an error of half a pixel is visible.",
        false => "",
    };
    format!(
        "<figure class=\"compare\" style=\"--ratio:{ratio:.4}\">\n<div class=\"stack\">\n{}\n{}\n\
         <span class=\"tag left\">before</span><span class=\"tag right\">after</span>\n</div>\n<label><span>before</span><input \
         type=\"range\" min=\"0\" max=\"100\" value=\"50\" step=\"1\" aria-label=\"{name}: how much is shown \
         as photographed, the rest as aligned\"><span>after</span></label>\n<figcaption><span class=\"key orange\"></span> reference \
         <span class=\"key blue\"></span> this frame <span class=\"key white\"></span> both.{details}</figcaption>\n</figure>\n",
        img(&overlay.before, before_words),
        img(after, "Edges after alignment.").replacen("<img ", "<img class=\"after\" ", 1),
    )
}

/// Returns the alignment of a frame in numbers.
fn comparison(frame: &FrameReport) -> String {
    let place = &frame.alignment;
    let model = place.model.map(|m| match m {
        Model::Unmoved => "none",
        Model::Shift => "shift",
        Model::Rigid => "shift and rotation",
        Model::Homography => "homography",
    });
    let rows = [
        ("motion model", model.map(str::to_owned)),
        ("shift, right and down", place.shift_px.map(|[x, y]| format!("{} px, {} px", signed(x, 2), signed(y, 2)))),
        ("rotation, right to down", place.rotation_deg.map(|a| format!("{}°", signed(a, 3)))),
        ("alignment error, estimated", place.error_px.map(|e| format!("{e:.2} px"))),
        ("confidence", Some(format!("{:.2}", place.confidence))),
        (
            "keypoints: photograph / bitmap / merged",
            place.keypoints.map(|k| format!("{} / {} / {}", k.plain, k.mtb, k.merged)),
        ),
        ("matches that agree (inliers)", place.inliers.map(|n| n.to_string())),
    ];
    let rows = rows.iter().filter_map(|(name, value)| value.as_ref().map(|v| (name, v)));
    let mut out = String::from("<dl class=\"numbers\">\n");
    for (name, value) in rows {
        let _ = writeln!(out, "<div><dt>{name}</dt><dd>{value}</dd></div>");
    }
    if let Some(h) = place.homography.filter(|_| place.model == Some(Model::Homography)) {
        let cell = |v: &f64| format!("<td>{v:.6}</td>").replace('-', "\u{2212}");
        let row = |r: &[f64]| format!("<tr>{}</tr>", r.iter().map(cell).collect::<String>());
        let rows: String = h.chunks(3).map(row).collect();
        let _ = writeln!(
            out,
            "<div class=\"wide\"><dt>homography, reference pixel to frame pixel</dt><dd><table class=\"matrix\">{rows}</table></dd></div>"
        );
    }
    out + "</dl>\n"
}

/// Returns the plots of the bitmap difference as a function of rotation and of shift.
fn curves(xor: &Xor, frame: &FrameReport) -> String {
    let [angle, dx, dy] = &xor.plots;
    let about = if frame.alignment.status.rejected_by().is_some() {
        "the motion for which the bitmaps differ least"
    } else {
        "the motion found"
    };
    format!(
        "<figure class=\"plots\">\n<div class=\"row\">{angle}{dx}{dy}</div>\n<figcaption><b>Bitmap difference, plotted over \
         rotation and shift.</b> {} of the compared pixels differ before alignment, and {} with {about} (dashed \
         line). Each curve varies one parameter and keeps the other two. A sharp minimum at the line confirms \
         the alignment. Check the frame if the curve is flat or has its minimum elsewhere.</figcaption>\n</figure>\n",
        percent(xor.before),
        percent(xor.after)
    )
}

/// Returns the keypoints and matches of a frame, if its alignment needed features.
fn features(evidence: &Evidence, frame: &FrameReport) -> String {
    let mut out = String::new();
    let bright = if evidence.brightened { " The frame is shown brightened." } else { "" };
    if let Some((svg, [plain, bitmap, both])) = &evidence.keypoints {
        let _ = write!(
            out,
            "<figure>\n{svg}<figcaption><b>Keypoints.</b> <span class=\"key plain\"></span> only in the photograph: {plain} \
             <span class=\"key bitmap\"></span> only in its bitmaps: {bitmap} <span class=\"key both\"></span> in both: \
             {both}. They should be spread \
             over the whole picture; areas without keypoints do not contribute to the alignment.{bright}</figcaption>\n</figure>\n"
        );
    }
    if let Some((svg, all, inliers)) = &evidence.matches {
        let _ = write!(
            out,
            "<figure>\n{svg}<figcaption><b>Matches</b> with the reference (left): {all}, of which \
             <span class=\"key inlier\"></span> {inliers} agree on one motion and <span class=\"key outlier\"></span> \
             {} do not. Lines of matches that agree are nearly parallel. As many orange as blue lines mean that \
             the alignment is uncertain.</figcaption>\n</figure>\n",
            all - inliers
        );
    }
    if out.is_empty() && is_searched(frame.alignment.status) {
        out += "<p class=\"note\">Features were not needed: bitmaps and pixels were enough for the alignment. \
                <code>hdralign inspect</code> draws the features of every frame.</p>\n";
    }
    out
}

/// Returns the median threshold bitmaps of all frames.
pub(in crate::page) fn bitmaps(page: &Page, report: &Report) -> String {
    let mut out = String::from(
        "<p class=\"intro\">Median threshold bitmaps make frames of different exposure comparable. White is \
         brighter than the threshold of the frame, black is darker, and ochre is too close to it to count (the \
         exclusion bitmap). The bitmaps of all frames should look alike. If they do not, the exposures are too far \
         apart or the picture has few tones, and features are needed for the alignment.</p>\n<div class=\"grid\">\n",
    );
    for (frame, shown) in report.frames.iter().zip(&page.frames) {
        let (percentile, level, excluded) = shown.evidence.threshold;
        let rank = if percentile == 50 { "median".to_owned() } else { format!("{percentile}th percentile") };
        let name = file_name(&frame.path);
        let caption = format!("<b>{name}</b> {rank}, grey value {level}; {} excluded", percent(excluded));
        out += &figure(&shown.evidence.bitmap, &format!("Bitmap of {}.", frame.path), &caption);
    }
    out + "</div>\n"
}
