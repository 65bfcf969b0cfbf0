//! VGGT (Wang et al. 2025): `predictions.npz`, as its demo writes it next to `images/`.
//!
//! The network sees the images in the plain order of their names, resized to a width of 518 pixels and a height in
//! multiples of 14; of taller images it sees the middle 518 rows, and other callers pad to a square instead. Pose,
//! intrinsics and depth refer to this view; here they are mapped back to the whole images.

use std::path::{Path, PathBuf};

use image::RgbImage;
use scene::{Camera, FloatImage, Intrinsics};

use super::{Clip, Images, array, shape, wrong_shape};
use crate::error::{Result, bad};
use crate::files::{children, image_size};
use crate::image_names::EXTENSIONS;
use crate::matrices::{pinhole, straightened, transform};
use crate::params::{Format, Params};
use crate::pixels::decode;
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
    let mut warnings = Vec::new();
    let (images, window, size) = images(dir, &path, (count, seen), &mut warnings)?;
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
        warnings,
        stated_in: path,
    };
    Ok(clip.capture(dir, params))
}

/// The images in `images/`, the part of them that the network saw, and their size; without that folder, those in the archive.
fn images(
    dir: &Path,
    path: &Path,
    (count, seen): (usize, (u32, u32)),
    warnings: &mut Vec<String>,
) -> Result<(Images, Option<Window>, (u32, u32))> {
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
    let window = match *windows(size, seen).as_slice() {
        [cropped, padded] if is_padded(path, first, [cropped, padded], warnings)? => Some(padded),
        [window, ..] => Some(window),
        [] => None,
    };
    let window = window.ok_or_else(|| {
        let message = format!("depth of {}×{} pixels does not fit images of {}×{}", seen.0, seen.1, size.0, size.1);
        bad(message).hint("images/ must have the images that VGGT read").at(path)
    })?;
    Ok((Images::Files(files), Some(window), size))
}

/// The parts of an image of this size that the network may have seen: all of it, or the image padded to a square, or, of a tall
/// image, its middle rows or the image padded to a square.
fn windows((width, height): (u32, u32), seen: (u32, u32)) -> Vec<Window> {
    let patched = |side: u32, target: u32, other: u32| {
        let pixels = f64::from(side) * f64::from(target) / f64::from(other);
        ((pixels / PATCH_PX).round_ties_even() * PATCH_PX) as u32
    };
    let placed = |width: u32, height: u32| {
        let before = |whole: u32, seen: u32| (whole as i32 - seen as i32) / 2;
        Window { width, height, left: before(width, seen.0), top: before(height, seen.1) }
    };
    let (full_width, full_height) = (patched(width, seen.1, height), patched(height, seen.0, width));
    match full_height {
        _ if full_height > MAX_SIDE || full_height != seen.1 && seen.0 != seen.1 => Vec::new(),
        _ if full_height > seen.1 && full_width > 0 => {
            vec![placed(seen.0, full_height), placed(full_width, seen.1)]
        }
        _ => vec![placed(seen.0, full_height)],
    }
}

/// Whether the network saw an image padded instead of cropped, by the first image in the archive. Without it, a warning is issued,
/// because the demo offers both.
fn is_padded(path: &Path, first: &Path, [cropped, padded]: [Window; 2], warnings: &mut Vec<String>) -> Result<bool> {
    if shape(path, "images").is_err() {
        warnings.push(
            "predictions.npz has no images: the network is assumed to have seen the middle of the tall images; if they were padded \
             to squares, save the array images, too"
                .into(),
        );
        return Ok(false);
    }
    let images = VideoMaps::member(path.into(), "images", 3);
    let (seen, whole) = (images.frame(0).map_err(|failure| failure.at(path))?, decode(first)?.into_rgb8());
    Ok(difference(seen, &whole, &padded) < difference(seen, &whole, &cropped))
}

/// The sum of the differences between what the network saw and the image in this window, whose margin is white.
fn difference(seen: &FloatImage, whole: &RgbImage, window: &Window) -> f64 {
    let place = |at: u32, before: i32, side: u32, pixels: u32| {
        let at = u32::try_from(at as i32 + before).ok().filter(|at| *at < side)?;
        Some((u64::from(at) * u64::from(pixels) / u64::from(side)) as u32)
    };
    let value = |(index, value): (usize, &f32)| {
        let (pixel, channel) = (index as u32 / 3, index % 3);
        let x = place(pixel % seen.width, window.left, window.width, whole.width());
        let y = place(pixel / seen.width, window.top, window.height, whole.height());
        let level = x.zip(y).map_or(255, |(x, y)| whole.get_pixel(x, y)[channel]);
        f64::from((value - f32::from(level) / 255.0).abs())
    };
    seen.values.iter().enumerate().map(value).sum()
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
        let whole = |width, height| [Window { width, height, left: 0, top: 0 }];
        assert_eq!(windows((1920, 1080), (518, 294)), whole(518, 294));
        assert_eq!(windows((640, 480), (518, 392)), whole(518, 392));
        // 1080×1920: 518×924, of which the middle 518 rows are seen.
        assert_eq!(
            windows((1080, 1920), (518, 518)),
            [
                Window { width: 518, height: 924, left: 0, top: 203 },
                Window { width: 294, height: 518, left: -112, top: 0 }
            ]
        );
        assert_eq!(windows((1920, 1080), (518, 518)), [Window { width: 518, height: 294, left: 0, top: -112 }]);
        assert_eq!(windows((1920, 1080), (518, 392)), []);
    }
}
