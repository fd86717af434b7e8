//! Arguments of the commands that tone-map.

use clap::{Args, ValueEnum};
use hdralign::error::Error;
use hdralign::tonemap::Operator;

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
}

impl OperatorArg {
    /// The operator with its options as by default.
    fn operator(self) -> Operator {
        match self {
            OperatorArg::Natural => Operator::Natural(Default::default()),
            OperatorArg::Reinhard02 => Operator::Reinhard02(Default::default()),
            OperatorArg::Reinhard02Local => Operator::Reinhard02Local(Default::default()),
            OperatorArg::Drago => Operator::Drago(Default::default()),
            OperatorArg::Durand => Operator::Durand(Default::default()),
        }
    }
}

impl Tone {
    /// The operator with what was set of it.
    pub fn operator(&self) -> Result<Operator, Error> {
        let mut operator = self.tmo.operator();
        for text in &self.tmo_set {
            let refused = |reason: String| Error::Option { option: "--tmo-set", reason };
            if text == "help" {
                return Err(refused(listed(&mut operator)));
            }
            let typed = || refused(format!("{text:?} is not KEY=VALUE, as in `brightness=0.5`"));
            let (key, value) = text.split_once('=').ok_or_else(typed)?;
            operator.set(key.trim(), value.trim().parse().map_err(|_| typed())?)?;
        }
        Ok(operator)
    }
}

/// What there is to be set of `operator`.
fn listed(operator: &mut Operator) -> String {
    let mut text = format!("of `{}` may be set", operator.name());
    for setting in operator.settings() {
        let (least, most) = setting.range;
        text += &format!("\n  {}={}: {}, {least} to {most}", setting.key, setting.value(), setting.about);
    }
    text
}
