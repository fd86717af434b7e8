//! The warnings, with what to do about them; the same warning for several frames is usually shown once.
//!
//! In: a [`Report`]. Out: HTML. Cost: none.

use crate::draw::markup::{escape, file_name};
use crate::report::{Report, WarningReport};

/// A warning and the frames that it applies to.
struct Advice {
    /// Names of the frames; empty if the warning is about the whole bracket.
    names: Vec<String>,
    what: String,
    /// What to do; may be empty.
    remedy: String,
    degrades: bool,
}

impl Advice {
    fn of(warning: &WarningReport, report: &Report) -> Self {
        let message = without_folders(&warning.message, report);
        let is_frame = |name: &str| report.frames.iter().any(|frame| name == file_name(&frame.path));
        let (names, text) = match message.split_once(": ") {
            Some((names, text)) if names.split(", ").all(is_frame) => {
                (names.split(", ").map(str::to_owned).collect(), text)
            }
            _ => (Vec::new(), message.as_str()),
        };
        let (what, remedy) = text.rsplit_once("; ").unwrap_or((text, ""));
        Advice { names, what: what.to_owned(), remedy: remedy.to_owned(), degrades: warning.degrades }
    }

    /// Returns what to do, with `FILE` in place of the names of the frames.
    fn general(&self) -> String {
        self.names.iter().fold(self.remedy.clone(), |text, name| text.replace(name.as_str(), "FILE"))
    }

    /// If this warning and `other` differ only in their frames and measured values, adds the frames of `other` to this
    /// warning and returns true.
    fn takes(&mut self, other: &Advice) -> bool {
        if self.names.is_empty() || other.names.is_empty() || self.general() != other.general() {
            return false;
        }
        // Only the text before a colon or parenthesis must be equal, because measured values follow it.
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

/// Returns the byte length of the common prefix of `a` and `b`.
fn common(a: &str, b: &str) -> usize {
    a.char_indices().zip(b.chars()).find(|((_, a), b)| a != b).map_or(a.len().min(b.len()), |((at, _), _)| at)
}

/// Returns the list of warnings, with a remedy where the warning has one.
pub(in crate::page) fn warnings(report: &Report) -> String {
    if report.warnings.is_empty() {
        return "<p class=\"calm\"><b>No warnings.</b> No problems were found with the frames or their exposures.</p>\n"
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

/// Returns `text` with the folders of frame names removed.
fn without_folders(text: &str, report: &Report) -> String {
    report.frames.iter().fold(text.to_owned(), |text, frame| text.replace(&frame.path, &file_name(&frame.path)))
}

/// Returns escaped `text` with options marked up as code.
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

/// Returns `text` with its first letter in upper case.
fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
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
        assert_eq!(
            (all.what.as_str(), all.names.len(), all.remedy.as_str()),
            ("left out: nothing fits", 3, "give --unmoved FILE")
        );
        let mut low = advice("a.jpg", "aligned with low confidence (0.43)");
        assert!(low.takes(&advice("b.jpg", "aligned with low confidence (0.28)")));
        assert_eq!(low.what, "aligned with low confidence");
    }

    #[test]
    fn options_are_code_and_marks_are_not() {
        assert_eq!(
            with_code("give --unmoved a.jpg, or --crop none."),
            "give <code>--unmoved</code> a.jpg, or <code>--crop</code> none."
        );
        assert_eq!(with_code("give -e to set it; --flare;"), "give <code>-e</code> to set it; <code>--flare</code>;");
        assert_eq!((capital("it is"), capital("")), ("It is".to_owned(), String::new()));
    }
}
