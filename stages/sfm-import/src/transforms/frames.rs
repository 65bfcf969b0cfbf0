//! The frames of transforms files as posed and timed views.

use std::path::{Component, Path, PathBuf};

use scene::Split;

use super::companions::{self, Companions};
use super::document::{StatedFrame, TransformsFile};
use crate::depth::DepthFile;
use crate::error::{Result, bad};
use crate::files::image_size;
use crate::params::Params;
use crate::source::Frame;

/// File extensions of images.
const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// A frame of a file, with its name and split.
pub(crate) struct ListedFrame<'a> {
    /// Name of the view.
    pub(crate) name: String,
    /// The split that the view belongs to.
    pub(crate) split: Split,
    /// What the file states about it.
    pub(crate) stated: &'a StatedFrame,
    /// The file.
    pub(crate) file: &'a TransformsFile,
    /// The image.
    pub(crate) image: PathBuf,
}

/// Posed and timed views, each as camera 0, with their masks and depth maps.
pub(crate) fn frames(
    dir: &Path,
    listed: &[ListedFrame<'_>],
    params: &Params,
    warnings: &mut Vec<String>,
) -> Result<Vec<Frame>> {
    let size = any_image_size(listed)?;
    let masks = companions::masks(dir, listed, size, warnings);
    let depths = companions::depths(dir, listed, warnings);
    let companions = masks.into_iter().zip(depths);
    listed.iter().zip(companions).map(|(listed, found)| frame(listed, found, size, params, warnings)).collect()
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
    if let Some(warning) = stated_lens.disagreement(&lens.intrinsics).filter(|warning| !warnings.contains(warning)) {
        warnings.push(warning);
    }
    let camera_from_world = file
        .camera_from_world(stated)
        .map_err(|failure| bad(format!("{} ({name}): {}", stated.file_path, failure.message)).at(&file.path))?;
    let unit = params.depth_unit.or(file.depth_unit());
    Ok(Frame {
        name: name.clone(),
        split: listed.split,
        image: listed.image.clone(),
        mask,
        depth: depth.map(|path| DepthFile::new(path, unit)),
        lens,
        camera_from_world,
        camera_index: 0,
        frame_index: 0,
        time_secs: stated.time.unwrap_or_default(),
        stated_in: file.path.clone(),
    })
}

/// The size of the first existing image. Missing images and other sizes are reported later with all other problems.
fn any_image_size(listed: &[ListedFrame<'_>]) -> Result<(u32, u32)> {
    let images = || listed.iter().map(|frame| &frame.image);
    match images().find(|image| image.is_file()).or(images().next()) {
        Some(image) => image_size(image),
        None => Ok((1, 1)), // a capture without frames is reported as a problem of its own
    }
}

/// The image that a `file_path` names. Blender's files omit the extension, which is then the first of [`EXTENSIONS`] that
/// exists, or `png`.
pub(crate) fn image_path(dir: &Path, file_path: &str) -> Result<PathBuf> {
    let name = relative(file_path)?;
    if name.as_os_str().is_empty() {
        return Err(bad("a frame has an empty file_path").hint("name its image, or remove the frame"));
    }
    let path = dir.join(name);
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    if extension.is_some_and(|extension| EXTENSIONS.contains(&extension.as_str())) || path.is_file() {
        return Ok(path);
    }
    let candidates = EXTENSIONS.map(|extension| PathBuf::from(format!("{}.{extension}", path.display())));
    Ok(candidates.iter().find(|path| path.is_file()).unwrap_or(&candidates[0]).clone())
}

/// A path as files state it, without `.` parts and with `/` for `\`. It must lead into the folder.
pub(crate) fn relative(stated: &str) -> Result<PathBuf> {
    let unified = stated.replace('\\', "/");
    let parts = || Path::new(&unified).components();
    if !parts().all(|part| matches!(part, Component::Normal(_) | Component::CurDir)) {
        let hint = "state paths relative to the folder of the transforms file, and put the files into it";
        return Err(bad(format!("file_path {stated} points outside of the capture's folder")).hint(hint));
    }
    Ok(parts().filter(|part| matches!(part, Component::Normal(_))).collect())
}
