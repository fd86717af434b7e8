//! Plans, single jobs, and summaries of jobs that were done elsewhere.

use super::{card, counts, refused, results, summary};
use crate::support::Folder;
use serde_json::Value;
use std::fs;

/// Writes the plan for `options` to `plan.jsonl`, and returns its lines.
fn planned(folder: &Folder, options: &str) -> Vec<Value> {
    let run = folder.line(&format!("batch --plan in -d out {options}")).done();
    folder.put("plan.jsonl", run.stdout.as_bytes());
    run.stdout.lines().map(|line| serde_json::from_str(line).expect("JSON")).collect()
}

#[test]
fn jobs_give_the_bytes_of_the_local_run() {
    let folder = Folder::empty();
    card(&folder, 3);
    let options = "--weight gaussian --tmo drago --normalize set --shared-response";
    folder.line(&format!("batch in -d out -q {options}")).done();
    let local = results(&folder);
    fs::rename(folder.at("out"), folder.at("local")).unwrap();

    let lines = planned(&folder, options);
    assert!(!folder.at("out").exists(), "planning does nothing");
    let merges: Vec<&Value> = lines.iter().filter(|line| line["kind"] == "merge").collect();
    assert_eq!((lines.len(), merges.len()), (4, 3));
    assert_eq!(lines[0]["kind"], "response");
    assert_eq!(merges[0]["needs"][0], lines[0]["id"]);
    assert_eq!(merges[0]["options"], serde_json::json!(["--weight=gaussian", "--tmo=drago", "--normalize=set"]));
    assert!(lines.iter().all(|l| l["memory_mb"].as_f64().unwrap() > 25.0 && l["time_s"].as_f64().unwrap() > 0.1));

    // The job that recovers the response, which the merges need, has not been run.
    let first = merges[0]["id"].as_str().unwrap();
    assert!(refused(folder.line(&format!("batch --run plan.jsonl --id {first}"))).contains("response-hdralign"));
    assert_eq!(folder.line("batch --summarize plan.jsonl").code, 1, "none is done");
    for (i, line) in lines.iter().enumerate() {
        let id = line["id"].as_str().unwrap();
        folder.line(&format!("batch --run plan.jsonl --id {id}")).done();
        let again = folder.line(&format!("batch --run plan.jsonl --id {id}")).done();
        assert!(again.stderr.contains("already done"), "{}", again.stderr);
        let code = folder.line("batch --summarize plan.jsonl -q").code;
        assert_eq!(code, if i + 1 < lines.len() { 3 } else { 0 });
    }
    assert!(results(&folder) == local);
    assert_eq!(counts(&folder), [4, 0, 0, 0]);
    assert!(summary(&folder)["time_s"].is_null());
    // A local run recognises the results of the jobs.
    folder.line(&format!("batch in -d out -q {options}")).done();
    assert_eq!(counts(&folder), [0, 4, 0, 0]);
}

#[test]
fn failed_job_is_printed_and_in_the_summary() {
    let folder = Folder::empty();
    let paths = card(&folder, 2);
    let lines = planned(&folder, "");
    let whole = fs::read(&paths[1][2]).unwrap();
    fs::write(&paths[1][2], &whole[..whole.len() / 2]).unwrap();
    let ids: Vec<&str> = lines.iter().map(|line| line["id"].as_str().unwrap()).collect();
    folder.line(&format!("batch --run plan.jsonl --id {}", ids[0])).done();
    let run = folder.line(&format!("batch --run plan.jsonl --id {}", ids[1]));
    assert_eq!(run.code, 1);
    assert!(run.stderr.contains("IMG_0006.JPG") && run.stdout.is_empty(), "{run:?}");
    assert_eq!(folder.line("batch --summarize plan.jsonl").code, 3);
    assert_eq!(counts(&folder), [1, 0, 1, 0]);
    assert!(summary(&folder)["steps"][1]["error"].as_str().unwrap().contains("truncated"));
    // One command runs several jobs.
    let both = format!("batch --run plan.jsonl --id {} --id {}", ids[0], ids[1]);
    assert_eq!(folder.line(&both).code, 3);
    fs::write(&paths[1][2], whole).unwrap();
    folder.line(&both).done();
    folder.line("batch --summarize plan.jsonl").done();
}

/// A workflow engine may start a job again while it is still running.
#[test]
fn a_job_may_be_run_twice_at_the_same_time() {
    let folder = Folder::empty();
    card(&folder, 1);
    let id = planned(&folder, "--page")[0]["id"].as_str().unwrap().to_owned();
    for _ in 0..5 {
        let _ = fs::remove_dir_all(folder.at("out"));
        let begin = || {
            let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_hdralign"));
            command.args(["batch", "--run", "plan.jsonl", "--id", &id, "-q"]).current_dir(folder.path());
            command.stdout(std::process::Stdio::null()).spawn().expect("the program starts")
        };
        let twins = [begin(), begin(), begin()];
        assert!(twins.into_iter().all(|mut twin| twin.wait().unwrap().success()));
        assert_eq!(results(&folder).len(), 3);
        folder.line("batch --summarize plan.jsonl -q").done();
    }
}

#[test]
fn invalid_plan_is_rejected_with_its_line() {
    let folder = Folder::empty();
    card(&folder, 1);
    let line = &planned(&folder, "")[0];
    let id = line["id"].as_str().unwrap();
    let run = |options: &str| refused(folder.line(&format!("batch --run plan.jsonl {options}")));
    assert!(run("--id nothing").contains("no job with id \"nothing\""));
    assert!(run("").contains("--id"));
    assert!(run(&format!("--id {id} --tmo drago")).contains("give it when the plan is made (--plan)"));
    folder.put("plan.jsonl", line.to_string().replace("hdralign 0", "hdralign 99").as_bytes());
    assert!(run(&format!("--id {id}")).contains("create the plan again"));
    folder.put("plan.jsonl", b"\n{\"schema\": 1}\n");
    assert!(run(&format!("--id {id}")).contains("line 2"));
    folder.put("plan.jsonl", b"");
    assert!(refused(folder.line("batch --summarize plan.jsonl")).contains("no jobs"));
    let odd = line.to_string().replace("\"options\":[]", "\"options\":[\"--bogus=1\"]");
    folder.put("plan.jsonl", odd.as_bytes());
    assert!(run(&format!("--id {id}")).contains("--bogus"));
}
