//! Errors of the arguments: with likely suggestions only, and the usage of the command.
//!
//! In: the error of clap. Out: the error without misleading parts: clap suggests `--response` for `--resize`, and shows
//! the usage of the option that it suggests. Cost: none.

use clap::Command;
use clap::error::{ContextKind, ContextValue, Error};

/// Returns `error` with the usage of `command` in `program`, and with likely suggestions only.
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
    // Removes the suggestion to pass an unknown option as a file. An empty list of suggestions would print an empty
    // line.
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

/// Returns the unknown argument of `error`; empty if there is none.
fn typed_argument(error: &Error) -> &str {
    match error.get(ContextKind::InvalidArg) {
        Some(ContextValue::String(typed)) => typed,
        _ => "",
    }
}

/// Whether `typed` may be a typing error of `name`: at most one error in three letters, as in rustc
/// (`rustc_span::edit_distance`).
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
