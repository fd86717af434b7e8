//! Merges a bracket in memory: reads the photographs with the `image` crate, merges them, and prints statistics of the
//! radiance.
//!
//!     cargo run --release --example memory -- testdata/window/*.jpg -- -4 -2 0 2 4
//!
//! The photographs are before `--`, their exposures in EV after it.

use hdralign::bracket::exposure::Exposure;
use hdralign::bracket::{Bracket, Frame, ReferenceChoice};
use hdralign::pipeline::{self, Options, Progress};
use std::error::Error;
use std::ops::ControlFlow;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (names, stops) = arguments.split_at(arguments.iter().position(|a| a == "--").unwrap_or(arguments.len()));
    let stops: Vec<f64> = stops.iter().skip(1).map(|ev| ev.parse()).collect::<Result<_, _>>()?;
    if names.len() < 2 || names.len() != stops.len() {
        return Err("usage: memory PHOTOGRAPH... -- EV...".into());
    }
    let mut frames = Vec::new();
    for (name, ev) in names.iter().zip(stops) {
        let exposure = Exposure::given(ev).ok_or("an exposure is not finite")?;
        frames.push(Frame::from_image(name, image::open(name)?, exposure)?);
    }
    let bracket = Bracket::new(frames, &ReferenceChoice::Auto)?;

    let watch = |progress| {
        if let Progress::Begins(stage) = progress {
            eprintln!("{stage:?}");
        }
        ControlFlow::Continue(())
    };
    let result = pipeline::merge_bracket(bracket, &Options::default(), &watch)?;

    for frame in &result.report.frames {
        println!("{}: {:?}, confidence {:.2}", frame.path, frame.alignment.status, frame.alignment.confidence);
    }
    let radiance = image::Rgb32FImage::from(result.radiance.pixels);
    let mut luminances: Vec<f32> = radiance.pixels().map(|p| 0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2]).collect();
    luminances.sort_by(f32::total_cmp);
    let at = |part: f64| luminances[(part * (luminances.len() - 1) as f64) as usize];
    println!("{} x {} pixels", radiance.width(), radiance.height());
    println!("luminance: 1 % {:.4}, median {:.4}, 99 % {:.4}", at(0.01), at(0.5), at(0.99));
    Ok(())
}
