//! Improves the messages for errors in the arguments: only likely suggestions, and the usage of the right command.
//!
//! In: the error of clap. Out: the error without misleading parts. clap suggests an option even if its name is
//! only somewhat similar, such as `--response` for `--resize`, and shows the usage of the suggested option. Cost: none.

use clap::Command;
use clap::error::{ContextKind, ContextValue, Error};

/// Returns `error` with only likely suggestions. If it shows a usage, this is the usage of `command` in `program`, or
/// of `program` itself if `command` is not the name of a command.
pub fn clear(mut error: Error, program: &mut Command, command: Option<&str>) -> Error {
    for (typed, tip) in [
        (ContextKind::InvalidArg, ContextKind::SuggestedArg),
        (ContextKind::InvalidSubcommand, ContextKind::SuggestedSubcommand),
        (ContextKind::InvalidValue, ContextKind::SuggestedValue),
    ] {
        let Some(ContextValue::String(typed)) = error.get(typed) else { continue };
        let typed = typed.clone();
        let likely = match error.remove(tip) {
            Some(ContextValue::String(name)) if is_likely(&typed, &name) => ContextValue::String(name),
            Some(ContextValue::Strings(names)) => {
                ContextValue::Strings(names.into_iter().filter(|name| is_likely(&typed, name)).collect())
            }
            _ => continue,
        };
        if likely != ContextValue::Strings(Vec::new()) {
            error.insert(tip, likely);
        }
    }
    // clap suggests to pass an unknown option as a file (`-- OPTION`). This suggestion is removed. If no suggestion
    // is left, the list is removed too, because an empty list would print an empty line.
    if let Some(ContextValue::StyledStrs(mut tips)) = error.remove(ContextKind::Suggested) {
        tips.retain(|tip| !tip.to_string().ends_with(&format!("-- {}'", typed_argument(&error))));
        if !tips.is_empty() {
            error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
        }
    }
    if error.get(ContextKind::Usage).is_some() {
        program.build();
        let mut command = command.and_then(|name| program.find_subcommand(name)).unwrap_or(program).clone();
        error.insert(ContextKind::Usage, ContextValue::StyledStr(command.render_usage()));
    }
    error
}

/// Returns the unknown argument that `error` is about; empty if there is none.
fn typed_argument(error: &Error) -> &str {
    match error.get(ContextKind::InvalidArg) {
        Some(ContextValue::String(typed)) => typed,
        _ => "",
    }
}

/// Returns whether `typed` is probably `name` with typing errors: at most one error per three letters. rustc uses the
/// same rule (`rustc_span::edit_distance`).
fn is_likely(typed: &str, name: &str) -> bool {
    let (typed, name) = (typed.trim_start_matches('-'), name.trim_start_matches('-'));
    strsim::osa_distance(typed, name) <= typed.chars().count().max(3) / 3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tips_suggest_similar_names() {
        for (typed, name) in [("--aling", "--align"), ("--refrence", "--reference"), ("drgo", "drago")] {
            assert!(is_likely(typed, name), "{typed} {name}");
        }
        for (typed, name) in [("--resize", "--response"), ("--output-dir", "--output"), ("heavy", "hat")] {
            assert!(!is_likely(typed, name), "{typed} {name}");
        }
    }
}
