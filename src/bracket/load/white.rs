//! The white of a raw bracket.
//!
//! In: a bracket of raw frames, each divided by the white that the camera chose for it. Out: the same with the white of
//! the reference. Cost: a look-up for each sample of a frame with another white.
//!
//! A camera with automatic white balance may choose another white for each frame. This changes how a raw developer
//! shows the frame, but not what was measured.

use crate::bracket::colour::{linear_to_srgb, srgb_to_linear};
use crate::bracket::window::{Codes, Store};
use crate::bracket::{Bracket, Samples};
use crate::error::Result;
use crate::scratch::Scratch;
use rayon::prelude::*;
use std::sync::Arc;

/// Gives all frames from the camera of the reference the white of the reference.
///
/// # Errors
/// [`Error::Scratch`](crate::error::Error::Scratch) if frames are on disk and cannot be read or written.
pub(super) fn as_in_reference(bracket: &mut Bracket) -> Result<()> {
    let scratch = bracket.scratch().cloned();
    let reference = bracket.reference();
    let Some(raw) = reference.raw.clone() else { return Ok(()) };
    let (model, profile) = (reference.capture.model.clone(), reference.profile.clone());
    for frame in &mut bracket.frames {
        let Some(own) = frame.raw.as_mut().filter(|own| own.white != raw.white) else { continue };
        if frame.capture.model != model {
            continue;
        }
        let factors = [0, 1, 2].map(|c| f64::from(own.white[c]) / f64::from(raw.white[c]));
        own.white = raw.white;
        frame.profile.clone_from(&profile);
        let size = (frame.width, frame.height);
        multiply(&mut frame.store, size, factors, scratch.as_ref())?;
    }
    Ok(())
}

/// Multiplies the linear values of each channel. Clipped samples stay clipped.
fn multiply(store: &mut Store, size: (usize, usize), factors: [f64; 3], scratch: Option<&Arc<Scratch>>) -> Result<()> {
    let tables = factors.map(table);
    let change = |codes: &mut [u16]| {
        codes.par_chunks_mut(3 * size.0).for_each(|row| {
            for pixel in row.as_chunks_mut::<3>().0 {
                *pixel = [0, 1, 2].map(|c| tables[c][usize::from(pixel[c])]);
            }
        });
    };
    if let Store::Held(Samples::Sixteen(codes)) = store {
        change(codes);
        return Ok(());
    }
    let window = store.window(size, 0..size.1)?;
    let Codes::Sixteen(codes) = window.codes() else { return Ok(()) };
    let mut codes = codes.to_vec();
    drop(window);
    change(&mut codes);
    *store = Store::Held(Samples::Sixteen(codes));
    scratch.map_or(Ok(()), |scratch| store.put_on(scratch))
}

/// The code value for each code value, after its linear value was multiplied by `factor`.
fn table(factor: f64) -> Vec<u16> {
    let of = |code: u16| match code {
        u16::MAX => code,
        _ => (65535.0 * linear_to_srgb(factor * srgb_to_linear(f64::from(code) / 65535.0)) + 0.5) as u16,
    };
    (0..=u16::MAX).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_multiplied_and_white_stays() {
        let at = |table: &[u16], code: u16| srgb_to_linear(f64::from(table[usize::from(code)]) / 65535.0);
        for factor in [0.8, 1.0, 1.25] {
            let table = table(factor);
            assert_eq!((table[0], table[65535]), (0, 65535));
            for code in (1000..65535).step_by(97) {
                // Rounding by half a code value is a relative error of at most 0.1 % of the linear value.
                let expected = (factor * srgb_to_linear(f64::from(code) / 65535.0)).min(1.0);
                assert!((at(&table, code) / expected - 1.0).abs() < 1e-3, "{factor} {code}");
            }
        }
    }
}
