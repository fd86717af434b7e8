//! The record of a job. A later run uses it to recognise complete results and files that the job itself wrote.
//!
//! In: a job, its options, and its files. Out: a key, which is a hash of the contents of the inputs, the options and
//! the version (dates do not matter); and a record of the files that were written. The record is stored in the job's
//! report under the JSON key `step`. Cost: every input and output is read once, for SHA-256.
//!
//! The report gets its final name before the results do. If the process is killed in between, some results in the
//! record are missing, or are still those of the previous run. [`Record::is_whole`] detects this. The record also
//! lists the previous files as [replaced](Record::replaced), so that the next run may replace them. Files that are in
//! no record belong to the user. They are replaced only with `--force`.

use super::plan::Job;
use crate::error::{Error, Result};
use crate::intake;
use crate::pipeline::Options;
use crate::write::Format;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Number of bytes that are read and hashed at a time.
const AT_ONCE: usize = 1 << 18;

/// The name, length and hash of a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Content {
    /// The name of the file, without the folder. Parts that are not valid UTF-8 become the replacement character
    /// U+FFFD.
    pub name: String,
    /// The length in bytes.
    pub bytes: u64,
    /// SHA-256 of the bytes, in hexadecimal digits.
    pub sha256: String,
}

impl Content {
    /// Reads the file `path`, and returns its name, length and hash.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn of(path: &Path) -> Result<Content> {
        let failed = |source| Error::Read { path: path.to_owned(), source };
        Content::read(path, intake::open_regular(path)?).map_err(failed)
    }

    /// Reads `file`, and returns its length and hash with the name of `path`. The file may get this name later.
    ///
    /// # Errors
    /// Errors of reading `file`.
    pub fn read(path: &Path, mut file: impl Read) -> io::Result<Content> {
        let mut hash = Sha256::new();
        let mut buffer = vec![0; AT_ONCE];
        let mut bytes = 0;
        loop {
            match file.read(&mut buffer) {
                Ok(0) => return Ok(Content { name: name(path), bytes, sha256: hex(hash) }),
                Ok(n) => {
                    hash.update(&buffer[..n]);
                    bytes += n as u64;
                }
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
    }
}

fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn hex(hash: Sha256) -> String {
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The inputs, options and results of a job that was run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record {
    /// [`Job::id`].
    pub id: String,
    /// SHA-256 of the contents of all inputs, the options and the version. Jobs with equal keys write equal bytes.
    pub key: String,
    /// The program and its version.
    pub software: String,
    /// [`Job::options`].
    pub options: Vec<String>,
    /// The photographs in order.
    pub inputs: Vec<Content>,
    /// The results.
    pub outputs: Vec<Content>,
    /// SHA-256 of each previous result file that the new results replace.
    pub replaced: Vec<String>,
}

/// The part of the report that contains the record.
#[derive(Deserialize)]
struct Report {
    #[serde(rename = "step")]
    job: Record,
}

impl Record {
    /// Reads the record from the report in the file `path`. Returns `None` if the file does not exist or has no
    /// record.
    pub fn read(path: &Path) -> Option<Record> {
        let text = intake::whole(path, intake::MOST_OF_A_TEXT).ok()?;
        Some(serde_json::from_slice::<Report>(&text).ok()?.job)
    }

    /// Returns whether all files `outputs` are results of this run. If this run replaced no earlier results, a file
    /// with the length in this record is one; its content need not be checked, because only complete files get their
    /// final names. Otherwise the contents are compared by hash: the file may still be that of the earlier run. A file
    /// that neither this run nor an earlier one wrote is accepted: the user changed it, and it belongs to the user.
    pub fn is_whole(&self, outputs: &[PathBuf]) -> bool {
        let is_current = |path: &Path, content: &Content| {
            let found = Content::of(path);
            found.is_ok_and(|found| found.sha256 == content.sha256 || !self.wrote(&found.sha256))
        };
        let is_there = |path: &PathBuf| {
            let Some(content) = self.outputs.iter().find(|content| content.name == name(path)) else { return false };
            let there = fs::metadata(path).ok().filter(fs::Metadata::is_file);
            there.is_some_and(|there| {
                there.len() == content.bytes && self.replaced.is_empty() || is_current(path, content)
            })
        };
        outputs.iter().all(is_there)
    }

    /// Returns whether the recorded photographs include at least one of `inputs`. They are compared by hash, because
    /// different photographs may have the same name.
    pub fn is_of(&self, inputs: &[Content]) -> bool {
        self.inputs.iter().any(|known| inputs.iter().any(|content| content.sha256 == known.sha256))
    }

    /// Returns whether the recorded run or an earlier run wrote the file `path`, compared by hash.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn made(&self, path: &Path) -> Result<bool> {
        Ok(self.wrote(&Content::of(path)?.sha256))
    }

    fn wrote(&self, sha256: &str) -> bool {
        self.outputs.iter().any(|content| content.sha256 == sha256) || self.replaced.iter().any(|known| known == sha256)
    }
}

/// Returns the [`Record::key`] of `job`, for photographs with the contents `inputs` and for `options`.
///
/// # Errors
/// [`Error::Read`] if the response file cannot be read.
pub fn key(job: &Job, inputs: &[Content], options: &Options) -> Result<String> {
    let mut hash = Sha256::new();
    let mut take = |text: &str| {
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text);
    };
    take(super::SOFTWARE);
    // The debug format of all options is hashed, so that a new option cannot be forgotten here. Options that do not
    // affect the results are reset before: paths, memory, threads and limits. The response file is hashed by its
    // content below.
    let mut acting =
        Options { threads: None, response_file: None, report: None, outputs: Vec::new(), ..options.clone() };
    acting.pictures = Vec::new();
    acting.load.memory = None;
    acting.load.max_pixels = 0;
    acting.write.overwrite = false;
    take(&format!("{:?} {acting:?}", job.kind));
    for output in &job.outputs {
        let is_picture = job.pictures.contains(output);
        let format = if is_picture { Format::of_picture(output) } else { Format::of(output) };
        take(&format.map_or_else(|_| name(output), |format| format!("{format:?}")));
    }
    take(if job.page.is_some() { "page" } else { "" });
    match &options.response_file {
        Some(path) => take(&Content::of(path)?.sha256),
        None => take(""),
    }
    take(&format!("{:?}", job.brackets));
    inputs.iter().for_each(|content| take(&content.sha256));
    Ok(hex(hash))
}

#[cfg(test)]
mod tests {
    use super::super::plan::tests::job;
    use super::*;

    #[test]
    fn the_digest_is_sha_256() {
        let content = Content::read(Path::new("d/abc.txt"), &b"abc"[..]).unwrap();
        // This is the first example in FIPS 180-2, appendix B.
        assert_eq!(content.sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
        assert_eq!((content.name.as_str(), content.bytes), ("abc.txt", 3));
    }

    #[test]
    fn the_key_is_of_contents_options_and_order_alone() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::write(at("a"), "A").unwrap();
        std::fs::write(at("b"), "B").unwrap();
        std::fs::write(at("c"), "A").unwrap();
        let contents = |names: [&str; 2]| names.map(|n| Content::of(&at(n)).unwrap());
        let plain = Options::default();
        let of = |names, options: &Options| key(&job(), &contents(names), options).unwrap();
        let first = of(["a", "b"], &plain);
        assert_eq!(first, of(["c", "b"], &plain), "names have no influence");
        assert_ne!(first, of(["b", "a"], &plain));
        let flare = Options { flare: true, ..Options::default() };
        assert_ne!(first, of(["a", "b"], &flare));
        let elsewhere = Options { threads: Some(3), outputs: vec!["x.exr".into()], ..Options::default() };
        assert_eq!(first, of(["a", "b"], &elsewhere));
        let mut other = job();
        other.outputs.pop();
        assert_ne!(first, key(&other, &contents(["a", "b"]), &plain).unwrap());
        let with_response = |name| Options { response_file: Some(at(name)), ..Options::default() };
        assert_ne!(of(["a", "b"], &with_response("a")), of(["a", "b"], &with_response("b")));
        assert_eq!(of(["a", "b"], &with_response("a")), of(["a", "b"], &with_response("c")));
    }

    #[test]
    fn own_results_are_recognised_by_hash() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for (name, text) in [("a.exr", "A"), ("old.exr", "o"), ("mine.exr", "m")] {
            std::fs::write(at(name), text).unwrap();
        }
        let outputs = vec![Content::of(&at("a.exr")).unwrap()];
        let replaced = vec![Content::of(&at("old.exr")).unwrap().sha256];
        let record = Record {
            id: "x".into(),
            key: String::new(),
            software: String::new(),
            options: Vec::new(),
            inputs: vec![Content::of(&at("a.exr")).unwrap()],
            outputs,
            replaced,
        };
        assert!(record.made(&at("a.exr")).unwrap() && record.made(&at("old.exr")).unwrap());
        assert!(!record.made(&at("mine.exr")).unwrap());
        assert!(record.is_whole(&[at("a.exr")]));
        assert!(!record.is_whole(&[at("a.exr"), at("mine.exr")]), "not in the record");
        assert!(record.is_of(&[Content::of(&at("a.exr")).unwrap(), Content::of(&at("old.exr")).unwrap()]));
        assert!(!record.is_of(&[Content::of(&at("old.exr")).unwrap()]));
        std::fs::write(at("a.exr"), "retouched").unwrap();
        assert!(record.is_whole(&[at("a.exr")]), "it is the user's now");
        std::fs::write(at("a.exr"), "o").unwrap();
        assert!(!record.is_whole(&[at("a.exr")]), "an earlier run's, of the same length");
        std::fs::remove_file(at("a.exr")).unwrap();
        assert!(!record.is_whole(&[at("a.exr")]));
        std::fs::write(at("a.exr"), "A").unwrap();
        std::fs::write(at("r.json"), "{\"step\": 3}").unwrap();
        assert_eq!(Record::read(&at("r.json")), None);
        std::fs::write(at("r.json"), serde_json::json!({ "step": record }).to_string()).unwrap();
        assert_eq!(Record::read(&at("r.json")), Some(record));
        assert_eq!(Record::read(&at("none.json")), None);
    }
}
