//! Formats the result of the search for brackets as text and as JSON.

use hdralign::batch::find::{Found, FoundBracket, LeftOver, Reason, Shot};
use hdralign::batch::plan::{Job, Kind, Planned};
use hdralign::batch::summary::Unused;
use hdralign::error::Error;
use serde::Serialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The version of the format of `--dry-run --json`: keys may be added, but are never removed.
const SCHEMA: &str = "hdralign-found/1";
/// Largest number of unused files and folders that are listed for each reason; `--json` lists all.
const LISTED: usize = 20;
/// If a bracket has at most this number of frames, the exposure of each frame is listed; otherwise only their range.
const EXPOSURES: usize = 9;

/// Returns the brackets in the form that a plan is made from.
pub fn planned(found: &Found) -> Vec<Planned> {
    found.brackets.iter().map(Planned::from).collect()
}

/// Returns the photographs in no bracket and the folders that cannot be read, each with the reason.
pub fn unused(found: &Found) -> Vec<Unused> {
    let unused = |l: &LeftOver| Unused { path: l.path.to_string_lossy().into_owned(), reason: l.reason.to_string() };
    found.left_over.iter().map(unused).collect()
}

/// Returns a line with the numbers of brackets, photographs, jobs, entries in no bracket, and other files.
pub fn counted(found: &Found, jobs: usize) -> String {
    let brackets = found.brackets.len();
    let photographs: usize = found.brackets.iter().map(|b| b.photographs.len()).sum();
    let mut words = vec![format!("{} of {}", many(brackets, "bracket"), many(photographs, "photograph"))];
    if jobs != brackets {
        words.push(many(jobs, "job"));
    }
    if !found.left_over.is_empty() {
        let all: Vec<&LeftOver> = found.left_over.iter().collect();
        words.push(format!("{} in no bracket", entries(&all)));
    }
    if found.other_files > 0 {
        words.push(format!("{} of other kinds", many(found.other_files, "file")));
    }
    words.join(", ")
}

/// Returns `n` and `what`, in the plural unless `n` is 1.
pub fn many(n: usize, what: &str) -> String {
    if n == 1 { format!("1 {what}") } else { format!("{n} {what}s") }
}

/// Returns the number of entries in `all`, with a noun that fits all of them. If an entry cannot be read, the noun is
/// "file or folder", because the entry may be either. A result of hdralign is a file, but not a photograph.
pub fn entries(all: &[&LeftOver]) -> String {
    let has = |is: fn(&Reason) -> bool| all.iter().any(|entry| is(&entry.reason));
    let n = all.len();
    if has(|reason| matches!(reason, Reason::Unreadable(_))) {
        if n == 1 { "1 file or folder".to_owned() } else { format!("{n} files or folders") }
    } else if has(|reason| matches!(reason, Reason::Result(_))) {
        many(n, "file")
    } else {
        many(n, "photograph")
    }
}

/// Returns the error for a search that found no bracket. It contains an example of the most frequent kind of
/// reason.
pub fn nothing(folders: &[PathBuf], found: &Found) -> Error {
    let all: Vec<&LeftOver> = found.left_over.iter().collect();
    let most = by_kind(found).into_iter().max_by_key(Vec::len);
    let why = match most {
        Some(shots) => {
            format!("{} in no bracket, for example {}: {}", entries(&all), shots[0].path.display(), shots[0].reason)
        }
        None => "there are no photographs (JPEG, PNG, TIFF)".to_owned(),
    };
    Error::NoBracket { path: folders.first().cloned().unwrap_or_default(), reason: why }
}

/// Returns the table that `--dry-run` prints.
pub fn table(found: &Found, jobs: &[Job]) -> String {
    let names: Vec<&Job> = jobs.iter().filter(|job| job.kind == Kind::Merge).collect();
    let mut rows =
        vec![["result", "set", "photographs", "first", "EV", "start", "duration", "camera"].map(str::to_owned)];
    for (bracket, job) in found.brackets.iter().zip(&names) {
        let shots = &bracket.photographs;
        rows.push([
            one_line(&result(job)),
            job.set.map(|set| set.to_string()).unwrap_or_default(),
            shots.len().to_string(),
            one_line(&shots.first().map(file_name).unwrap_or_default()),
            exposures(bracket),
            start(bracket).unwrap_or_else(|| "unknown".into()),
            lasts_s(bracket).map_or_else(|| "unknown".into(), |s| format!("{s:.1} s")),
            shots.first().and_then(|shot| shot.header.camera.clone()).unwrap_or_else(|| "unknown".into()),
        ]);
    }
    let mut text = String::new();
    if rows.len() > 1 {
        let widths: Vec<usize> =
            (0..rows[0].len()).map(|c| rows.iter().map(|row| row[c].chars().count()).max().unwrap_or(0)).collect();
        for row in &rows {
            let cells: Vec<String> = row.iter().zip(&widths).map(|(cell, width)| format!("{cell:<width$}")).collect();
            text += cells.join("  ").trim_end();
            text.push('\n');
        }
        text.push('\n');
    }
    for shots in by_kind(found) {
        let reasons: BTreeSet<String> = shots.iter().map(|shot| shot.reason.to_string()).collect();
        let common = reasons.first().filter(|_| reasons.len() == 1);
        let heading = common.map(|reason| format!(": {reason}")).unwrap_or_default();
        text += &format!("in no bracket, {}{heading}\n", entries(&shots));
        for shot in shots.iter().take(LISTED) {
            let own = if common.is_some() { String::new() } else { format!(": {}", shot.reason) };
            text += &format!("  {}{own}\n", one_line(&shot.path.display().to_string()));
        }
        if shots.len() > LISTED {
            text += &format!("  and {} more; --json names them\n", shots.len() - LISTED);
        }
    }
    text + &counted(found, found.brackets.len()) + "\n"
}

/// Returns the path of the results of `job`, without extension and relative to the folder of the summary.
fn result(job: &Job) -> String {
    let home = job.summary.parent().unwrap_or(Path::new(""));
    let report = job.report.strip_prefix(home).unwrap_or(&job.report);
    report.with_extension("").to_string_lossy().into_owned()
}

/// Returns `name` with control characters escaped, so that it stays on one row of a table.
fn one_line(name: &str) -> String {
    let plain = |c: char| if c.is_control() { c.escape_default().to_string() } else { c.to_string() };
    name.chars().map(plain).collect()
}

/// Returns the photographs in no bracket and the folders that cannot be read, without results that hdralign wrote.
pub fn left_over(found: &Found) -> Vec<&LeftOver> {
    found.left_over.iter().filter(|left_over| !matches!(left_over.reason, Reason::Result(_))).collect()
}

/// Returns the photographs and folders that cannot be read.
pub fn unreadable(found: &Found) -> Vec<&LeftOver> {
    found.left_over.iter().filter(|left_over| matches!(left_over.reason, Reason::Unreadable(_))).collect()
}

/// Returns the photographs in no bracket and the folders that cannot be read, grouped by the kind of reason. The groups
/// are in the order of their first entries.
fn by_kind(found: &Found) -> Vec<Vec<&LeftOver>> {
    let mut groups: Vec<Vec<&LeftOver>> = Vec::new();
    for left_over in &found.left_over {
        let kind = std::mem::discriminant(&left_over.reason);
        match groups.iter_mut().find(|group| std::mem::discriminant(&group[0].reason) == kind) {
            Some(group) => group.push(left_over),
            None => groups.push(vec![left_over]),
        }
    }
    groups
}

fn file_name(shot: &Shot) -> String {
    shot.path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Returns the exposures of the frames as text, in EV relative to the median exposure. If there are more than
/// [`EXPOSURES`] frames, returns only the range.
fn exposures(bracket: &FoundBracket) -> String {
    let all: Option<Vec<f64>> = evs(bracket).into_iter().collect();
    let Some(all) = all else { return "unknown".into() };
    let middle = {
        let mut sorted = all.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
    };
    let tenth = |ev: f64| {
        let ev = ((ev - middle) * 10.0).round() / 10.0;
        if ev == 0.0 { "0".to_owned() } else { format!("{ev:+}") }
    };
    if all.len() > EXPOSURES {
        let range = all.iter().fold((f64::MAX, f64::MIN), |(least, most), &ev| (least.min(ev), most.max(ev)));
        return format!("{} to {}", tenth(range.0), tenth(range.1));
    }
    all.iter().map(|&ev| tenth(ev)).collect::<Vec<_>>().join(" ")
}

/// Returns the exposure of each photograph in EV; `None` if it is not known.
fn evs(bracket: &FoundBracket) -> Vec<Option<f64>> {
    bracket.exposures().into_iter().map(|exposure| exposure.map(libm::log2)).collect()
}

fn start(bracket: &FoundBracket) -> Option<String> {
    Some(bracket.photographs.first()?.header.taken?.to_string())
}

/// Returns the duration of the bracket in seconds: from the recorded time of the first photograph to that of the
/// last, plus the exposure time of the last photograph if it is known.
fn lasts_s(bracket: &FoundBracket) -> Option<f64> {
    let (first, last) = (bracket.photographs.first()?, bracket.photographs.last()?);
    let time = last.header.exposure.time_s.map_or(0.0, |t| t.0);
    Some(last.header.taken?.since(&first.header.taken?) + time)
}

#[derive(Serialize)]
struct Json {
    schema: &'static str,
    brackets: Vec<BracketJson>,
    left_over: Vec<Unused>,
    other_files: usize,
}

#[derive(Serialize)]
struct BracketJson {
    id: String,
    set: Option<usize>,
    photographs: Vec<String>,
    relative_exposures_ev: Vec<Option<f64>>,
    #[serde(rename = "begun")] // plain-english: allow
    start: Option<String>,
    lasts_s: Option<f64>,
    camera: Option<String>,
    lens: Option<String>,
    width_px: usize,
    height_px: usize,
}

/// Returns everything that was found, as JSON.
pub fn json(found: &Found, jobs: &[Job]) -> String {
    let merges = jobs.iter().filter(|job| job.kind == Kind::Merge);
    let bracket = |(bracket, job): (&FoundBracket, &Job)| {
        let header = bracket.photographs.first().map(|shot| &shot.header);
        BracketJson {
            id: job.id.clone(),
            set: job.set,
            photographs: bracket.photographs.iter().map(|s| s.path.to_string_lossy().into_owned()).collect(),
            relative_exposures_ev: evs(bracket),
            start: start(bracket),
            lasts_s: lasts_s(bracket),
            camera: header.and_then(|h| h.camera.clone()),
            lens: header.and_then(|h| h.lens.clone()),
            width_px: header.map_or(0, |h| h.width),
            height_px: header.map_or(0, |h| h.height),
        }
    };
    let all = Json {
        schema: SCHEMA,
        brackets: found.brackets.iter().zip(merges).map(bracket).collect(),
        left_over: unused(found),
        other_files: found.other_files,
    };
    // The value contains only strings, numbers and lists of them, so the conversion cannot fail.
    serde_json::to_string_pretty(&all).unwrap_or_default() + "\n"
}
