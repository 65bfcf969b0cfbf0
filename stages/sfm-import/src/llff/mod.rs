//! LLFF (Mildenhall et al. 2019): photos of a static scene in `images`, a row per photo in `poses_bounds.npy`.
//!
//! Every `every_nth`-th photo is a test view, starting with the first, as in the loaders of NeRF and its followers.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::Split;

use crate::error::{Result, bad};
use crate::files::{self, children, image_size};
use crate::image_names::view_name;
use crate::lens::Lens;
use crate::params::{Format, Params};
use crate::poses_bounds::{self, Stated};
use crate::rig;
use crate::rig::videos::images;
use crate::source::{Frame, SourceCapture};
use crate::split;

/// Whether `dir` has this format: no folder of a camera, and no views at other instants.
pub(crate) fn is_present(dir: &Path) -> bool {
    dir.join(poses_bounds::FILE).is_file() && !copies(dir).is_empty()
}

/// Folders of images: `images` and smaller copies.
fn copies(dir: &Path) -> Vec<PathBuf> {
    let is_copy = |name: &String| name == "images" || name.starts_with("images_");
    children(dir).into_iter().filter(is_copy).map(|name| dir.join(name)).filter(|path| path.is_dir()).collect()
}

/// Reads the poses and the names of the photos; opens only the headers of images.
pub(crate) fn read(dir: &Path, params: &Params) -> Result<SourceCapture> {
    let mut warnings = Vec::new();
    let (photos, stated, reduction) = photos(dir, params, &mut warnings)?;
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
            camera_index: index,
            frame_index: 0,
            time_secs: 0.0,
            stated_in: stated_in.clone(),
        }
    };
    let mut frames: Vec<Frame> = (0..).zip(photos.iter().zip(&stated)).map(frame).collect();
    let mut rules = vec![split::hold_out(&mut frames, true, params)];
    if reduction > 1 {
        rules.push(format!("images at 1/{reduction}"));
    }
    let unbounded = stated.iter().filter(|row| row.depth_view.is_none()).count();
    let warning = format!("{unbounded} rows of {} state no depth range", poses_bounds::FILE);
    warnings.extend((unbounded > 0).then_some(warning));
    let capture = rig::capture(dir, (Format::Llff, "llff"), frames, rules, params);
    Ok(SourceCapture { warnings, ..capture })
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

/// The folder that `images` names; otherwise the one with the smallest images of at least `width`, or the largest ones.
fn folder(dir: &Path, params: &Params) -> Result<PathBuf> {
    if let Some(name) = &params.images {
        return Ok(dir.join(name));
    }
    let width = |path: &PathBuf| Some((image_size(images(path).first()?).ok()?.0, path.clone()));
    let mut sized: Vec<(u32, PathBuf)> = copies(dir).iter().filter_map(width).collect();
    sized.sort();
    let wide = sized.iter().find(|(width, _)| params.width.is_some_and(|wanted| *width >= wanted)).or(sized.last());
    let empty = || bad("there are no images in images/").hint("download the images of the capture").at(dir);
    wide.map(|(_, path)| path.clone()).ok_or_else(empty)
}
