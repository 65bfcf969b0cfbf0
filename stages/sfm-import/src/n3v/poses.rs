//! `poses_bounds.npy` of LLFF (Mildenhall et al. 2019): one row of 17 numbers per camera.

use std::path::Path;

use glam::{DMat3, DVec3};
use scene::{Camera, Intrinsics, RigidTransform, npy_file};

use crate::source::{Result, bad};

/// The file's name.
pub const FILE: &str = "poses_bounds.npy";

/// Numbers per row: a 3×5 matrix row by row, then the depths between which the scene lies.
const ROW_LENGTH: usize = 17;
/// Pixels per side that no video has; a larger number is damage.
const MAX_SIDE: f64 = 65536.0;

/// The cameras of the videos at full size, one for each of `names`; an error names the camera it is about.
pub fn read(path: &Path, names: &[&str]) -> Result<Vec<Camera>> {
    let array = npy_file::read(path).map_err(|error| bad(error.message).at(path))?;
    let [rows, ROW_LENGTH] = *array.shape.as_slice() else {
        return Err(bad(format!("shape {:?} where [cameras, {ROW_LENGTH}] is expected", array.shape)).at(path));
    };
    if rows != names.len() {
        let message = format!("poses of {rows} cameras beside {} cameras ({})", names.len(), names.join(", "));
        let hint = "rows pair with cameras in the order of names, so that every camera must be there: download or \
                    extract the missing ones, or remove the folders that are not of this capture";
        return Err(bad(message).hint(hint).at(path));
    }
    let named = |(row, name): (&[f64], &&str)| {
        camera(row).map_err(|failure| bad(format!("{name}: {}", failure.message)).at(path))
    };
    array.values.chunks_exact(ROW_LENGTH).zip(names).map(named).collect()
}

/// The camera of one row; the principal point is the image's centre, and nothing is distorted.
///
/// The 3×5 matrix is [rotation | centre | (height, width, focal length in pixels)], camera to world, and the columns of
/// its rotation are the camera's down, right and backward axes: those of OpenCV (right, down, forward) are the second,
/// the first, and the third negated.
fn camera(row: &[f64]) -> Result<Camera> {
    if let Some(at) = row.iter().position(|value| !value.is_finite()) {
        return Err(bad(format!("number {at} of the row is {}", row[at])));
    }
    let column = |at: usize| DVec3::new(row[at], row[at + 5], row[at + 10]);
    let (down, right, backward, position) = (column(0), column(1), column(2), column(3));
    let [height, width, focal] = column(4).to_array();
    let [near, far] = [row[15], row[16]];
    if ![width, height].iter().all(|side| side.fract() == 0.0 && (1.0..MAX_SIDE).contains(side)) {
        return Err(bad(format!("{width}×{height} is no size of a video")));
    }
    if !(0.0 < near && near < far) {
        return Err(bad(format!("no scene lies between the depths {near} and {far}")));
    }
    let world_from_camera =
        RigidTransform { rotation: DMat3::from_cols(right, down, -backward), translation: position };
    let (center_x, center_y) = (0.5 * width, 0.5 * height);
    let (width, height) = (width as u32, height as u32);
    let intrinsics = Intrinsics { width, height, focal_x: focal, focal_y: focal, center_x, center_y };
    let camera = Camera { intrinsics, camera_from_world: world_from_camera.inverse() };
    camera.check().map_err(|error| bad(error.message))?;
    Ok(camera)
}
