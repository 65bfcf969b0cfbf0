//! VGGT (Wang et al. 2025): `predictions.npz`, as its demo writes it next to `images/`.
//!
//! The network sees the images in the plain order of their names, resized to a width of 518 pixels and a height in
//! multiples of 14; of taller images it sees the middle 518 rows, and other callers pad to a square instead. Pose,
//! intrinsics and depth refer to this view; here they are mapped back to the whole images.

use std::path::{Path, PathBuf};

use scene::{Camera, Intrinsics};

use super::{Clip, Images, array, shape, wrong_shape};
use crate::error::{Result, bad};
use crate::files::{children, image_size};
use crate::image_names::EXTENSIONS;
use crate::matrices::{pinhole, straightened, transform};
use crate::params::{Format, Params};
use crate::source::SourceCapture;
use crate::video_maps::{VideoMaps, Window};

/// The file name.
const FILE: &str = "predictions.npz";
/// Sides of images are at most this, in pixels.
const MAX_SIDE: u32 = 16384;
/// Side of the patches of the network.
const PATCH_PX: f64 = 14.0;

/// Whether `dir` has this format.
pub(crate) fn is_present(dir: &Path) -> bool {
    dir.join(FILE).is_file()
}

/// Reads poses, intrinsics and the names of the images; decodes no map.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let path = dir.join(FILE);
    let depth = shape(&path, "depth")?;
    let [count, height, width, 1] = *depth else {
        return Err(wrong_shape("depth", &depth, "[frames, H, W, 1]", &path));
    };
    let seen = (width as u32, height as u32);
    let (extrinsic, intrinsic) = (array(&path, "extrinsic")?, array(&path, "intrinsic")?);
    if extrinsic.shape != [count, 3, 4] || intrinsic.shape != [count, 3, 3] {
        let (name, array) =
            if extrinsic.shape != [count, 3, 4] { ("extrinsic", extrinsic) } else { ("intrinsic", intrinsic) };
        return Err(wrong_shape(name, &array.shape, &format!("that of {count} frames"), &path));
    }
    let (images, window, size) = images(dir, &path, count, seen)?;
    let camera = |(pose, matrix): (&[f64], &[f64])| {
        let stated = pinhole(matrix, seen);
        let intrinsics = window.map_or(stated, |window| of_whole(stated, window)).resized(size.0, size.1);
        Camera { intrinsics, camera_from_world: straightened(transform(pose)) }
    };
    let confidence = shape(&path, "depth_conf").ok().map(|_| VideoMaps::member(path.clone(), "depth_conf", 1));
    let clip = Clip {
        format: Format::Vggt,
        cameras: extrinsic.values.chunks_exact(12).zip(intrinsic.values.chunks_exact(9)).map(camera).collect(),
        images,
        depth: VideoMaps::member(path.clone(), "depth", 1),
        confidence,
        window,
        no_depth_from: f32::INFINITY,
        masks: Vec::new(),
        warnings: Vec::new(),
        stated_in: path,
    };
    Ok(clip.capture(dir, params))
}

/// The images in `images/`, the part of them that the network saw, and their size; without that folder, those in the archive.
fn images(dir: &Path, path: &Path, count: usize, seen: (u32, u32)) -> Result<(Images, Option<Window>, (u32, u32))> {
    let folder = dir.join("images");
    let is_image = |name: &String| {
        let extension = Path::new(name).extension().map(|extension| extension.to_string_lossy().to_lowercase());
        extension.is_some_and(|extension| EXTENSIONS.contains(&extension.as_str())) && !name.starts_with('.')
    };
    let files: Vec<PathBuf> = children(&folder).into_iter().filter(is_image).map(|name| folder.join(name)).collect();
    let Some(first) = files.first() else {
        let hint = "put the images that VGGT read into images/ next to it";
        let stored = shape(path, "images").map_err(|failure| failure.hint(hint))?;
        if stored != [count, 3, seen.1 as usize, seen.0 as usize] {
            return Err(wrong_shape("images", &stored, "[frames, 3, H, W] of the depth", path));
        }
        let images = VideoMaps::member(path.into(), "images", 3);
        return Ok((Images::Array { images, white: 1.0 }, None, seen));
    };
    if files.len() != count {
        let message = format!("predictions of {count} frames, but {} images", files.len());
        let hint = "images/ must have exactly the images that VGGT read, in the order of their names";
        return Err(bad(message).hint(hint).at(&folder));
    }
    let size = image_size(first)?;
    let window = window(size, seen).ok_or_else(|| {
        let message = format!("depth of {}×{} pixels does not fit images of {}×{}", seen.0, seen.1, size.0, size.1);
        bad(message).hint("images/ must have the images that VGGT read").at(path)
    })?;
    Ok((Images::Files(files), Some(window), size))
}

/// The part of an image of this size that the network saw: all of it, its middle rows, or the image padded to a square.
fn window((width, height): (u32, u32), seen: (u32, u32)) -> Option<Window> {
    let patched = |side: u32, target: u32, other: u32| {
        let pixels = f64::from(side) * f64::from(target) / f64::from(other);
        ((pixels / PATCH_PX).round_ties_even() * PATCH_PX) as u32
    };
    let full_height = patched(height, seen.0, width);
    if full_height > MAX_SIDE {
        return None;
    }
    if full_height == seen.1 {
        return Some(Window { width: seen.0, height: seen.1, left: 0, top: 0 });
    }
    if seen.0 != seen.1 {
        return None;
    }
    if full_height > seen.1 {
        let top = (full_height - seen.1) / 2;
        return Some(Window { width: seen.0, height: full_height, left: 0, top: top as i32 });
    }
    let top = (seen.1 - full_height) / 2;
    Some(Window { width: seen.0, height: full_height, left: 0, top: -(top as i32) })
}

/// The pinhole of the whole image from that of the part that the network saw.
fn of_whole(seen: Intrinsics, window: Window) -> Intrinsics {
    let Window { width, height, left, top } = window;
    let (center_x, center_y) = (seen.center_x + f64::from(left), seen.center_y + f64::from(top));
    Intrinsics { width, height, center_x, center_y, ..seen }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_are_those_of_the_resizing_code() {
        let whole = |width, height| Some(Window { width, height, left: 0, top: 0 });
        assert_eq!(window((1920, 1080), (518, 294)), whole(518, 294));
        assert_eq!(window((640, 480), (518, 392)), whole(518, 392));
        // 1080×1920: 518×924, of which the middle 518 rows are seen.
        assert_eq!(window((1080, 1920), (518, 518)), Some(Window { width: 518, height: 924, left: 0, top: 203 }));
        assert_eq!(window((1920, 1080), (518, 518)), Some(Window { width: 518, height: 294, left: 0, top: -112 }));
        assert_eq!(window((1920, 1080), (518, 392)), None);
    }
}
