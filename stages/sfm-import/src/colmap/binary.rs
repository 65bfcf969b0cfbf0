//! Readers of the little-endian binary files.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::Path;

use glam::{DVec2, DVec3};

use crate::colmap::camera_model::{CAMERA_MODELS, lens};
use crate::colmap::model::{Point, RegisteredImage};
use crate::error::{Result, bad};
use crate::files::read_bytes;
use crate::lens::Lens;

/// Bytes of an image without a name and keypoints in `images.bin`.
const IMAGE_BYTES: u64 = 73;
/// The point id of a keypoint without a point.
const NO_POINT: u64 = u64::MAX;

/// Reads `cameras.bin`: count, then per camera id, model, width, height, parameters.
pub(super) fn cameras(path: &Path) -> Result<BTreeMap<u32, Lens>> {
    records(path, |file| {
        let (id, model) = (file.u32()?, file.u32()?);
        let (width, height) = (file.u64()?, file.u64()?);
        let Some((name, count)) = CAMERA_MODELS.get(model as usize) else {
            return Err(bad(format!("camera model number {model} is unknown")).hint("the file may be damaged"));
        };
        let params = (0..*count).map(|_| file.f64()).collect::<Result<Vec<_>>>()?;
        Ok((id, lens(name, width, height, &params)?))
    })
}

/// Reads `images.bin`: count, then per image id, quaternion (w, x, y, z), translation, camera id, name, keypoints.
pub(super) fn images(path: &Path) -> Result<BTreeMap<u32, RegisteredImage>> {
    records(path, |file| {
        let id = file.u32()?;
        let quaternion = [file.f64()?, file.f64()?, file.f64()?, file.f64()?];
        let translation = [file.f64()?, file.f64()?, file.f64()?];
        let camera_id = file.u32()?;
        let name = file.name()?;
        let mut observations = Vec::new();
        for _ in 0..file.u64()? {
            let pixel = DVec2::new(file.f64()?, file.f64()?);
            let point = file.u64()?;
            observations.push((pixel, (point != NO_POINT).then_some(point)));
        }
        Ok((id, RegisteredImage { name, camera_id, quaternion, translation, observations }))
    })
}

/// The number of images at the start of `images.bin`; 0 if the file cannot be read, or is too short for that number.
pub(super) fn image_count(path: &Path) -> usize {
    let mut count = [0; 8];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut count).and_then(|()| file.metadata()));
    let (count, length) = (u64::from_le_bytes(count), read.map_or(0, |metadata| metadata.len()));
    if count <= length / IMAGE_BYTES { count as usize } else { 0 }
}

/// Reads `points3D.bin`: count, then per point id, position, colour, error, track.
pub(super) fn points(path: &Path) -> Result<BTreeMap<u64, Point>> {
    records(path, |file| {
        let id = file.u64()?;
        let position = DVec3::new(file.f64()?, file.f64()?, file.f64()?);
        let rgb = file.array()?;
        let error_px = file.f64()?;
        let mut track = Vec::new();
        for _ in 0..file.u64()? {
            track.push((file.u32()?, file.u32()?));
        }
        Ok((id, Point { position, rgb, error_px, track }))
    })
}

/// Reads a count and that many keyed records; trailing bytes are an error.
fn records<K: Ord + std::fmt::Display + Copy, V>(
    path: &Path,
    mut read: impl FnMut(&mut Cursor) -> Result<(K, V)>,
) -> Result<BTreeMap<K, V>> {
    let bytes = read_bytes(path)?;
    let mut file = Cursor { rest: &bytes };
    let count = file.u64().map_err(|failure| failure.at(path))?;
    let mut records = BTreeMap::new();
    for index in 0..count {
        let (key, value) = read(&mut file).map_err(|mut failure| {
            failure.message = format!("record {} of {count}: {}", index + 1, failure.message);
            failure.at(path)
        })?;
        if records.insert(key, value).is_some() {
            return Err(bad(format!("id {key} occurs twice")).at(path));
        }
    }
    match file.rest.len() {
        0 => Ok(records),
        left => Err(bad(format!("{left} unexpected bytes after the last of {count} records")).hint(DAMAGED).at(path)),
    }
}

/// Hint for files of the wrong length.
const DAMAGED: &str = "the file is truncated or damaged: copy it again";

struct Cursor<'a> {
    rest: &'a [u8],
}

impl Cursor<'_> {
    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let Some((head, rest)) = self.rest.split_first_chunk::<N>() else {
            return Err(bad("the file ends inside of this record").hint(DAMAGED));
        };
        self.rest = rest;
        Ok(*head)
    }

    fn u32(&mut self) -> Result<u32> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn u64(&mut self) -> Result<u64> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn f64(&mut self) -> Result<f64> {
        Ok(f64::from_le_bytes(self.array()?))
    }

    /// Reads a zero-terminated name.
    fn name(&mut self) -> Result<String> {
        let Some(end) = self.rest.iter().position(|byte| *byte == 0) else {
            return Err(bad("the file ends inside a name").hint(DAMAGED));
        };
        let name =
            std::str::from_utf8(&self.rest[..end]).map_err(|_| bad("the image name is not UTF-8").hint(DAMAGED))?;
        let name = name.to_owned();
        self.rest = &self.rest[end + 1..];
        Ok(name)
    }
}
