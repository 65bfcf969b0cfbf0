//! Decoders for the map files that estimators of depth, optical flow and normals write: EXR, NumPy, PFM, Middlebury
//! flow and PNG. A decoder returns the stored values; units and axes are up to the caller.

mod masklets;
mod middlebury;
mod numpy;
mod pfm;
mod png;
#[cfg(test)]
mod tests;

use std::path::Path;

use super::{DepthMap, FlowMap, NormalMap};
use crate::{Error, FloatImage, Result, exr_file};

/// File extensions that [`read`] supports.
pub const EXTENSIONS: [&str; 6] = ["exr", "npy", "npz", "pfm", "flo", "png"];

/// Upper limit of pixels per file: a damaged header must not cause a huge allocation.
const MAX_PIXELS: u64 = 1 << 28;

/// The kind of map that a file stores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Depth or inverse depth: one value per pixel.
    Depth,
    /// Optical flow: two values per pixel.
    Flow,
    /// Normals: three values per pixel.
    Normals,
    /// Mask: one value per pixel, to be compared with a threshold.
    Mask,
}

impl Content {
    /// Number of values per pixel.
    pub(crate) fn channels(self) -> usize {
        match self {
            Self::Depth | Self::Mask => 1,
            Self::Flow => 2,
            Self::Normals => 3,
        }
    }

    /// Accepted names of each EXR channel.
    fn exr_channels(self) -> Vec<Vec<&'static str>> {
        match self {
            Self::Depth | Self::Mask => vec![DepthMap::CHANNELS.to_vec()],
            Self::Flow => FlowMap::CHANNELS.map(|names| names.to_vec()).to_vec(),
            Self::Normals => NormalMap::CHANNELS.iter().zip(["R", "G", "B"]).map(|(a, b)| vec![*a, b]).collect(),
        }
    }
}

/// Decodes a file by its extension. The values are those in the file; for PNG depth and masks they are the integers.
/// Flow that its format marks as invalid becomes NaN.
pub fn read(path: &Path, content: Content) -> Result<FloatImage> {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default().to_lowercase();
    match extension.as_str() {
        "exr" => read_exr(path, content),
        "npy" | "npz" => numpy::read(path, content),
        "pfm" => pfm::read(path, content),
        "flo" if content == Content::Flow => middlebury::read(path),
        "png" => png::read(path, content),
        _ => {
            let message = format!("no decoder for {content:?} files with the extension .{extension}").to_lowercase();
            Err(Error::new(message).hint(format!("supported extensions: {}", EXTENSIONS.join(", "))).at(path))
        }
    }
}

/// Decodes the maps of all frames of a video, in their order: an array in an npy file or npz archive, or masks in a JSON file of
/// SA-V.
pub fn read_video(path: &Path, content: Content) -> Result<Vec<FloatImage>> {
    if content == Content::Mask && path.extension().is_some_and(|extension| extension == "json") {
        return masklets::read_video(path);
    }
    numpy::read_video(path, content)
}

/// Decodes the array called `name` in an npz archive, like [`read_video`], with `channels` values per pixel.
pub fn read_member_video(path: &Path, name: &str, channels: usize) -> Result<Vec<FloatImage>> {
    numpy::read_member_video(path, name, channels)
}

/// File extensions that [`read_video`] supports; JSON for masks only.
pub const VIDEO_EXTENSIONS: [&str; 3] = ["npy", "npz", "json"];

/// Interleaves the channels of an EXR file.
fn read_exr(path: &Path, content: Content) -> Result<FloatImage> {
    let image = exr_file::read(path)?;
    let channel = |names: &Vec<&str>| {
        let missing = || Error::new(format!("the EXR image has no channel {}", names.join(" or "))).at(path);
        image.channel(names).ok_or_else(missing)
    };
    let channels = content.exr_channels().iter().map(channel).collect::<Result<Vec<_>>>()?;
    let pixels = image.width as usize * image.height as usize;
    let values = (0..pixels).flat_map(|at| channels.iter().map(move |channel| channel[at])).collect();
    Ok(FloatImage { width: image.width, height: image.height, channels: channels.len(), values })
}

/// Width and height, if the image is neither empty nor larger than [`MAX_PIXELS`].
fn checked_size(width: u64, height: u64, path: &Path) -> Result<(u32, u32)> {
    let pixels = width.checked_mul(height).filter(|pixels| (1..=MAX_PIXELS).contains(pixels));
    match (u32::try_from(width), u32::try_from(height), pixels) {
        (Ok(width), Ok(height), Some(_)) => Ok((width, height)),
        _ => Err(Error::new(format!("an image of {width}×{height} pixels")).hint("the file may be damaged").at(path)),
    }
}

/// The error for a file that does not follow its format.
fn damaged(what: &str, reason: impl std::fmt::Display, path: &Path) -> Error {
    Error::new(format!("not a readable {what} ({reason})")).hint("the file may be damaged").at(path)
}

/// Decodes little-endian f32 values.
fn floats(bytes: &[u8]) -> impl Iterator<Item = f32> {
    bytes.chunks_exact(4).map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
}
