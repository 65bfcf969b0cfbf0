//! Files of per-pixel values, as estimators of depth, flow and normals write them: EXR, NumPy, PFM, Middlebury flow and
//! PNG. A reader decodes; what the values mean is said elsewhere.

mod middlebury;
mod numpy;
mod pfm;
mod png;
#[cfg(test)]
mod tests;

use std::path::Path;

use scene::{DepthMap, Error, FloatImage, FlowMap, NormalMap, Result, exr_file};

/// Endings of the files that [`read`] understands.
pub const EXTENSIONS: [&str; 6] = ["exr", "npy", "npz", "pfm", "flo", "png"];

/// More pixels than any camera has; a larger header is damage and must not become an allocation.
const MAX_PIXELS: u64 = 1 << 28;

/// What a file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// One value per pixel.
    Depth,
    /// Two values per pixel.
    Flow,
    /// Three values per pixel.
    Normals,
    /// One value per pixel, which is compared with a threshold.
    Mask,
}

impl Content {
    /// Values per pixel.
    pub fn channels(self) -> usize {
        match self {
            Self::Depth | Self::Mask => 1,
            Self::Flow => 2,
            Self::Normals => 3,
        }
    }

    /// Names of the channels in an EXR file, for each channel those that occur in the wild.
    fn exr_channels(self) -> Vec<Vec<&'static str>> {
        match self {
            Self::Depth | Self::Mask => vec![DepthMap::CHANNELS.to_vec()],
            Self::Flow => FlowMap::CHANNELS.map(|names| names.to_vec()).to_vec(),
            Self::Normals => NormalMap::CHANNELS.iter().zip(["R", "G", "B"]).map(|(a, b)| vec![*a, b]).collect(),
        }
    }
}

/// Decodes a file by its ending: the values as they stand in the file, of PNG files the integers. Where a format marks
/// missing values (flow), they are NaN.
pub fn read(path: &Path, content: Content) -> Result<FloatImage> {
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default().to_lowercase();
    match extension.as_str() {
        "exr" => read_exr(path, content),
        "npy" | "npz" => numpy::read(path, content),
        "pfm" => pfm::read(path, content),
        "flo" if content == Content::Flow => middlebury::read(path),
        "png" => png::read(path, content),
        _ => {
            let message = format!("no reader of {content:?} files that end in .{extension}").to_lowercase();
            Err(Error::new(message).hint(format!("supported are {}", EXTENSIONS.join(", "))).at(path))
        }
    }
}

fn read_exr(path: &Path, content: Content) -> Result<FloatImage> {
    let image = exr_file::read(path)?;
    let channel = |names: &Vec<&str>| {
        let missing = || Error::new(format!("EXR image has no channel called {}", names.join(" or "))).at(path);
        image.channel(names).ok_or_else(missing)
    };
    let channels = content.exr_channels().iter().map(channel).collect::<Result<Vec<_>>>()?;
    let pixels = image.width as usize * image.height as usize;
    let values = (0..pixels).flat_map(|at| channels.iter().map(move |channel| channel[at])).collect();
    Ok(FloatImage { width: image.width, height: image.height, channels: channels.len(), values })
}

/// Width and height of an image of a sane size.
fn checked_size(width: u64, height: u64, path: &Path) -> Result<(u32, u32)> {
    let pixels = width.checked_mul(height).filter(|pixels| (1..=MAX_PIXELS).contains(pixels));
    match (u32::try_from(width), u32::try_from(height), pixels) {
        (Ok(width), Ok(height), Some(_)) => Ok((width, height)),
        _ => Err(Error::new(format!("an image of {width}×{height} pixels")).hint("the file may be damaged").at(path)),
    }
}

fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|error| Error::new(format!("cannot read the file ({error})")).at(path))
}

fn damaged(what: &str, reason: impl std::fmt::Display, path: &Path) -> Error {
    Error::new(format!("not a readable {what} ({reason})")).hint("the file may be damaged").at(path)
}

/// Little-endian f32 values.
fn floats(bytes: &[u8]) -> impl Iterator<Item = f32> {
    bytes.chunks_exact(4).map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
}
