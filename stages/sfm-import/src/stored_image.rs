//! The location of an image that has no separate file.

use crate::video_maps::ArrayImage;

/// The location of an image that has no separate file.
#[derive(Clone, Debug)]
pub(crate) enum StoredImage {
    /// In an array of a whole video.
    InArray(ArrayImage),
    /// In a video file.
    InVideo(VideoFrame),
}

/// A frame of a video file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct VideoFrame {
    /// Its number, from 0 on.
    pub(crate) index: u32,
    /// Width and height in pixels.
    pub(crate) size: (u32, u32),
}

impl StoredImage {
    /// Width and height in pixels.
    pub(crate) fn size(&self) -> (u32, u32) {
        match self {
            Self::InArray(image) => image.size,
            Self::InVideo(frame) => frame.size,
        }
    }
}
