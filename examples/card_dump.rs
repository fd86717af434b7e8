//! Fills a folder with photographs as copied from a memory card, to try `hdralign batch`: brackets with EXIF data and
//! different content, made from `testdata/window`.
//!
//!     cargo run --release --example card_dump -- FOLDER --brackets 40 --frames 3 --width 960 --broken 17

#[path = "../tests/support/card.rs"]
mod card;

use card::Card;
use clap::Parser;
use std::path::PathBuf;

/// Fill a folder with photographs as copied from a memory card, to try `hdralign batch`
#[derive(Parser)]
struct Args {
    /// Output folder, created if necessary
    folder: PathBuf,
    /// Number of brackets
    #[arg(long, value_name = "N", default_value_t = 40)]
    brackets: usize,
    /// Number of frames per bracket
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u8).range(2..=9))]
    frames: u8,
    /// Stops between frames
    #[arg(long, value_name = "EV")]
    step: Option<f64>,
    /// Width of the photographs in pixels
    #[arg(long, value_name = "PX", default_value_t = 960, value_parser = clap::value_parser!(u32).range(64..=1200))]
    width: u32,
    /// Truncate the last frame of bracket K, counted from 1; may be repeated
    #[arg(long, value_name = "K")]
    broken: Vec<usize>,
    /// Start a new folder (DCIM/100CARD, DCIM/101CARD, ...) after every N brackets
    #[arg(long, value_name = "N")]
    folders_of: Option<usize>,
}

fn main() {
    let args = Args::parse();
    let frames = usize::from(args.frames);
    // The darkest frame of testdata/window is four stops below the middle one.
    let step = args.step.unwrap_or(2.0_f64.min(4.0 / (frames / 2) as f64));
    let mut card = Card::new(args.width);
    for k in 0..args.brackets {
        if let Some(n) = args.folders_of {
            card.folder = PathBuf::from(format!("DCIM/{}CARD", 100 + k / n.max(1)));
        }
        card.brackets(1, frames, step);
        card.last().is_truncated = args.broken.contains(&(k + 1));
    }
    card.write(&args.folder);
}
