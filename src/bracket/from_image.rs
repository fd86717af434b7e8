//! Frames from images in memory.
//!
//! In: an image of the `image` crate and its exposure. Out: a [`Frame`]. Cost: none for 8- and 16-bit RGB, else one
//! conversion.

use super::exposure::Exposure;
use super::{Frame, Samples};
use crate::error::{Error, Result};
use image::{ColorType, DynamicImage};
use std::path::PathBuf;

impl Frame {
    /// Creates a frame from an image in memory. 16-bit images keep their 16 bits. Alpha is dropped, grey becomes three
    /// equal channels.
    ///
    /// The pixel values are camera-encoded, as a decoder of JPEG, PNG or TIFF gives them. `name` identifies the frame
    /// in results and errors; a file of this name is not needed.
    ///
    /// # Errors
    /// [`Error::Decode`] where the image has no pixels, or contains floats, which are not pixel values of a camera.
    pub fn from_image(name: impl Into<PathBuf>, image: DynamicImage, exposure: Exposure) -> Result<Self> {
        let name = name.into();
        let (width, height) = (image.width() as usize, image.height() as usize);
        let refused =
            |reason: &str| Err(Error::Decode { path: name.clone(), format: "image", reason: reason.to_owned() });
        if width == 0 || height == 0 {
            return refused("the image has no pixels");
        }
        let samples = match image.color() {
            ColorType::Rgb32F | ColorType::Rgba32F => {
                return refused("the image contains floats; give the 8- or 16-bit values of the camera");
            }
            ColorType::L16 | ColorType::La16 | ColorType::Rgb16 | ColorType::Rgba16 => {
                Samples::Sixteen(image.into_rgb16().into_raw())
            }
            _ => Samples::Eight(image.into_rgb8().into_raw()),
        };
        Ok(Frame::new(name, width, height, samples, exposure))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bracket::Codes;
    use image::{ImageBuffer, Luma, LumaA, Rgb, Rgba};

    fn frame(image: impl Into<DynamicImage>) -> Result<Frame> {
        Frame::from_image("memory", image.into(), Exposure::given(0.0).unwrap())
    }

    #[test]
    fn frame_from_8_bit_image_has_its_pixel_values() {
        for image in [
            DynamicImage::from(ImageBuffer::from_pixel(3, 2, Rgba([10u8, 20, 30, 99]))),
            DynamicImage::from(ImageBuffer::from_pixel(3, 2, Rgb([10u8, 20, 30]))),
        ] {
            let frame = frame(image).unwrap();
            assert_eq!((frame.width(), frame.height(), frame.max()), (3, 2, 255));
            let window = frame.whole().unwrap();
            assert!(matches!(window.codes(), Codes::Eight(codes) if codes == [10, 20, 30].repeat(6)));
        }
    }

    #[test]
    fn frame_from_16_bit_grey_has_three_equal_channels_of_16_bits() {
        for image in [
            DynamicImage::from(ImageBuffer::from_pixel(2, 2, Luma([300u16]))),
            DynamicImage::from(ImageBuffer::from_pixel(2, 2, LumaA([300u16, 7]))),
        ] {
            let frame = frame(image).unwrap();
            assert_eq!(frame.max(), 65535);
            let window = frame.whole().unwrap();
            assert!(matches!(window.codes(), Codes::Sixteen(codes) if codes == [300; 12]));
        }
    }

    #[test]
    fn frame_from_floats_or_no_pixels_is_an_error_that_names_it() {
        let floats = frame(ImageBuffer::from_pixel(2, 2, Rgb([0.5f32; 3]))).unwrap_err();
        assert!(floats.to_string().contains("memory") && floats.to_string().contains("floats"), "{floats}");
        let empty = frame(ImageBuffer::<Rgb<u8>, _>::new(0, 2)).unwrap_err();
        assert!(empty.to_string().contains("no pixels"), "{empty}");
    }
}
