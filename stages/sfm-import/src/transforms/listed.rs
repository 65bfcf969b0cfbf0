//! The frames that transforms files list, and the paths in these files.

use std::path::{Component, Path, PathBuf};

use scene::Split;

use super::document::{StatedFrame, TransformsFile};
use crate::error::{Result, bad};
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

impl ListedFrame<'_> {
    /// Whether the image was found by the end of its path only.
    pub(super) fn is_moved(&self, dir: &Path) -> bool {
        let stated = relative(&self.stated.file_path).unwrap_or_default();
        let found = self.image.strip_prefix(dir).unwrap_or(&self.image);
        found.components().count() < stated.components().count()
    }
}

/// The image that a `file_path` names, with or without its extension, as [`find`] finds it. A missing image has the stated
/// path.
pub(crate) fn image_path(dir: &Path, file_path: &str) -> Result<PathBuf> {
    let name = relative(file_path)?;
    if name.as_os_str().is_empty() {
        return Err(bad("a frame has an empty file_path").hint("name its image, or remove the frame"));
    }
    let extension = name.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    let is_named = extension.is_some_and(|extension| EXTENSIONS.contains(&extension.as_str()));
    let with = |extension: &str| PathBuf::from(format!("{}.{extension}", name.display()));
    let names: Vec<PathBuf> = if is_named { vec![name] } else { EXTENSIONS.map(with).into() };
    if let Some(found) = names.iter().find_map(|name| find(dir, name)) {
        return Ok(found);
    }
    if is_absolute(file_path) {
        let hint = "state paths relative to the folder of the transforms file, and put the files into it";
        return Err(bad(format!("file_path {file_path} is not in the capture's folder")).hint(hint));
    }
    Ok(dir.join(&names[0]))
}

/// The file in `dir` with this path, or with the longest end of it: some writers state paths from another folder.
pub(super) fn find(dir: &Path, name: &Path) -> Option<PathBuf> {
    let parts: Vec<Component<'_>> = name.components().collect();
    let ends = (0..parts.len()).map(|first| dir.join(parts[first..].iter().collect::<PathBuf>()));
    ends.into_iter().find(|path| path.is_file())
}

/// A path from a file, without its root and `.` parts and with `/` for `\`. A path with `..` is an error.
pub(crate) fn relative(stated: &str) -> Result<PathBuf> {
    let unified = unified(stated);
    let parts = || Path::new(&unified).components();
    if parts().any(|part| part == Component::ParentDir) {
        let hint = "state paths relative to the folder of the transforms file, and put the files into it";
        return Err(bad(format!("file_path {stated} points outside the capture's folder")).hint(hint));
    }
    Ok(parts().filter(|part| matches!(part, Component::Normal(_))).collect())
}

fn is_absolute(stated: &str) -> bool {
    let unified = unified(stated);
    let is_drive = unified.as_bytes().get(1) == Some(&b':');
    is_drive || unified.starts_with('/')
}

fn unified(stated: &str) -> String {
    stated.replace('\\', "/")
}
