//! The image of a frame: in a separate file, in an array, or in a video.

use std::collections::BTreeMap;
use std::path::Path;

use image::DynamicImage;
use rayon::prelude::*;
use scene::FloatImage;

use crate::error::{Result, bad};
use crate::pixels;
use crate::source::Frame;
use crate::stored_image::{StoredImage, VideoFrame};
use crate::video_decoder::decode;

impl Frame {
    /// Decodes the image. That of a video costs as much as all images before it.
    pub(crate) fn decode(&self) -> Result<DynamicImage> {
        match &self.stored_image {
            None => pixels::decode(&self.image),
            Some(StoredImage::InArray(image)) => image.decode().map_err(|failure| failure.at(&self.image)),
            Some(StoredImage::InVideo(frame)) => {
                let mut decoded = None;
                decode(&self.image, frame.size, [frame.index; 2], |_, image| {
                    decoded = Some(DynamicImage::from(image));
                    Ok(())
                })
                .and_then(|()| decoded.ok_or_else(|| anyhow::anyhow!("the decoder gave no frame")))
                .map_err(|error| error.downcast().unwrap_or_else(|error| bad(format!("{error:#}")).at(&self.image)))
            }
        }
    }

    /// The place of the image in a video file, if it is in one.
    pub(crate) fn in_video(&self) -> Option<VideoFrame> {
        match self.stored_image {
            Some(StoredImage::InVideo(frame)) => Some(frame),
            _ => None,
        }
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

/// Decodes the image of every frame, and calls `each` with both. Images of one video are decoded in one pass, and each
/// thread holds one image at a time.
pub(crate) fn for_each_image(
    frames: &[&Frame],
    each: impl Fn(&Frame, DynamicImage) -> anyhow::Result<()> + Sync,
) -> anyhow::Result<()> {
    let mut videos: BTreeMap<&Path, BTreeMap<u32, &Frame>> = BTreeMap::new();
    let mut others = Vec::new();
    for frame in frames {
        match frame.in_video() {
            Some(place) => {
                videos.entry(&frame.image).or_default().insert(place.index, frame);
            }
            None => others.push(*frame),
        }
    }
    others.into_par_iter().try_for_each(|frame| each(frame, frame.decode()?))?;
    videos.into_par_iter().try_for_each(|(path, frames)| {
        let (Some((first, one)), Some((last, _))) = (frames.first_key_value(), frames.last_key_value()) else {
            return Ok(());
        };
        let size = (one.lens.intrinsics.width, one.lens.intrinsics.height);
        decode(path, size, [*first, *last], |number, image| {
            frames.get(&number).map_or(Ok(()), |frame| each(frame, image.into()))
        })
    })
}
