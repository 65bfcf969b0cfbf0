//! NumPy arrays in `.npy` files, or alone or under a well-known name in `.npz` archives.

use std::io::{Cursor, Read};
use std::path::Path;

use scene::npy_file::{self, NpyArray};
use scene::{Error, FloatImage, Result};

use super::{Content, MAX_PIXELS, checked_size, damaged, read_bytes};

/// Names of arrays in archives, where an archive has more than one.
fn archive_names(content: Content) -> &'static [&'static str] {
    match content {
        Content::Depth => &["depth", "disparity", "disp"],
        Content::Flow => &["flow"],
        Content::Normals => &["normal", "normals"],
        Content::Mask => &["mask"],
    }
}

/// Decodes an array of shape [H, W, C] or [C, H, W] ([H, W] for one channel).
pub(super) fn read(path: &Path, content: Content) -> Result<FloatImage> {
    let is_archive = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("npz"));
    let array = if is_archive {
        npy_file::parse(&from_archive(&read_bytes(path)?, content, path)?, path)?
    } else {
        npy_file::read(path)?
    };
    let channels = content.channels();
    // Height, width, and the distances of neighbours in a column, in a row and between channels.
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

/// The one array of an archive, or that with a well-known name.
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
            format!("none of the arrays {} is called {}", arrays.join(", "), archive_names(content).join(" or "));
        return Err(Error::new(message).at(path));
    };
    let file = archive.by_name(name).map_err(|error| damaged("NumPy archive", error, path))?;
    let mut array = Vec::new();
    // Doubles of three channels, and a header.
    let limit = 24 * MAX_PIXELS + (1 << 16);
    file.take(limit).read_to_end(&mut array).map_err(|error| damaged("NumPy archive", error, path))?;
    Ok(array)
}
