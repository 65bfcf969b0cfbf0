//! `poses_bounds.npy` of LLFF (Mildenhall et al. 2019): one row of 17 numbers per camera.

use std::path::Path;

use glam::{DMat3, DVec3};
use scene::{Camera, Intrinsics, RigidTransform, npy_file};

use crate::error::{Result, about, bad, invalid};
use crate::image_names::natural_order;

/// The file name.
pub(crate) const FILE: &str = "poses_bounds.npy";

/// Numbers per row: a 3×5 matrix in row-major order, then the near and the far depth of the scene.
const ROW_LENGTH: usize = 17;
/// Larger sides, in pixels, indicate a damaged file.
const MAX_SIDE: f64 = 65536.0;

/// A row of the file.
pub(crate) struct Stated {
    /// The camera of the full-size image, without distortion and with the principal point at the image centre.
    pub(crate) camera: Camera,
    /// The depth of the nearest and of the farthest point; `None` if the file states zeros.
    pub(crate) depth_view: Option<[f64; 2]>,
}

/// Reads the rows, one per name; errors name the camera.
pub(crate) fn read(path: &Path, names: &[String]) -> Result<Vec<Stated>> {
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
    let named = |(row, name): (&[f64], &String)| stated(row).map_err(|failure| about(name, failure).at(path));
    array.values.chunks_exact(ROW_LENGTH).zip(names).map(named).collect()
}

/// A warning if the order of the names depends on whether numbers are compared by value: LLFF sorts names as text, e.g.
/// `cam10` before `cam2`, and rows have this order.
pub(crate) fn order_warning(names: &[String]) -> Option<String> {
    let at = names.windows(2).position(|pair| natural_order(&pair[0], &pair[1]).is_gt())?;
    let [first, second] = [&names[at], &names[at + 1]];
    Some(format!(
        "rows of {FILE} are in the order of names as text: {first} comes before {second}, as in LLFF's loaders"
    ))
}

/// The contents of one row.
///
/// The 3×5 matrix is [rotation | centre | (height, width, focal length in pixels)], camera to world, and the columns of
/// its rotation are the camera's down, right and backward axes: those of OpenCV (right, down, forward) are the second,
/// the first, and the third negated.
fn stated(row: &[f64]) -> Result<Stated> {
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
    let has_bounds = [near, far] != [0.0, 0.0];
    if has_bounds && !(0.0 < near && near < far) {
        return Err(bad(format!("the depth bounds {near} and {far} are not a positive range")));
    }
    let world_from_camera =
        RigidTransform { rotation: DMat3::from_cols(right, down, -backward), translation: position };
    let (center_x, center_y) = (0.5 * width, 0.5 * height);
    let (width, height) = (width as u32, height as u32);
    let intrinsics = Intrinsics { width, height, focal_x: focal, focal_y: focal, center_x, center_y };
    let camera = Camera { intrinsics, camera_from_world: world_from_camera.inverse() };
    camera.check().map_err(invalid)?;
    Ok(Stated { camera, depth_view: has_bounds.then_some([near, far]) })
}

/// The integer factor by which images of this size are smaller than those that the poses describe. Returns 1 if the sizes
/// are not in such a ratio; each image is then reported for its size.
pub(crate) fn reduction(image: (u32, u32), camera: &Camera) -> u32 {
    let full = camera.intrinsics;
    let factor = (f64::from(full.width) / f64::from(image.0)).round().max(1.0) as u32;
    let is_fraction = side(full.width, factor) == image.0 && side(full.height, factor) == image.1;
    if is_fraction { factor } else { 1 }
}

/// The camera of images at 1/`factor` of the size.
pub(crate) fn reduced(camera: &Camera, factor: u32) -> Camera {
    let full = camera.intrinsics;
    camera.resized(side(full.width, factor), side(full.height, factor))
}

fn side(full: u32, factor: u32) -> u32 {
    (f64::from(full) / f64::from(factor)).round() as u32
}
