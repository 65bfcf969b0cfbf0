//! The points of the COLMAP model from which the poses of another file come.

use std::collections::BTreeMap;
use std::path::Path;

use scene::RigidTransform;

use crate::cloud_file::Points;
use crate::colmap::read_model;
use crate::error::Result;
use crate::files::name;
use crate::source::Frame;

/// Largest difference of two transforms from the model to the frames, relative to the distance of a camera from the origin: files
/// have at least six digits.
const SAME_POSE: f64 = 1e-3;

/// The points of the model in `sparse`, in the world of the `frames`, whose images have the names in the model. First versions of
/// nerfstudio turned the world without stating it; the poses of both show the turn.
pub(crate) fn points(sparse: &Path, frames: &[Frame], warnings: &mut Vec<String>) -> Result<Points> {
    let model = read_model(sparse)?;
    let images = model.images.values().map(|image| (name(Path::new(&image.name)), image));
    let images: BTreeMap<String, _> = images.collect();
    let turn_of = |frame: &Frame| {
        let image = images.get(&name(&frame.image))?;
        let (world, camera) = (frame.camera_from_world.inverse(), image.camera_from_world());
        let (rotation, translation) = (world.rotation * camera.rotation, world.apply(camera.translation));
        Some(RigidTransform { rotation, translation })
    };
    let turns: Vec<(&Frame, RigidTransform)> =
        frames.iter().filter_map(|frame| Some((frame, turn_of(frame)?))).collect();
    let Some((_, turn)) = turns.first() else { return Ok(Points::new()) };
    let is_same = |(frame, other): &(&Frame, RigidTransform)| {
        let tolerance = SAME_POSE * (1.0 + frame.camera_from_world.translation.length());
        other.rotation.abs_diff_eq(turn.rotation, SAME_POSE)
            && other.translation.abs_diff_eq(turn.translation, tolerance)
    };
    if !turns.iter().all(is_same) {
        warnings.push(format!(
            "the points of the model in {} are not used, because its poses are not those of the frames: they were refined, or \
             scaled; export the cloud, and name it by ply_file_path",
            sparse.display()
        ));
        return Ok(Points::new());
    }
    Ok(model.points.values().map(|point| (turn.apply(point.position).to_array(), point.rgb)).collect())
}
