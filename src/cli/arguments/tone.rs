//! Arguments of the commands that tone-map.

use crate::cli::arguments::choice::Choice;
use crate::cli::heading::PICTURE;
use clap::{Args, FromArgMatches};
use hdralign::error::Error;
use hdralign::tonemap::{Operator, Rendering};

/// Tone mapping.
#[derive(Debug, Args)]
#[command(next_help_heading = PICTURE)]
pub struct Tone {
    /// Set the tone mapping operator: the method that makes the picture
    ///
    /// Global operators use one curve for the whole picture, local ones adapt to each area
    #[arg(long, value_parser = renderings(), default_value = Rendering::default().name(), value_name = "NAME")]
    tmo: Rendering,

    /// Set a parameter of the operator, as in `--tmo durand --tmo-set base=3`; may be repeated. `--tmo NAME --tmo-set
    /// help` lists the parameters of NAME
    #[arg(long, hide_short_help = true, value_name = "KEY=VALUE", value_delimiter = ',')]
    tmo_set: Vec<String>,
}

fn renderings() -> Choice<Rendering> {
    let named = |(rendering, about): (Rendering, _)| {
        let name = rendering.name();
        (rendering, name, about)
    };
    Rendering::every().into_iter().map(named).collect()
}

/// Returns a parser of `--tmo` for commands whose input is radiance. `--help` lists only the operators. The parser
/// also accepts exposure fusion, so that [`Tone::operator`] can explain why it is not possible.
pub fn operators() -> Choice<Rendering> {
    renderings().hiding(|rendering| matches!(rendering, Rendering::Fused(_)))
}

impl Tone {
    /// Returns the operator with its parameters, for commands whose input is radiance. Returns an error for exposure
    /// fusion, because it needs frames.
    pub fn operator(&self) -> Result<Operator, Error> {
        match self.rendering()? {
            Rendering::Toned(operator) => Ok(operator),
            Rendering::Fused(_) => {
                let reason = "mertens fuses frames, not radiance; use `hdralign merge --tmo mertens` on the bracket";
                Err(Error::Option { option: "--tmo", reason: reason.into() })
            }
        }
    }

    /// Returns the operator or fusion method with its parameters.
    pub fn rendering(&self) -> Result<Rendering, Error> {
        let mut rendering = self.tmo.clone();
        for text in &self.tmo_set {
            let refused = |reason: String| Error::Option { option: "--tmo-set", reason };
            let (key, value) = text
                .split_once('=')
                .ok_or_else(|| refused(format!("{text:?} does not have the form KEY=VALUE; an example is base=3")))?;
            let number = value.trim().parse().map_err(|_| refused(format!("{value:?} in {text:?} is not a number")))?;
            rendering.set(key.trim(), number)?;
        }
        Ok(rendering)
    }
}

/// If the command line contains `--tmo-set help`, returns the list of the operator's parameters. Required arguments
/// may then be missing.
pub fn settings_asked(command: clap::Command) -> Option<String> {
    let matches = command.ignore_errors(true).try_get_matches().ok()?;
    let (_, own) = matches.subcommand()?;
    // For a command without tone mapping, this is an error, so the function returns `None`.
    own.try_contains_id("tmo_set").ok()?;
    let mut tone = Tone::from_arg_matches(own).ok()?;
    tone.tmo_set.iter().any(|text| text == "help").then(|| listed(&mut tone.tmo))
}

/// Returns the parameters of `rendering` with their ranges and defaults, one per line.
fn listed(rendering: &mut Rendering) -> String {
    let mut text = format!("--tmo {}: --tmo-set KEY=VALUE\n", rendering.name());
    for setting in rendering.settings() {
        let (least, most) = setting.range;
        let assigned = format!("{}={}", setting.key, setting.value());
        text += &format!("  {assigned:<24} {least} to {most}: {}\n", setting.about);
    }
    text
}
