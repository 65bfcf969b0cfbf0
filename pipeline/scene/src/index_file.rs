//! Folders of per-view files: their JSON index, and checks of the files that it names.

use std::path::{Component, Path};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::image_file::{self, read_file, write_file};
use crate::{Error, Intrinsics, Result, exr_file};

/// Reads the index at `path`; errors name `what` it describes.
pub fn read<T: DeserializeOwned>(path: &Path, what: &str) -> Result<T> {
    let bytes = read_file(path).map_err(|error| error.hint(format!("is this a folder with {what}?")))?;
    serde_json::from_slice(&bytes)
        .map_err(|error| Error::new(format!("not a valid index of {what} ({error})")).at(path))
}

/// Writes an index as JSON; equal values give equal bytes. Errors name `what` it describes.
pub fn write<T: Serialize>(path: &Path, what: &str, index: &T) -> Result<()> {
    let json = serde_json::to_string_pretty(index);
    let json = json.map_err(|error| Error::new(format!("cannot write the index of {what} ({error})")).at(path))?;
    write_file(path, format!("{json}\n").as_bytes())
}

/// Access to the files of one view, which lie below one folder and have the size of the view.
#[derive(Clone, Copy, Debug)]
pub struct ViewFiles<'a> {
    /// The folder that paths are relative to.
    pub dir: &'a Path,
    /// Width and height that every file must have.
    pub size: (u32, u32),
}

impl<'a> ViewFiles<'a> {
    /// Access to files below `dir` that have the image size of a camera.
    pub fn of(dir: &'a Path, intrinsics: &Intrinsics) -> Self {
        Self { dir, size: (intrinsics.width, intrinsics.height) }
    }

    /// Checks that an 8-bit image lies below the folder and has the right size. Reads the header only.
    pub fn check_image(&self, file: &Path) -> Result<()> {
        check_inside(file)?;
        self.check_size(file, image_file::read_size(&self.dir.join(file))?)
    }

    /// Checks that an EXR file lies below the folder, has the right size and, for every list of alternative names, one
    /// channel. Reads the header only.
    pub fn check_floats(&self, file: &Path, channels: &[&[&str]]) -> Result<()> {
        check_inside(file)?;
        let header = exr_file::read_header(&self.dir.join(file))?;
        self.check_size(file, (header.width, header.height))?;
        let present = |names: &[&str]| names.iter().any(|name| header.channels.iter().any(|have| have == name));
        match channels.iter().find(|names| !present(names)) {
            None => Ok(()),
            Some(missing) => {
                let message = format!("channels {:?}, but {} is required", header.channels, missing.join(" or "));
                Err(Error::new(message).at(self.dir.join(file)))
            }
        }
    }

    /// Reads a file, if given, and checks the size of its content.
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

    /// Checks that the content of `file` has the size of the view.
    pub fn check_size(&self, file: &Path, (width, height): (u32, u32)) -> Result<()> {
        if (width, height) == self.size {
            return Ok(());
        }
        let message = format!("{width}×{height} pixels, but the camera has {}×{}", self.size.0, self.size.1);
        Err(Error::new(message).at(self.dir.join(file)))
    }
}

/// Checks that a file lies below its folder, so that the folder can be moved and hashed.
fn check_inside(file: &Path) -> Result<()> {
    let inside = file.components().all(|part| matches!(part, Component::Normal(_)));
    if inside { Ok(()) } else { Err(Error::new("the path leads outside the folder").at(file)) }
}

/// Creates a folder and its missing parents.
pub fn create_dir(dir: &Path) -> Result<()> {
    std::fs::create_dir_all(dir).map_err(|error| Error::new("cannot create the folder").at(dir).because_of(error))
}
