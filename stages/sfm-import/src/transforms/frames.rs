//! The frames of transforms files as posed and timed views.

use std::path::Path;

use super::companions::{self, Companions};
use super::listed::ListedFrame;
use crate::depth::DepthFile;
use crate::error::{Result, about};
use crate::files::image_size;
use crate::params::Params;
use crate::source::Frame;

/// Posed and timed views, each as camera 0, with their masks and depth maps.
pub(crate) fn frames(
    dir: &Path,
    listed: &[ListedFrame<'_>],
    params: &Params,
    warnings: &mut Vec<String>,
) -> Result<Vec<Frame>> {
    let moved: Vec<_> = listed.iter().filter(|frame| frame.is_moved(dir)).collect();
    if let Some(first) = moved.first() {
        let (image, stated) = (first.image.strip_prefix(dir).unwrap_or(&first.image), &first.stated.file_path);
        let count = moved.len();
        warnings
            .push(format!("{count} images are found by the end of their paths, e.g. {} for {stated}", image.display()));
    }
    warnings.extend(rounded_poses(listed));
    let size = any_image_size(listed)?;
    let masks = companions::masks(dir, listed, size, warnings);
    let depths = companions::depths(dir, listed, warnings);
    let companions = masks.into_iter().zip(depths);
    listed.iter().zip(companions).map(|(listed, found)| frame(listed, found, size, params, warnings)).collect()
}

/// A warning about poses whose numbers have few digits.
fn rounded_poses(listed: &[ListedFrame<'_>]) -> Option<String> {
    let rounded: Vec<_> = listed.iter().filter(|frame| frame.stated.is_rounded()).collect();
    let (count, example) = (rounded.len(), rounded.first()?);
    Some(format!(
        "the rotations of {count} poses have few digits, e.g. that of {}: the nearest rotations are used; export the poses \
         again with at least six digits",
        example.name
    ))
}

fn frame(
    listed: &ListedFrame<'_>,
    (mask, depth): (Companions, Companions),
    size: (u32, u32),
    params: &Params,
    warnings: &mut Vec<String>,
) -> Result<Frame> {
    let ListedFrame { name, stated, file, .. } = listed;
    let stated_lens = stated.lens.or(&file.document.lens);
    let lens = stated_lens.lens(size).map_err(|failure| failure.at(&file.path))?;
    if let Some(warning) = stated_lens.warning(&lens.intrinsics).filter(|warning| !warnings.contains(warning)) {
        warnings.push(warning);
    }
    let camera_from_world = file
        .camera_from_world(stated)
        .map_err(|failure| about(&format!("{} ({name})", stated.file_path), failure).at(&file.path))?;
    let unit = params.depth_unit.or(file.depth_unit());
    Ok(Frame {
        name: name.clone(),
        split: listed.split,
        image: listed.image.clone(),
        stored_image: None,
        mask,
        depth: depth.map(|path| DepthFile::new(path, unit)),
        lens,
        camera_from_world,
        camera_index: 0,
        frame_index: 0,
        time_secs: stated.time().unwrap_or_default(),
        stated_in: file.path.clone(),
    })
}

/// The size of the first existing image. Missing images and other sizes are reported later with all other problems.
fn any_image_size(listed: &[ListedFrame<'_>]) -> Result<(u32, u32)> {
    let images = || listed.iter().map(|frame| &frame.image);
    match images().find(|image| image.is_file()).or(images().next()) {
        Some(image) => image_size(image),
        None => Ok((1, 1)), // a capture without frames is reported as a separate problem
    }
}
