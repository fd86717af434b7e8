//! Arguments of the commands that recover a response.

use crate::cli::arguments::choice::choice;
use crate::cli::heading::MERGE;
use clap::Args;
use hdralign::error::Error;
use hdralign::response::ratios::Exposures;
use hdralign::response::{ResponseModel, mitsunaga_nayar};

/// Response and exposures.
#[derive(Debug, Args)]
#[command(next_help_heading = MERGE)]
pub struct Recovery {
    /// Set how the camera response (the curve from light to pixel values) is recovered
    #[arg(long, hide_short_help = true, value_parser = choice::<ResponseModel>(), default_value_t, value_name = "MODEL")]
    response_model: ResponseModel,

    /// Set the degree of the polynomial of mitsunaga-nayar, 1 to 10; for experts [default: the smallest degree from
    /// 3 to 10 that fits]
    #[arg(long, hide_short_help = true, value_name = "N")]
    response_degree: Option<usize>,

    /// Set whether exposures are corrected to match the pixels (to give exposures, use -e)
    #[arg(long, hide_short_help = true, value_parser = choice::<Exposures>(), default_value_t, value_name = "HOW")]
    pub exposures: Exposures,
}

impl Recovery {
    /// Returns the response model. If it is a polynomial, it has the degree that the user gave.
    pub fn model(&self) -> Result<ResponseModel, Error> {
        match (&self.response_model, self.response_degree) {
            (model, None) => Ok(model.clone()),
            (ResponseModel::MitsunagaNayar(options), degree) => {
                Ok(ResponseModel::MitsunagaNayar(mitsunaga_nayar::Options { degree, ..options.clone() }))
            }
            _ => {
                let reason = "only polynomials have a degree; give --response-model mitsunaga-nayar".to_owned();
                Err(Error::Option { option: "--response-degree", reason })
            }
        }
    }
}
