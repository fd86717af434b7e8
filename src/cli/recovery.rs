//! Arguments of the commands that recover a response.

use clap::{Args, ValueEnum};
use hdralign::error::Error;
use hdralign::response::ratios::Exposures;
use hdralign::response::{ResponseModel, mitsunaga_nayar};

/// How the response is had, and what becomes of the exposures.
#[derive(Debug, Args)]
pub struct Recovery {
    /// How the camera's response is had
    #[arg(long, value_enum, default_value_t, value_name = "MODEL")]
    response_model: ModelArg,

    /// The degree of mitsunaga-nayar's polynomial, 1 to 10 [default: the least that fits]
    #[arg(long, value_name = "N")]
    response_degree: Option<usize>,

    /// What becomes of the exposures
    #[arg(long, value_enum, default_value_t, value_name = "HOW")]
    exposures: ExposuresArg,
}

/// See [`ResponseModel`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum ModelArg {
    /// From the bracket, after Debevec & Malik
    #[default]
    Debevec,
    /// From the bracket, after Robertson, Borman & Stevenson
    Robertson,
    /// From the bracket, as a polynomial, after Mitsunaga & Nayar
    MitsunagaNayar,
    /// Code values are proportional to light
    Linear,
    /// The sRGB curve
    Srgb,
}

/// See [`Exposures`].
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum ExposuresArg {
    /// Fine-tuned from the pixels, within a sixth of a stop; those of -e are not touched
    #[default]
    FineTuned,
    /// As the files say
    AsGiven,
}

impl Recovery {
    /// What becomes of the exposures.
    pub fn exposures(&self) -> Exposures {
        match self.exposures {
            ExposuresArg::FineTuned => Exposures::FineTuned,
            ExposuresArg::AsGiven => Exposures::AsGiven,
        }
    }

    /// The model, of the degree given where it has one.
    pub fn model(&self) -> Result<ResponseModel, Error> {
        let degree = self.response_degree;
        Ok(match self.response_model {
            ModelArg::MitsunagaNayar => {
                ResponseModel::MitsunagaNayar(mitsunaga_nayar::Options { degree, ..Default::default() })
            }
            _ if degree.is_some() => {
                let reason = "only a polynomial has a degree; give `--response-model mitsunaga-nayar` too".to_owned();
                return Err(Error::Option { option: "--response-degree", reason });
            }
            ModelArg::Debevec => ResponseModel::default(),
            ModelArg::Robertson => ResponseModel::Robertson(Default::default()),
            ModelArg::Linear => ResponseModel::Linear,
            ModelArg::Srgb => ResponseModel::Srgb,
        })
    }
}
