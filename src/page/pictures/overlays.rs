//! Overlays of the result: motion, and local processing by the phone or camera.
//!
//! In: the ghost mask or the local gain. Out: small transparent [`Picture`]s, which a browser scales over the
//! picture. Cost: some ns per pixel of the picture.

use crate::draw::image::{Picture, paletted};
use crate::draw::scale::{reduce_to, within};
use crate::merge::local::LocalGain;
use crate::plane::Plane;

/// Largest long side of the overlay of motion, in pixels.
const MOVEMENT: usize = 900;
/// Largest long side of the overlay of the local gain, in pixels. It can be small because the gain is smooth.
const GAIN: usize = 200;

/// Colours (red, green, blue, opacity) where none, some, most or all of the frames other than the reference were not
/// merged.
const MOVED: [[u8; 4]; 4] = [[230, 0, 126, 0], [230, 0, 126, 120], [230, 0, 126, 150], [230, 0, 126, 180]];
/// Smallest mask value that means that some of the other frames were not merged. For one of 15 frames, the mask has 17
/// of 255.
const FEW: u8 = 16;
/// Smallest mask value that means that about half of the other frames were not merged.
const HALF: u8 = 120;
/// Smallest mask value that means that nearly all of the other frames were not merged.
const NEARLY_ALL: u8 = 200;
/// Colour of areas that are brighter than the exposure of the frame explains.
const BRIGHTER: [u8; 3] = [20, 110, 255];
/// Colour of areas that are darker than the exposure of the frame explains.
const DARKER: [u8; 3] = [255, 120, 0];
/// Opacity of `BRIGHTER` and `DARKER` for the largest gain, from 0 to 255.
const OPAQUE: f64 = 130.0;
/// Number of steps of opacity of `BRIGHTER`, and of `DARKER`.
const STEPS: i32 = 7;

/// Maps of the local gain of each frame, divided by the local gain of the reference.
#[derive(Debug, Clone)]
pub(in crate::page) struct Local {
    /// Gain in stops, up or down, that is shown by the strongest colours.
    pub most_stops: f64,
    /// Index in `frames` of the map with the greatest gain.
    pub strongest: usize,
    /// For each frame except the reference, its index in the bracket and its map.
    pub frames: Vec<(usize, Picture)>,
}

/// Draws a picture of where something moved, from the ghost `mask`.
pub(in crate::page) fn movement(mask: &Plane<u8>) -> Result<Picture, String> {
    let full = (mask.width(), mask.height());
    let small = reduce_to(mask, within(full, MOVEMENT));
    let level = |v: u8| match v {
        0..FEW => 0,
        FEW..HALF => 1,
        HALF..NEARLY_ALL => 2,
        NEARLY_ALL.. => 3,
    };
    let levels = small.as_slice().iter().map(|&v| level(v)).collect();
    paletted(&Plane::from_vec(small.width(), small.height(), levels), &MOVED)
}

/// Draws the gains of the frames with the indices `placed` in the bracket, as overlays of a picture of `size` pixels;
/// `None` if no frame has a gain.
pub(in crate::page) fn local(
    gain: &LocalGain,
    placed: &[usize],
    size: (usize, usize),
) -> Result<Option<Local>, String> {
    let (across, down) = within(size, GAIN);
    let stops = |layer: usize| -> Option<Plane<f32>> {
        let mut all = Vec::with_capacity(across * down);
        for y in 0..down {
            let row = (2 * y + 1) * size.1 / (2 * down);
            let factors = gain.against_reference(layer, row..row + 1);
            let factor = |x: usize| factors.get((2 * x + 1) * size.0 / (2 * across)).copied();
            all.extend((0..across).filter_map(factor).map(libm::log2f));
        }
        (all.len() == across * down).then(|| Plane::from_vec(across, down, all))
    };
    let maps: Vec<(usize, Plane<f32>)> =
        placed.iter().enumerate().filter_map(|(layer, &frame)| Some((frame, stops(layer)?))).collect();
    if maps.is_empty() {
        return Ok(None);
    }
    let greatest = |map: &Plane<f32>| map.as_slice().iter().fold(0.0f32, |most, v| most.max(v.abs()));
    let most = maps.iter().map(|(_, map)| greatest(map)).fold(0.0, f32::max);
    // If several maps have the greatest gain, the first of them is used.
    let strongest = maps.iter().position(|(_, map)| greatest(map) >= most).unwrap_or(0);
    let frames = maps.iter().map(|(frame, map)| Ok((*frame, coloured(map, most)?)));
    Ok(Some(Local { most_stops: f64::from(most), strongest, frames: frames.collect::<Result<_, String>>()? }))
}

/// Draws the gains `stops` in colours; the strongest colours show a gain of `most`.
fn coloured(stops: &Plane<f32>, most: f32) -> Result<Picture, String> {
    let index = |v: f32| {
        let step = (v / most.max(f32::MIN_POSITIVE) * STEPS as f32).round() as i32;
        (step.clamp(-STEPS, STEPS) + STEPS) as u8
    };
    let indices = stops.as_slice().iter().map(|&v| index(v)).collect();
    paletted(&Plane::from_vec(stops.width(), stops.height(), indices), &gain_palette())
}

/// Returns the colours from the smallest gain to the largest. The gain is smallest where the camera had brightened the
/// frame most.
fn gain_palette() -> Vec<[u8; 4]> {
    let colour = |step: i32| {
        let [r, g, b] = if step < 0 { BRIGHTER } else { DARKER };
        [r, g, b, (OPAQUE * f64::from(step.abs()) / f64::from(STEPS)).round() as u8]
    };
    (-STEPS..=STEPS).map(colour).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use base64::Engine;
    use base64::engine::general_purpose::STANDARD;

    fn pixel(picture: &Picture, x: u32, y: u32) -> [u8; 4] {
        let (_, data) = picture.address.split_once(";base64,").unwrap();
        image::load_from_memory(&STANDARD.decode(data).unwrap()).unwrap().to_rgba8().get_pixel(x, y).0
    }

    #[test]
    fn movement_is_coloured_and_the_rest_is_clear() {
        let mask = Plane::from_rows(40, 20, |_, row: &mut [u8]| row[20..].fill(255));
        let picture = movement(&mask).unwrap();
        assert_eq!((pixel(&picture, 5, 5)[3], pixel(&picture, 30, 5)), (0, MOVED[3]));
        // A place where one of three other frames was not merged is also visible.
        let third = movement(&Plane::filled(9, 9, 85)).unwrap();
        assert_eq!(pixel(&third, 4, 4), MOVED[1]);
    }

    #[test]
    fn gain_has_a_colour_for_either_side() {
        let stops = Plane::from_vec(3, 1, vec![-1.0, 0.0, 1.0]);
        let picture = coloured(&stops, 1.0).unwrap();
        let [blue, clear, orange] = [0, 1, 2].map(|x| pixel(&picture, x, 0));
        assert_eq!((&blue[..3], clear[3], &orange[..3]), (&BRIGHTER[..], 0, &DARKER[..]));
        assert_eq!((blue[3], orange[3]), (130, 130));
    }
}
