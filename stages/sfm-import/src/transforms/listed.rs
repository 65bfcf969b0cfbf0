//! The frames that transforms files list, and the paths in these files.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use scene::Split;

use super::document::{StatedFrame, TransformsFile};
use crate::error::{Result, bad};
use crate::files::RESIZED;
use crate::image_names::EXTENSIONS;

/// A frame of a file, with its name and split.
pub(crate) struct ListedFrame<'a> {
    /// Name of the view.
    pub(crate) name: String,
    /// The split that the view belongs to.
    pub(crate) split: Split,
    /// The file's entry for it.
    pub(crate) stated: &'a StatedFrame,
    /// The file.
    pub(crate) file: &'a TransformsFile,
    /// The image.
    pub(crate) image: PathBuf,
}

/// Drops frames that repeat an earlier frame of their split: the same image, pose and time.
pub(crate) fn drop_repeated(frames: &mut Vec<ListedFrame<'_>>, warnings: &mut Vec<String>) {
    let mut seen: BTreeMap<(Split, PathBuf), Vec<&StatedFrame>> = BTreeMap::new();
    let before = frames.len();
    frames.retain(|frame| {
        let earlier = seen.entry((frame.split, frame.image.clone())).or_default();
        let is_new = !earlier.iter().any(|stated| frame.stated.repeats(stated));
        earlier.push(frame.stated);
        is_new
    });
    if frames.len() < before {
        warnings.push(format!("{} frames repeat other frames of the file and are skipped", before - frames.len()));
    }
}

impl ListedFrame<'_> {
    /// Whether the image was found by the end of its path only.
    pub(super) fn is_moved(&self, dir: &Path) -> bool {
        let stated = relative(&self.stated.file_path);
        let is_below = |folder: PathBuf| self.image.parent() == folder.join(&stated).parent();
        let is_found = is_below(dir.to_owned()) || usual_folders(dir).into_iter().any(is_below);
        leaves_folder(&self.stated.file_path) || !is_found
    }
}

/// The usual folders of images in a capture.
fn usual_folders(dir: &Path) -> [PathBuf; 2] {
    [dir.join("images"), dir.join(RESIZED)]
}

/// The image that a `file_path` names, with or without its extension, as [`find`] finds it in the folder, or by its whole path in
/// a usual folder of images: there, the end of a path may be that of the images of several cameras. The extension may differ: in
/// case, as on file systems that ignore it, or because the images were converted. A missing image has the stated path.
pub(crate) fn image_path(dir: &Path, file_path: &str) -> Result<PathBuf> {
    let name = relative(file_path);
    if name.as_os_str().is_empty() {
        return Err(bad("a frame has an empty file_path").hint("name its image, or remove the frame"));
    }
    let extension = name.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let is_named = extension.as_ref().is_some_and(|extension| EXTENSIONS.contains(&extension.as_str()));
    let with = |extension: String| PathBuf::from(format!("{}.{extension}", name.display()));
    let all = EXTENSIONS.map(str::to_owned).into_iter().chain(EXTENSIONS.map(str::to_uppercase));
    let names: Vec<PathBuf> = match extension {
        Some(lower) if is_named => {
            let others = [lower.to_uppercase(), lower].into_iter().chain(all).map(|other| name.with_extension(other));
            std::iter::once(name.clone()).chain(others).collect()
        }
        _ => all.map(with).collect(),
    };
    let below = |folder: PathBuf| names.iter().map(|name| folder.join(name)).find(|path| path.is_file());
    let in_usual_folder = || usual_folders(dir).into_iter().find_map(below);
    if let Some(found) = names.iter().find_map(|name| find(dir, name)).or_else(in_usual_folder) {
        return Ok(found);
    }
    if let (false, Some(other)) = (is_named, find(dir, &name)) {
        let message = format!("{} is not an image in a format that is read", other.display());
        return Err(
            bad(message).hint("convert the images to PNG, JPEG, WebP or TIFF, and state their names in file_path")
        );
    }
    if is_absolute(file_path) || leaves_folder(file_path) {
        let hint = "state paths relative to the folder of the transforms file, and put the files into it";
        let what = if leaves_folder(file_path) { "points outside" } else { "is not in" };
        return Err(bad(format!("file_path {file_path} {what} the capture's folder")).hint(hint));
    }
    Ok(dir.join(&names[0]))
}

/// The file in `dir` with this path, or with the longest end of it: some writers state paths from another folder.
pub(super) fn find(dir: &Path, name: &Path) -> Option<PathBuf> {
    let parts: Vec<Component<'_>> = name.components().collect();
    let ends = (0..parts.len()).map(|first| dir.join(parts[first..].iter().collect::<PathBuf>()));
    ends.into_iter().find(|path| path.is_file())
}

/// A path from a file, without its root, `.` and `..` and with `/` for `\`. A `..` removes the folder before it.
pub(crate) fn relative(stated: &str) -> PathBuf {
    normalised(stated).0
}

/// Whether a path from a file leads out of the folder of the file by `..`.
fn leaves_folder(stated: &str) -> bool {
    normalised(stated).1
}

/// See [`relative`] and [`leaves_folder`].
fn normalised(stated: &str) -> (PathBuf, bool) {
    let (mut path, mut leaves) = (PathBuf::new(), false);
    for part in Path::new(&unified(stated)).components() {
        match part {
            Component::Normal(part) => path.push(part),
            Component::ParentDir => leaves |= !path.pop(),
            _ => (),
        }
    }
    (path, leaves)
}

fn is_absolute(stated: &str) -> bool {
    let unified = unified(stated);
    let is_drive = unified.as_bytes().get(1) == Some(&b':');
    is_drive || unified.starts_with('/')
}

fn unified(stated: &str) -> String {
    stated.replace('\\', "/")
}
