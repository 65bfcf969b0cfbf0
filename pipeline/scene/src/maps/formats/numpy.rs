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
        Content::Depth => &["depth", "disparity", "disp"],
        Content::Flow => &["flow"],
        Content::Normals => &["normal", "normals"],
        Content::Mask => &["mask"],
    }
}

/// Decodes an array of shape [H, W, C] or [C, H, W], or [H, W] for one channel.
pub(super) fn read(path: &Path, content: Content) -> Result<FloatImage> {
    let is_archive = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npz"));
    let array = if is_archive {
        npy_file::parse(&from_archive(&read_file(path)?, content, path)?, path)?
    } else {
        npy_file::read(path)?
    };
    let channels = content.channels();
    // Height, width, and the strides of rows, columns and channels.
    let (height, width, strides) = match *array.shape {
        [height, width] if channels == 1 => (height, width, [width, 1, 0]),
        [height, width, last] if last == channels => (height, width, [width * channels, channels, 1]),
        [first, height, width] if first == channels => (height, width, [width, 1, height * width]),
        _ => {
            let NpyArray { shape, .. } = array;
            let message =
                format!("an array of shape {shape:?} where [H, W, {channels}] or [{channels}, H, W] is expected");
            return Err(Error::new(message).at(path));
        }
    };
    let size = checked_size(width as u64, height as u64, path)?;
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| row * strides[0] + column * strides[1]));
    let places = pixels.flat_map(|pixel| (0..channels).map(move |channel| pixel + channel * strides[2]));
    let values = places.map(|at| array.values[at] as f32).collect();
    Ok(FloatImage { width: size.0, height: size.1, channels, values })
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
