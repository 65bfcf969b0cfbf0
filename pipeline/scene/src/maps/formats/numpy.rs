//! NumPy arrays in `.npy` files and `.npz` archives.

use std::io::{Cursor, Read};
use std::path::Path;

use super::{Content, MAX_PIXELS, checked_size, damaged};
use crate::image_file::read_file;
use crate::npy_file::{self, NpyArray};
use crate::{Error, FloatImage, Result};

/// Names under which the array of a kind of map is found in an archive of several arrays.
fn archive_names(content: Content) -> &'static [&'static str] {
    match content {
        Content::Depth => &["depth", "depths", "disparity", "disp"],
        Content::Flow => &["flow", "flows"],
        Content::Normals => &["normal", "normals"],
        Content::Mask => &["mask", "masks"],
    }
}

/// Decodes an array of shape [H, W, C] or [C, H, W], or [H, W] for one channel; leading axes of length 1, e.g. of a batch,
/// are dropped.
pub(super) fn read(path: &Path, content: Content) -> Result<FloatImage> {
    let array = array(path, content)?;
    let batch = array.shape.iter().take(array.shape.len().saturating_sub(2)).take_while(|side| **side == 1).count();
    // The first layout that fits: an axis of length 1 may also be the only channel.
    let fitting = (0..=batch).find_map(|skipped| Layout::of(&array.shape[skipped..], content.channels()));
    let layout = fitting.ok_or_else(|| wrong_shape(&array.shape, "", content.channels(), path))?;
    layout.image(&array.values, path)
}

/// Decodes an array with an image per frame: [T, H, W, C] or [T, C, H, W], or [T, H, W] for one channel; a leading axis of
/// length 1 is dropped if the rest fits.
pub(super) fn read_video(path: &Path, content: Content) -> Result<Vec<FloatImage>> {
    frames(array(path, content)?, content.channels(), path)
}

/// Like [`read_video`], for the array called `name` in an archive.
pub(super) fn read_member_video(path: &Path, name: &str, channels: usize) -> Result<Vec<FloatImage>> {
    frames(npy_file::read_member(path, name)?, channels, path)
}

/// The images of an array with an image per frame.
fn frames(NpyArray { mut shape, values }: NpyArray, channels: usize, path: &Path) -> Result<Vec<FloatImage>> {
    if shape.len() == 5 && shape[0] == 1 {
        shape.remove(0);
    }
    let layout = shape.get(1..).and_then(|frame| Layout::of(frame, channels));
    let layout = layout.ok_or_else(|| wrong_shape(&shape, "T, ", channels, path))?;
    values.chunks_exact((values.len() / shape[0].max(1)).max(1)).map(|frame| layout.image(frame, path)).collect()
}

fn array(path: &Path, content: Content) -> Result<NpyArray> {
    let is_archive = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npz"));
    if is_archive {
        npy_file::parse(&from_archive(&read_file(path)?, content, path)?, path)
    } else {
        npy_file::read(path)
    }
}

/// The axes of an image in an array.
struct Layout {
    height: usize,
    width: usize,
    channels: usize,
    /// Distance between rows, columns and channels in the array.
    strides: [usize; 3],
}

impl Layout {
    /// The layout of an array of this shape; none if it is not an image with this many channels.
    fn of(shape: &[usize], channels: usize) -> Option<Self> {
        let (height, width, strides) = match *shape {
            [height, width] if channels == 1 => (height, width, [width, 1, 0]),
            [height, width, last] if last == channels => (height, width, [width * channels, channels, 1]),
            [first, height, width] if first == channels => (height, width, [width, 1, height * width]),
            _ => return None,
        };
        Some(Self { height, width, channels, strides })
    }

    fn image(&self, values: &[f64], path: &Path) -> Result<FloatImage> {
        let Self { height, width, channels, strides } = *self;
        let size = checked_size(width as u64, height as u64, path)?;
        let pixels = (0..height).flat_map(|row| (0..width).map(move |column| row * strides[0] + column * strides[1]));
        let places = pixels.flat_map(|pixel| (0..channels).map(move |channel| pixel + channel * strides[2]));
        let values = places.map(|at| values[at] as f32).collect();
        Ok(FloatImage { width: size.0, height: size.1, channels, values })
    }
}

/// The error for an array that is not an image; `leading` names axes before those of the image.
fn wrong_shape(shape: &[usize], leading: &str, channels: usize, path: &Path) -> Error {
    let message = format!(
        "an array of shape {shape:?} where [{leading}H, W, {channels}] or [{leading}{channels}, H, W] is expected"
    );
    Error::new(message).at(path)
}

/// The bytes of the array with a well-known name, or of the only array in an archive.
fn from_archive(bytes: &[u8], content: Content, path: &Path) -> Result<Vec<u8>> {
    let mut archive =
        zip::ZipArchive::new(Cursor::new(bytes)).map_err(|error| damaged("NumPy archive", error, path))?;
    let arrays: Vec<String> = archive
        .file_names()
        .filter_map(|name| Some(name.ok()?.into_owned()))
        .filter(|name| name.ends_with(".npy"))
        .collect();
    let known = |name: &&String| archive_names(content).iter().any(|known| **name == format!("{known}.npy"));
    let Some(name) = arrays.iter().find(known).or(if arrays.len() == 1 { arrays.first() } else { None }) else {
        let message =
            format!("none of the arrays {} is named {}", arrays.join(", "), archive_names(content).join(" or "));
        return Err(Error::new(message).at(path));
    };
    let file = archive.by_name(name).map_err(|error| damaged("NumPy archive", error, path))?;
    let mut array = Vec::new();
    // Three channels of f64 and a header.
    let limit = 24 * MAX_PIXELS + (1 << 16);
    file.take(limit).read_to_end(&mut array).map_err(|error| damaged("NumPy archive", error, path))?;
    Ok(array)
}
