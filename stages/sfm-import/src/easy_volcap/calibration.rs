//! The lenses of `intri.yml` and the poses of `extri.yml`.

use std::path::Path;

use glam::{DMat3, DVec3};
use scene::{Intrinsics, RigidTransform};

use super::file_storage::{FileStorage, Matrix};
use crate::error::{Result, bad};
use crate::lens::{Distortion, Lens};

/// Largest skew in pixels that is treated as zero.
const MAX_SKEW_PX: f64 = 1e-3;
/// Largest difference between the elements of a rotation matrix and those of its Rodrigues vector: above the rounding of
/// six printed digits.
const ROTATION_TOLERANCE: f64 = 1e-4;

/// A camera as described by the two files.
pub(super) struct Calibrated {
    pub(super) name: String,
    /// The image size, if stated.
    pub(super) size: Option<(u32, u32)>,
    pub(super) camera_from_world: RigidTransform,
    matrix: [f64; 9],
    distortion: Distortion,
}

impl Calibrated {
    /// The lens for images of this size, which must match the matrix.
    pub(super) fn lens(&self, (width, height): (u32, u32)) -> Lens {
        let [focal_x, _, center_x, _, focal_y, center_y, ..] = self.matrix;
        let intrinsics = Intrinsics { width, height, focal_x, focal_y, center_x, center_y };
        Lens { intrinsics, distortion: self.distortion }
    }
}

/// Reads the cameras in the order of `names`, or of the keys if there is no such list. Also returns oddities.
pub(super) fn read(folder: &Path) -> Result<(Vec<Calibrated>, Vec<String>)> {
    let [intri, extri] = ["intri.yml", "extri.yml"].map(|name| folder.join(name));
    let (lenses, poses) = (FileStorage::read(&intri)?, FileStorage::read(&extri)?);
    let keyed = || lenses.keys().filter_map(|key| key.strip_prefix("K_")).map(str::to_owned).collect();
    let names: Vec<String> = lenses.names("names").unwrap_or_else(keyed);
    if names.is_empty() {
        return Err(bad("the file names no camera").hint("it needs `names`, and K_NAME for each of them").at(intri));
    }
    let camera = |name: &String| -> Result<Calibrated> {
        let camera_from_world = pose(&poses, name).map_err(|failure| failure.at(&extri))?;
        lens(&lenses, name, camera_from_world).map_err(|failure| failure.at(&intri))
    };
    let cameras = names.iter().map(camera).collect::<Result<Vec<_>>>()?;
    Ok((cameras, oddities(&lenses, &names)?))
}

/// The matrix of a key with that many values, if the file has it.
fn sized(file: &FileStorage, key: &str, count: usize) -> Result<Option<Matrix>> {
    let Some(matrix) = file.matrix(key)? else { return Ok(None) };
    let [rows, cols] = matrix.shape;
    if rows * cols == count {
        Ok(Some(matrix))
    } else {
        Err(bad(format!("{key} is {rows}×{cols}, not of {count} values")))
    }
}

/// World to camera: `Rot` as a matrix or `R` as a Rodrigues vector, and the translation `T`.
fn pose(poses: &FileStorage, name: &str) -> Result<RigidTransform> {
    let lacking = |key: &str| bad(format!("{key}_{name} is missing: camera {name} has no pose"));
    let translation = sized(poses, &format!("T_{name}"), 3)?.ok_or_else(|| lacking("T"))?;
    let matrix =
        sized(poses, &format!("Rot_{name}"), 9)?.map(|found| DMat3::from_cols_slice(&found.values).transpose());
    let vector = sized(poses, &format!("R_{name}"), 3)?.map(|found| rodrigues(DVec3::from_slice(&found.values)));
    if let (Some(matrix), Some(vector)) = (matrix, vector)
        && !(matrix - vector).to_cols_array().iter().all(|value| value.abs() <= ROTATION_TOLERANCE)
    {
        let hint = "one of them is out of date: remove it, or calibrate again";
        return Err(bad(format!("Rot_{name} and R_{name} are different rotations")).hint(hint));
    }
    let rotation = matrix.or(vector).ok_or_else(|| lacking("Rot"))?;
    Ok(RigidTransform { rotation, translation: DVec3::from_slice(&translation.values) })
}

/// The rotation by |v| radians about v.
fn rodrigues(vector: DVec3) -> DMat3 {
    match vector.try_normalize() {
        Some(axis) => DMat3::from_axis_angle(axis, vector.length()),
        None => DMat3::IDENTITY,
    }
}

fn lens(lenses: &FileStorage, name: &str, camera_from_world: RigidTransform) -> Result<Calibrated> {
    let matrix = sized(lenses, &format!("K_{name}"), 9)?;
    let matrix = matrix.ok_or_else(|| bad(format!("K_{name} is missing: camera {name} has no lens")))?;
    let matrix: [f64; 9] = matrix.values.try_into().map_err(|_| bad(format!("K_{name} is not 3×3")))?;
    if !(matrix[1].abs() <= MAX_SKEW_PX) {
        return Err(bad(format!("K_{name} has a skew of {} px, but skew is not supported", matrix[1])));
    }
    let coefficients = match lenses.matrix(&format!("D_{name}"))? {
        Some(found) => Some(found),
        None => lenses.matrix(&format!("dist_{name}"))?,
    };
    let distortion = distortion(&coefficients.map(|found| found.values).unwrap_or_default())
        .ok_or_else(|| bad(format!("D_{name} has a distortion beyond k1 k2 p1 p2 k3 k4 k5 k6")))?;
    let side = |key: &str| -> Result<Option<u32>> {
        let stated = lenses.number(&format!("{key}_{name}"))?;
        // EasyVolcap writes -1 for a size that it does not know.
        Ok(stated.filter(|side| *side > 0.0).map(|side| side.round() as u32))
    };
    let size = side("W")?.zip(side("H")?);
    Ok(Calibrated { name: name.into(), size, camera_from_world, matrix, distortion })
}

/// OpenCV's coefficients k1 k2 p1 p2 [k3 [k4 k5 k6]]; `None` if further ones are not zero.
fn distortion(coefficients: &[f64]) -> Option<Distortion> {
    let at = |index: usize| coefficients.get(index).copied().unwrap_or(0.0);
    let (radial, tangential) = ([at(0), at(1), at(4)], [at(2), at(3)]);
    coefficients.iter().skip(8).all(|value| *value == 0.0).then(|| match [at(5), at(6), at(7)] {
        [0.0, 0.0, 0.0] => Distortion::brown([radial[0], radial[1], radial[2], 0.0], tangential),
        denominator => Distortion::rational(radial, denominator, tangential),
    })
}

/// Entries that change images or times, and that this stage does not apply.
fn oddities(lenses: &FileStorage, names: &[String]) -> Result<Vec<String>> {
    let identity = DMat3::IDENTITY.to_cols_array();
    for name in names {
        let correction = lenses.matrix(&format!("ccm_{name}"))?;
        if correction.is_some_and(|found| found.values != identity) {
            return Ok(vec![format!("the colour correction of camera {name} (ccm_{name}) and others is not applied")]);
        }
    }
    Ok(Vec::new())
}
