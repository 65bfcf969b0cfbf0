//! The image of a frame, in a file of its own or in an array.

use image::DynamicImage;
use scene::FloatImage;

use crate::error::Result;
use crate::pixels;
use crate::source::Frame;

impl Frame {
    /// Decodes the image.
    pub(crate) fn decode(&self) -> Result<DynamicImage> {
        self.stored_image.as_ref().map_or_else(
            || pixels::decode(&self.image),
            |stored| stored.decode().map_err(|failure| failure.at(&self.image)),
        )
    }

    /// Whether the image has an alpha channel.
    pub(crate) fn has_alpha(&self) -> Result<bool> {
        if self.stored_image.is_some() { Ok(false) } else { pixels::has_alpha(&self.image) }
    }

    /// The image on `background` at native size, like [`pixels::composited`].
    pub(crate) fn composited(&self, background: [f32; 3]) -> Result<(FloatImage, Option<FloatImage>)> {
        pixels::composited(self.decode()?, background).map_err(|failure| failure.at(&self.image))
    }
}
