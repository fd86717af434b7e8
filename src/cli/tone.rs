//! Arguments of the commands that tone-map.

use clap::{Args, FromArgMatches, ValueEnum};
use hdralign::error::Error;
use hdralign::tonemap::{Operator, Rendering};

/// How luminance is brought into the range of a display.
#[derive(Debug, Args)]
pub struct Tone {
    /// How luminance is brought into the range of a display
    #[arg(long, value_enum, default_value_t, value_name = "NAME")]
    tmo: OperatorArg,

    /// Set something of the tone mapping, as `brightness=0.5`; may be repeated. `--tmo-set help` lists what there is
    #[arg(long, value_name = "KEY=VALUE", value_delimiter = ',')]
    tmo_set: Vec<String>,
}

/// See [`Operator`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
pub enum OperatorArg {
    /// Edges held back without halos, contrasts distorted least, the brightness of a photograph
    #[default]
    Natural,
    /// Global: Reinhard et al. 2002, the photographic curve
    Reinhard02,
    /// Local: Reinhard et al. 2002, dodging and burning
    Reinhard02Local,
    /// Global: Drago et al. 2003, adaptive logarithms
    Drago,
    /// Frequency: Durand & Dorsey 2002, a bilateral base compressed, its detail kept
    Durand,
    /// Gradient: Fattal et al. 2002, steep gradients attenuated at every scale
    Fattal,
    /// Gradient: Mantiuk et al. 2006, contrasts mapped at every scale as the eye sees them
    Mantiuk06,
    /// Display-adaptive: Mantiuk et al. 2008, the curve by which a display shows most of the contrasts seen
    Mantiuk08,
    /// Fusion of the aligned frames, without radiance, and so not in `tonemap`: Mertens et al. 2007
    Mertens,
}

impl OperatorArg {
    /// The rendering with its options as by default.
    fn rendering(self) -> Rendering {
        Rendering::Toned(match self {
            OperatorArg::Mertens => return Rendering::Fused(Default::default()),
            OperatorArg::Natural => Operator::Natural(Default::default()),
            OperatorArg::Reinhard02 => Operator::Reinhard02(Default::default()),
            OperatorArg::Reinhard02Local => Operator::Reinhard02Local(Default::default()),
            OperatorArg::Drago => Operator::Drago(Default::default()),
            OperatorArg::Durand => Operator::Durand(Default::default()),
            OperatorArg::Fattal => Operator::Fattal(Default::default()),
            OperatorArg::Mantiuk06 => Operator::Mantiuk06(Default::default()),
            OperatorArg::Mantiuk08 => Operator::Mantiuk08(Default::default()),
        })
    }
}

impl Tone {
    /// The operator with what was set of it, for radiance alone.
    pub fn operator(&self) -> Result<Operator, Error> {
        match self.rendering()? {
            Rendering::Toned(operator) => Ok(operator),
            Rendering::Fused(_) => {
                let reason =
                    "`mertens` fuses photographs, not radiance; give the bracket to `hdralign merge --tmo mertens`";
                Err(Error::Option { option: "--tmo", reason: reason.into() })
            }
        }
    }

    /// The rendering with what was set of it.
    pub fn rendering(&self) -> Result<Rendering, Error> {
        let mut rendering = self.tmo.rendering();
        for text in &self.tmo_set {
            let refused = |reason: String| Error::Option { option: "--tmo-set", reason };
            let (key, value) = text
                .split_once('=')
                .ok_or_else(|| refused(format!("{text:?} is not KEY=VALUE, as in `brightness=0.5`")))?;
            let number = value.trim().parse().map_err(|_| refused(format!("{value:?} in {text:?} is no number")))?;
            rendering.set(key.trim(), number)?;
        }
        Ok(rendering)
    }
}

/// The settings of the tone mapping that the command line names, where it asks for them by `--tmo-set help`. Nothing else need be given.
pub fn settings_asked(command: clap::Command) -> Option<String> {
    let matches = command.ignore_errors(true).try_get_matches().ok()?;
    let (_, own) = matches.subcommand()?;
    // An error where the command has no tone mapping.
    own.try_contains_id("tmo_set").ok()?;
    let tone = Tone::from_arg_matches(own).ok()?;
    tone.tmo_set.iter().any(|text| text == "help").then(|| listed(&mut tone.tmo.rendering()))
}

/// What there is to be set of `rendering`.
fn listed(rendering: &mut Rendering) -> String {
    let mut text = format!("--tmo {}: --tmo-set KEY=VALUE\n", rendering.name());
    for setting in rendering.settings() {
        let (least, most) = setting.range;
        let assigned = format!("{}={}", setting.key, setting.value());
        text += &format!("  {assigned:<24} {least} to {most}: {}\n", setting.about);
    }
    text
}
