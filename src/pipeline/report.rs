//! The report of a run: the sections filled by its stages.
//!
//! In: the options of the run, and the results of each stage. Out: a [`Report`] without outputs, warnings and times.
//! Cost: negligible.

use super::Options;
use crate::bracket::Bracket;
use crate::merge::deghost::Ghosts;
use crate::pipeline::stages::picture::Picture;
use crate::pipeline::stages::radiance::Radiance;
use crate::pipeline::stages::reference::Aligned;
use crate::pipeline::stages::response::Camera;
use crate::report::Report;
use crate::report::options::OptionsReport;
use crate::write::picture::Size;

/// Returns the report of a run that only aligns.
pub(super) fn of_alignment(Aligned { bracket, alignment, region }: &Aligned, options: &Options) -> Report {
    Report { options: Some(options_report(bracket, options, false)), ..Report::new(bracket, alignment, *region) }
}

/// Returns the report of a run that merges.
pub(super) fn of_merge(
    aligned: &Aligned,
    camera: Camera,
    radiance: &Radiance,
    picture: &Picture,
    options: &Options,
) -> Report {
    Report {
        options: Some(options_report(&aligned.bracket, options, true)),
        local_processing: camera.local_report(radiance.local.as_ref()),
        response: Some(camera.report),
        radiance: Some(radiance.merged.report(radiance.statistics, radiance.limits, options.unit_exposure)),
        calibration: radiance.calibration,
        colour: Some(radiance.rows.primaries().into()),
        flare: radiance.flare,
        white_balance: picture.light,
        ghosts: radiance.ghosts.as_ref().map(Ghosts::report),
        ..of_alignment(aligned, options)
    }
}

/// Returns the report's section on options: all options if the run `merges`, otherwise only those of the alignment.
fn options_report(bracket: &Bracket, options: &Options, merges: bool) -> OptionsReport {
    let file = options.response_file.as_ref().filter(|_| merges);
    OptionsReport {
        align: options.align.mode,
        local: options.align.local,
        robust: options.align.robust,
        max_rotation_deg: options.align.mtb.max_rotation_deg,
        crop: options.crop.to_string(),
        exposures: merges.then_some(options.exposures),
        response_model: (merges && file.is_none()).then(|| options.response.name()),
        response_file: file.map(|path| path.to_string_lossy().into_owned()),
        weight: merges.then(|| options.weight_for(bracket)),
        deghost_strength: options.deghost.strength().filter(|_| merges),
        flare: merges.then_some(options.flare),
        colour: options.colour.filter(|_| merges),
        operator: merges.then(|| options.rendering.clone()),
        adjust: merges.then_some(options.write.picture.adjust),
        bit_depth: merges.then_some(options.write.picture.depth.bits()),
        picture_colour: merges.then_some(options.write.picture.colours),
        resize: Some(options.write.picture.size).filter(|size| merges && *size != Size::Full).map(|s| s.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Crop;
    use super::*;
    use crate::merge::deghost::Deghost;
    use crate::response::tests::still;

    #[test]
    fn options_of_an_alignment_have_no_radiance() {
        let options = Options {
            response_file: Some("c.json".into()),
            deghost: Deghost::Strength(0.25),
            crop: Crop::None,
            ..Options::default()
        };
        let (bracket, _) = still((8, 8), &[1.0, 2.0], |_, _| [0.1; 3]);
        let json = |merges| serde_json::to_value(options_report(&bracket, &options, merges)).unwrap();
        let (merged, aligned) = (json(true), json(false));
        assert_eq!((&merged["crop"], &aligned["crop"]), (&"none".into(), &"none".into()));
        assert_eq!((&merged["response_file"], &merged["response_model"]), (&"c.json".into(), &().into()));
        assert_eq!((&merged["deghost_strength"], &merged["bit_depth"]), (&0.25.into(), &8.into()));
        assert_eq!(merged["weight"], "hat");
        let radiance = [
            "exposures",
            "response_model",
            "response_file",
            "weight",
            "deghost_strength",
            "flare",
            "operator",
            "adjust",
            "bit_depth",
        ];
        assert!(radiance.iter().all(|key| aligned[*key].is_null()), "{aligned}");
    }
}
