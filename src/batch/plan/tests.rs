use super::*;

/// Returns a bracket of two photographs in `folder`, with exposures of 1 and 4 s. The first file name has the number
/// `first`.
fn planned(root: &str, folder: &str, first: usize) -> Planned {
    let photographs = [first, first + 1].map(|n| Path::new(root).join(folder).join(format!("IMG_{n}.JPG"))).to_vec();
    Planned {
        root: root.into(),
        folder: folder.into(),
        photographs,
        size: (640, 480),
        depth: 8,
        exposures: vec![1.0, 4.0],
        camera: Some("Canon EOS 5D".into()),
        date_time: Some("2026:11:21 17:05:59".into()),
        set: 1,
    }
}

fn settings() -> Settings {
    Settings { formats: vec!["exr".into(), "png".into()], ..Settings::default() }
}

/// Returns the job of a bracket of two photographs.
pub fn job() -> Job {
    plan(&[planned("/in", "a", 1)], &settings()).unwrap().remove(0)
}

#[test]
fn results_are_in_the_folders_of_the_photographs() {
    let brackets = [planned("/in", "a", 1), planned("/in", "b", 1), planned("/in", "", 5)];
    let beside = plan(&brackets, &settings()).unwrap();
    let reports = |jobs: &[Job]| jobs.iter().map(|s| s.report.to_str().unwrap().to_owned()).collect::<Vec<_>>();
    assert_eq!(reports(&beside), ["/in/a/IMG_1-IMG_2.json", "/in/b/IMG_1-IMG_2.json", "/in/IMG_5-IMG_6.json"]);
    assert_eq!(beside[0].outputs, ["/in/a/IMG_1-IMG_2.exr", "/in/a/IMG_1-IMG_2.png"].map(PathBuf::from));
    assert_eq!(beside[0].failure, Path::new("/in/a/IMG_1-IMG_2.failed.json"));
    assert_eq!(beside[0].id, "a_IMG_1-IMG_2");
    assert!(beside.iter().all(|s| s.summary == Path::new("/in/batch.json")));
    let elsewhere = plan(&brackets, &Settings { output: Some("/out".into()), page: true, ..settings() }).unwrap();
    assert_eq!(elsewhere[1].page.as_deref(), Some(Path::new("/out/b/IMG_1-IMG_2.html")));
    assert_eq!(elsewhere[2].summary, Path::new("/out/batch.json"));
    let several = [planned("/in/x", "a", 1), planned("/in/y", "a", 1)];
    let apart = plan(&several, &Settings { output: Some("/out".into()), ..settings() }).unwrap();
    assert_eq!(reports(&apart), ["/out/x/a/IMG_1-IMG_2.json", "/out/y/a/IMG_1-IMG_2.json"]);
    assert_eq!(
        reports(&plan(&several, &settings()).unwrap()),
        ["/in/x/a/IMG_1-IMG_2.json", "/in/y/a/IMG_1-IMG_2.json"]
    );
}

#[test]
fn no_two_results_have_one_name() {
    let template = Template::parse("all").unwrap();
    let jobs = plan(
        &[planned("/in", "a", 1), planned("/in", "b", 1), planned("/in", "c", 1)],
        &Settings { template, ..settings() },
    )
    .unwrap();
    let reports: Vec<_> = jobs.iter().map(|s| s.report.to_str().unwrap()).collect();
    assert_eq!(reports, ["/in/all.json", "/in/all-2.json", "/in/all-3.json"]);
    let ids: Vec<_> = jobs.iter().map(|s| s.id.as_str()).collect();
    assert_eq!(ids, ["all", "all-2", "all-3"]);
}

/// A job named `x` has the failure file x.failed.json, which is also the report of a job named `x.failed`. So one of
/// the two gets a number in its name. A bracket also gets a number if its files would have the same names as the files
/// of a response, of the summary, or of another bracket.
#[test]
fn no_two_jobs_have_a_file_in_common() {
    let named = |folder: &str| planned("/in", folder, 1);
    let brackets: Vec<Planned> =
        ["x.failed", "x", "batch", "BATCH", "response-Canon_EOS_5D", "x"].into_iter().map(named).collect();
    let template = Template::parse("{folder}").unwrap();
    let jobs = plan(&brackets, &Settings { template, responses: Responses::Shared, ..settings() }).unwrap();
    let reports: Vec<_> = jobs.iter().map(|job| job.report.to_str().unwrap()).collect();
    let expected = ["response-Canon_EOS_5D", "x.failed", "x-2", "batch-2", "BATCH-3", "response-Canon_EOS_5D-2", "x-3"];
    assert_eq!(reports, expected.map(|name| format!("/in/{name}.json")));
}

#[test]
fn a_camera_has_one_response() {
    let mut brackets = vec![planned("/in", "a", 1), planned("/in", "b", 1), planned("/in", "c", 1)];
    brackets[2].camera = None;
    let jobs = plan(&brackets, &Settings { responses: Responses::Shared, ..settings() }).unwrap();
    let kinds: Vec<_> = jobs.iter().map(|s| (s.kind, s.id.as_str())).collect();
    assert_eq!(kinds[..2], [(Kind::Response, "response-unknown_camera"), (Kind::Response, "response-Canon_EOS_5D")]);
    assert_eq!(jobs[1].outputs, [PathBuf::from("/in/response-Canon_EOS_5D.response.json")]);
    assert_eq!(jobs[1].by_bracket(), [brackets[0].photographs.clone(), brackets[1].photographs.clone()]);
    assert_eq!(jobs[2].needs, ["response-Canon_EOS_5D"]);
    assert_eq!(jobs[2].response.as_ref(), Some(&jobs[1].outputs[0]));
    assert_eq!(jobs[4].needs, ["response-unknown_camera"]);
}

#[test]
fn a_panorama_has_one_unit() {
    let mut brackets = vec![planned("/in", "a", 1), planned("/in", "b", 1), planned("/in", "c", 1)];
    brackets[1].exposures = vec![2.0, 8.0, 9.0];
    brackets[2].set = 2;
    brackets[2].exposures = Vec::new();
    let units = |normalisation| {
        let jobs = plan(&brackets, &Settings { normalisation, ..settings() }).unwrap();
        jobs.iter().map(|s| s.unit_exposure_s).collect::<Vec<_>>()
    };
    assert_eq!(units(Normalisation::Bracket), [None, None, None]);
    assert_eq!(units(Normalisation::Set), [Some(4.0), Some(4.0), Some(1.0)]);
    assert_eq!(units(Normalisation::All), [Some(4.0), Some(4.0), Some(4.0)]);
}

#[test]
fn a_plan_is_read_as_it_was_written() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("plan.jsonl");
    let jobs = plan(&[planned("/in", "a", 1), planned("/in", "b \u{fc}", 1)], &settings()).unwrap();
    let text: String = jobs.iter().map(|s| s.to_line().unwrap() + "\n").collect();
    std::fs::write(&path, &text).unwrap();
    assert_eq!(Job::read_all(&path).unwrap(), jobs);
    assert_eq!(Job::read(&path, &["a_IMG_1-IMG_2".into()]).unwrap(), jobs[..1]);
    assert!(Job::read(&path, &["c".into()]).unwrap_err().to_string().contains("no job"));
    let wrong = |text: String, said: &str| {
        std::fs::write(&path, text).unwrap();
        let error = Job::read(&path, std::slice::from_ref(&jobs[0].id)).unwrap_err().to_string();
        assert!(error.contains(said), "{error}");
    };
    let line = jobs[0].to_line().unwrap();
    wrong(format!("{line}\n{line}\n"), "line 2");
    wrong("{}".into(), "line 1");
    wrong(line.replace("hdralign-plan/1", "hdralign-plan/9"), "hdralign-plan/9");
    wrong(line.replace("\"brackets\":[2]", "\"brackets\":[3]"), "brackets");
    wrong(line.replace(super::super::SOFTWARE, "hdralign 99"), "plan again");
}
