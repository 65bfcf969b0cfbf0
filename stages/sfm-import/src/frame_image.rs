//! The image of a frame: in a separate file, in an array, or in a video.

use std::collections::BTreeMap;
use std::path::Path;

use captures::video;
use image::{DynamicImage, RgbImage};
use rayon::prelude::*;
use scene::FloatImage;

use crate::error::{Result, bad};
use crate::pixels;
use crate::source::Frame;
use crate::stored_image::{StoredImage, VideoFrame};

impl Frame {
    /// Decodes the image. That of a video costs as much as all images before it.
    pub(crate) fn decode(&self) -> Result<DynamicImage> {
        match &self.stored_image {
            None => pixels::decode(&self.image),
            Some(StoredImage::InArray(image)) => image.decode().map_err(|failure| failure.at(&self.image)),
            Some(StoredImage::InVideo(frame)) => {
                let mut decoded = None;
                video::decode(&self.image, Some([frame.index; 2]), |number, image| {
                    decoded = Some(of_size(image, frame.size, number)?);
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
        video::decode(path, Some([*first, *last]), |number, image| {
            frames.get(&number).map_or(Ok(()), |frame| each(frame, of_size(image, size, number)?))
        })
    })
}

/// The image of a frame of a video, if it has the size that the video states.
fn of_size(image: RgbImage, size: (u32, u32), number: u32) -> Result<DynamicImage> {
    let ((width, height), decoded) = (size, image.dimensions());
    if decoded == size {
        return Ok(image.into());
    }
    let message = format!("frame {number} has {}×{} pixels in a video of {width}×{height}", decoded.0, decoded.1);
    Err(bad(message).hint("encode the video again with frames of one size"))
}
