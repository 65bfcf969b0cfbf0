//! `poses_bounds.npy` of LLFF (Mildenhall et al. 2019): one row of 17 numbers per camera.

use std::path::Path;

use glam::{DMat3, DVec3};
use scene::{Camera, Intrinsics, RigidTransform, npy_file};

use crate::error::{Result, bad};

/// The file name.
pub(super) const FILE: &str = "poses_bounds.npy";

/// Numbers per row: a 3×5 matrix in row-major order, then the near and the far depth of the scene.
const ROW_LENGTH: usize = 17;
/// Larger sides, in pixels, indicate a damaged file.
const MAX_SIDE: f64 = 65536.0;

/// Reads the cameras of the full-size videos, one per name; errors name the camera.
pub(super) fn read(path: &Path, names: &[&str]) -> Result<Vec<Camera>> {
    let array = npy_file::read(path).map_err(|error| bad(error.message).at(path))?;
    let [rows, ROW_LENGTH] = *array.shape.as_slice() else {
        return Err(bad(format!("the array has shape {:?} instead of [cameras, {ROW_LENGTH}]", array.shape)).at(path));
    };
    if rows != names.len() {
        let message = format!(
            "the file has poses of {rows} cameras, but there are {} cameras ({})",
            names.len(),
            names.join(", ")
        );
        let hint = "rows correspond to cameras in the order of their names: download or extract the missing cameras, or \
                    remove folders of other captures";
        return Err(bad(message).hint(hint).at(path));
    }
    let named = |(row, name): (&[f64], &&str)| {
        camera(row).map_err(|failure| bad(format!("{name}: {}", failure.message)).at(path))
    };
    array.values.chunks_exact(ROW_LENGTH).zip(names).map(named).collect()
}

/// The camera of one row, without distortion and with the principal point at the image centre.
///
/// The 3×5 matrix is [rotation | centre | (height, width, focal length in pixels)], camera to world, and the columns of
/// its rotation are the camera's down, right and backward axes: those of OpenCV (right, down, forward) are the second,
/// the first, and the third negated.
fn camera(row: &[f64]) -> Result<Camera> {
    if let Some(at) = row.iter().position(|value| !value.is_finite()) {
        return Err(bad(format!("value {at} of the row is {}", row[at])));
    }
    let column = |at: usize| DVec3::new(row[at], row[at + 5], row[at + 10]);
    let (down, right, backward, position) = (column(0), column(1), column(2), column(3));
    let [height, width, focal] = column(4).to_array();
    let [near, far] = [row[15], row[16]];
    if ![width, height].iter().all(|side| side.fract() == 0.0 && (1.0..MAX_SIDE).contains(side)) {
        return Err(bad(format!("{width}×{height} is not a valid video size")));
    }
    if !(0.0 < near && near < far) {
        return Err(bad(format!("the depth bounds {near} and {far} are not a positive range")));
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
