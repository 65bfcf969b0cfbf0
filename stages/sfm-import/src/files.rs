//! Access to the files and folders of a capture.

use std::path::Path;

use engine::{Failure, FailureKind};

use crate::error::{Result, bad};

/// The last component of a path.
pub(crate) fn name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The sorted names of the entries of `dir`; empty if it is not a folder.
pub(crate) fn children(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).into_iter().flatten().flatten();
    let mut names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// Reads a whole file.
pub(crate) fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|error| {
        let kind = match error.kind() {
            std::io::ErrorKind::NotFound => FailureKind::MissingData,
            _ => FailureKind::World,
        };
        Failure::new(kind, format!("cannot read the file ({error})")).at(path)
    })
}

/// Reads the width and height of an image from the file's header.
pub(crate) fn image_size(path: &Path) -> Result<(u32, u32)> {
    if !path.is_file() {
        let hint = "download the capture again, or remove the frame from the file that lists it";
        return Err(Failure::new(FailureKind::MissingData, "image file is missing").hint(hint).at(path));
    }
    image::image_dimensions(path).map_err(|error| bad(format!("image cannot be read ({error})")).at(path))
}
