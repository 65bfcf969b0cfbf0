//! LLFF (Mildenhall et al. 2019): photos of a static scene in `images`, a row per photo in `poses_bounds.npy`. NSFF (Li et al.
//! 2021) and DynamicNeRF (Gao et al. 2021) store the frames of a video of one moving camera like this.
//!
//! Every `every_nth`-th photo is a test view, starting with the first, as in the loaders of NeRF and its followers.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::Split;

use crate::error::{Result, bad};
use crate::files::{self, children, image_size};
use crate::image_names::{natural_order, view_name};
use crate::lens::Lens;
use crate::params::{Format, Params};
use crate::poses_bounds::{self, Stated};
use crate::rig;
use crate::rig::videos::images;
use crate::source::{Frame, SourceCapture};
use crate::split;

/// Folders of maps that are computed for the frames of a video: flow, and masks of what moves.
const VIDEO_MAPS: [&str; 4] = ["flow", "flow_i1", "motion_masks", "mv_masks"];

/// Whether `dir` has this format: no folder of a camera, and no views at other instants.
pub(crate) fn is_present(dir: &Path) -> bool {
    dir.join(poses_bounds::FILE).is_file() && !copies(dir).is_empty()
}

/// Folders of images: `images` and smaller copies, `images_4` or `images_512x288`. Others may have the images before a step of
/// the preparation, such as `images_colmap`.
fn copies(dir: &Path) -> Vec<PathBuf> {
    let is_size = |size: &str| size.splitn(2, 'x').all(|number| number.parse::<u32>().is_ok());
    let is_copy = |name: &String| name == "images" || name.strip_prefix("images_").is_some_and(is_size);
    children(dir).into_iter().filter(is_copy).map(|name| dir.join(name)).filter(|path| path.is_dir()).collect()
}

/// Reads the poses and the names of the photos; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut warnings = Vec::new();
    let (mut photos, mut stated, reduction) = photos(dir, params, &mut warnings)?;
    let is_video = is_video(dir, params, &mut warnings);
    if is_video {
        (photos, stated) = by_instant(photos, stated);
    }
    let stated_in = dir.join(poses_bounds::FILE);
    let frame = |(index, (image, stated)): (u32, (&PathBuf, &Stated))| {
        let camera = poses_bounds::reduced(&stated.camera, reduction);
        Frame {
            name: view_name(&files::name(image)),
            split: Split::Train,
            image: image.clone(),
            stored_image: None,
            mask: None,
            depth: None,
            lens: Lens::pinhole(camera.intrinsics),
            camera_from_world: camera.camera_from_world,
            camera_index: if is_video { 0 } else { index },
            frame_index: if is_video { index } else { 0 },
            time_secs: if is_video { f64::from(index) / params.fps } else { 0.0 },
            stated_in: stated_in.clone(),
        }
    };
    let mut frames: Vec<Frame> = (0..).zip(photos.iter().zip(&stated)).map(frame).collect();
    let mut rules = vec![split::hold_out(&mut frames, !is_video, params)];
    if reduction > 1 {
        rules.push(format!("images at 1/{reduction}"));
    }
    let unbounded = stated.iter().filter(|row| row.depth_view.is_none()).count();
    let warning = format!("{unbounded} rows of {} state no depth range", poses_bounds::FILE);
    warnings.extend((unbounded > 0).then_some(warning));
    let capture = rig::capture(dir, (Format::Llff, "llff"), frames, rules, params);
    Ok(SourceCapture { warnings, ..capture })
}

/// Whether the images are frames of a video and not views of one instant.
fn is_video(dir: &Path, params: &Params, warnings: &mut Vec<String>) -> bool {
    let has_maps = VIDEO_MAPS.iter().any(|name| dir.join(name).is_dir());
    if params.static_scene.is_none() && !has_maps {
        let note = "the images are imported as photos of one instant; if they are frames of a video, set static = false, and fps \
                    to its frame rate";
        warnings.push(note.into());
    }
    params.static_scene.map_or(has_maps, |is_static| !is_static)
}

/// The frames of a video and their rows, by the numbers in the names.
pub(crate) fn by_instant(images: Vec<PathBuf>, rows: Vec<Stated>) -> (Vec<PathBuf>, Vec<Stated>) {
    let mut frames: Vec<(PathBuf, Stated)> = images.into_iter().zip(rows).collect();
    frames.sort_by(|a, b| natural_order(&a.0.to_string_lossy(), &b.0.to_string_lossy()));
    frames.into_iter().unzip()
}

/// The photos in the order of their names, their rows, and the factor by which they are smaller than stated in the rows.
pub(crate) fn photos(
    dir: &Path,
    params: &Params,
    warnings: &mut Vec<String>,
) -> Result<(Vec<PathBuf>, Vec<Stated>, u32)> {
    let folder = folder(dir, params)?;
    let mut photos = images(&folder);
    photos.sort(); // as text, like the writers and readers of the rows
    let Some(first) = photos.first() else {
        let failure = Failure::new(FailureKind::MissingData, "the folder has no images");
        return Err(failure.hint("download the images that poses_bounds.npy belongs to").at(folder));
    };
    let names: Vec<String> = photos.iter().map(|path| files::name(path)).collect();
    let stated = poses_bounds::read(&dir.join(poses_bounds::FILE), &names)?;
    warnings.extend(poses_bounds::order_warning(&names));
    let reduction = poses_bounds::reduction(image_size(first)?, &stated[0].camera);
    Ok((photos, stated, reduction))
}

/// The folder that `images` names; otherwise the one with the smallest images of at least `width`, or the largest ones. Of
/// several with images of one width it is the first, `images` before its copies.
fn folder(dir: &Path, params: &Params) -> Result<PathBuf> {
    if let Some(name) = &params.images {
        return Ok(dir.join(name));
    }
    let width = |path: &PathBuf| Some((image_size(images(path).first()?).ok()?.0, path.clone()));
    let mut sized: Vec<(u32, PathBuf)> = copies(dir).iter().filter_map(width).collect();
    sized.sort();
    let largest = || sized.iter().rev().max_by_key(|(width, _)| *width);
    let wide = sized.iter().find(|(width, _)| params.width.is_some_and(|wanted| *width >= wanted)).or_else(largest);
    let empty = || bad("there are no images in images/").hint("download the images of the capture").at(dir);
    wide.map(|(_, path)| path.clone()).ok_or_else(empty)
}
