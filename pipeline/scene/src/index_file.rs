//! Folders of per-view files: the JSON index that describes them, and the rules that the files keep.

use std::path::{Component, Path};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::image_file::{self, read_file, write_file};
use crate::{Error, Intrinsics, Result, exr_file};

/// Reads the index at `path`; `what` it describes is named in errors.
pub fn read<T: DeserializeOwned>(path: &Path, what: &str) -> Result<T> {
    let bytes = read_file(path).map_err(|error| error.hint(format!("is this the folder of {what}?")))?;
    serde_json::from_slice(&bytes)
        .map_err(|error| Error::new(format!("not a valid index of {what} ({error})")).at(path))
}

/// Writes an index; equal values give equal bytes.
pub fn write<T: Serialize>(path: &Path, what: &str, index: &T) -> Result<()> {
    let json = serde_json::to_string_pretty(index);
    let json = json.map_err(|error| Error::new(format!("cannot write the index of {what} ({error})")).at(path))?;
    write_file(path, format!("{json}\n").as_bytes())
}

/// The files of one view: below one folder, and of the view's size.
#[derive(Clone, Copy, Debug)]
pub struct ViewFiles<'a> {
    /// The folder that paths are relative to.
    pub dir: &'a Path,
    /// Pixels per row and rows that every file has.
    pub size: (u32, u32),
}

impl<'a> ViewFiles<'a> {
    /// Files below `dir` of the size that a camera's images have.
    pub fn of(dir: &'a Path, intrinsics: &Intrinsics) -> Self {
        Self { dir, size: (intrinsics.width, intrinsics.height) }
    }

    /// An 8-bit image with the right size (only its header is read).
    pub fn check_image(&self, file: &Path) -> Result<()> {
        check_inside(file)?;
        self.check_size(file, image_file::read_size(&self.dir.join(file))?)
    }

    /// An EXR file with the right size and, for every list of names, one channel called so (only its header is read).
    pub fn check_floats(&self, file: &Path, channels: &[&[&str]]) -> Result<()> {
        check_inside(file)?;
        let header = exr_file::read_header(&self.dir.join(file))?;
        self.check_size(file, (header.width, header.height))?;
        let present = |names: &[&str]| names.iter().any(|name| header.channels.iter().any(|have| have == name));
        match channels.iter().find(|names| !present(names)) {
            None => Ok(()),
            Some(missing) => {
                let message = format!("channels {:?} where {} is needed", header.channels, missing.join(" or "));
                Err(Error::new(message).at(self.dir.join(file)))
            }
        }
    }

    /// Reads a file, where there is one, and checks the size of what was in it.
    pub fn load<T>(
        &self,
        file: Option<&Path>,
        read: impl Fn(&Path) -> Result<T>,
        size: impl Fn(&T) -> (u32, u32),
    ) -> Result<Option<T>> {
        let Some(file) = file else { return Ok(None) };
        let value = read(&self.dir.join(file))?;
        self.check_size(file, size(&value))?;
        Ok(Some(value))
    }

    /// Whether `file` has this view's size.
    pub fn check_size(&self, file: &Path, (width, height): (u32, u32)) -> Result<()> {
        if (width, height) == self.size {
            return Ok(());
        }
        let message = format!("{width}×{height} pixels where the camera has {}×{}", self.size.0, self.size.1);
        Err(Error::new(message).at(self.dir.join(file)))
    }
}

/// The files of a folder lie in it, so that it can be moved and hashed.
fn check_inside(file: &Path) -> Result<()> {
    let inside = file.components().all(|part| matches!(part, Component::Normal(_)));
    if inside { Ok(()) } else { Err(Error::new("the path leads out of the folder").at(file)) }
}

/// Creates a folder and those above it.
pub fn create_dir(dir: &Path) -> Result<()> {
    std::fs::create_dir_all(dir).map_err(|error| Error::new("cannot create the folder").at(dir).because_of(error))
}
