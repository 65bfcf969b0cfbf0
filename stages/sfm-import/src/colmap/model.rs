//! A sparse model, independent of its file format: cameras, registered images, points, and their checks.

use std::collections::BTreeMap;

use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::RigidTransform;
use scene::statistics::median;

use crate::error::{Result, bad};
use crate::lens::Lens;
use crate::source::ReprojectionError;

/// Tolerance for the norm of a pose's quaternion: above the rounding of text files.
const UNIT_TOLERANCE: f64 = 1e-3;

/// Factor between the distances of the points from two images above which the scale is lost. Captures that approach their
/// subject stay far below it; reconstructions whose scale collapsed have thousands and more.
const LOST_SCALE: f64 = 100.0;

/// Cameras, registered images and points, keyed by COLMAP's ids.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Model {
    /// Cameras, which images share.
    pub(crate) cameras: BTreeMap<u32, Lens>,
    /// Images with a pose.
    pub(crate) images: BTreeMap<u32, RegisteredImage>,
    /// The sparse cloud.
    pub(crate) points: BTreeMap<u64, Point>,
}

/// One image with its pose.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RegisteredImage {
    /// File name, relative to the folder of images.
    pub(crate) name: String,
    /// Key of [`Model::cameras`].
    pub(crate) camera_id: u32,
    /// World-to-camera rotation, a unit quaternion (w, x, y, z).
    pub(crate) quaternion: [f64; 4],
    /// World-to-camera translation.
    pub(crate) translation: [f64; 3],
    /// Detected keypoints in pixels, each with the id of its point, if it has one.
    pub(crate) observations: Vec<(DVec2, Option<u64>)>,
}

/// One triangulated point.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Point {
    /// Position in world coordinates.
    pub(crate) position: DVec3,
    /// Colour in sRGB.
    pub(crate) rgb: [u8; 3],
    /// Mean reprojection error in pixels as stored by COLMAP; negative if it was not computed.
    pub(crate) error_px: f64,
    /// Image ids, and indices into the observations of these images.
    pub(crate) track: Vec<(u32, u32)>,
}

impl Model {
    /// Checks that registered images have unit quaternions and refer to existing cameras and points.
    pub(super) fn check_images(&self) -> Result<()> {
        if self.images.is_empty() {
            let hint =
                "structure from motion failed: mask moving objects, add texture, or use poses from another source";
            return Err(bad("no image is registered").hint(hint));
        }
        for image in self.images.values() {
            let name = &image.name;
            if !self.cameras.contains_key(&image.camera_id) {
                return Err(bad(format!("image {name} refers to camera {}, which does not exist", image.camera_id))
                    .hint(MIXED_MODELS));
            }
            let norm = image.quaternion.iter().map(|value| value * value).sum::<f64>().sqrt();
            if !((norm - 1.0).abs() <= UNIT_TOLERANCE) {
                let hint =
                    "export the model again, or divide the four numbers of the quaternion (w, x, y, z) by its norm";
                let message = format!("the rotation of {name} is a quaternion of norm {norm} instead of 1");
                return Err(bad(message).hint(hint));
            }
            let dangling = |(_, id): &&(DVec2, Option<u64>)| id.is_some_and(|id| !self.points.contains_key(&id));
            if let Some((_, Some(id))) = image.observations.iter().find(dangling) {
                return Err(bad(format!("image {name} refers to point {id}, which does not exist")).hint(MIXED_MODELS));
            }
        }
        Ok(())
    }

    /// Checks that points are finite and refer to existing observations.
    pub(super) fn check_points(&self) -> Result<()> {
        for (id, point) in &self.points {
            if !point.position.as_vec3().is_finite() {
                let hint = "remove the point from the model: coordinates must be numbers below 3.4e38";
                return Err(bad(format!("point {id} has the position {}", point.position)).hint(hint));
            }
            let exists = |(image, at): &&(u32, u32)| {
                self.images.get(image).is_some_and(|image| (*at as usize) < image.observations.len())
            };
            if let Some((image, at)) = point.track.iter().find(|seen| !exists(seen)) {
                let message = format!("point {id} refers to keypoint {at} of image {image}, which does not exist");
                return Err(bad(message).hint(MIXED_MODELS));
            }
        }
        Ok(())
    }

    /// The factor by which the distance of the points differs between images, if it is so large that the model has lost its
    /// scale. Structure from motion does so where a camera only turns between parts of a video: the parts then differ in size,
    /// although all points reproject to their keypoints. The distance of an image is the median depth of its points.
    pub(crate) fn lost_scale(&self) -> Option<f64> {
        let distance = |image: &RegisteredImage| {
            let pose = image.camera_from_world();
            let points = image.observations.iter().filter_map(|(_, id)| self.points.get(&(*id)?));
            median(points.map(|point| pose.apply(point.position).z.abs()))
        };
        let distances: Vec<f64> = self.images.values().filter_map(distance).collect();
        let nearest = distances.iter().copied().min_by(f64::total_cmp)?;
        let factor = distances.into_iter().max_by(f64::total_cmp)? / nearest;
        (factor > LOST_SCALE).then_some(factor)
    }

    /// The mean reprojection error of all tracks; `None` if no point has both a track and a stored error.
    pub(crate) fn reprojection_error(&self) -> Option<ReprojectionError> {
        let (mut recomputed, mut stored, mut count) = (0.0, 0.0, 0.0);
        for point in self.points.values().filter(|point| !point.track.is_empty() && point.error_px >= 0.0) {
            let distances = point.track.iter().map(|(image, at)| {
                let image = &self.images[image];
                let view = image.camera_from_world().apply(point.position);
                self.cameras[&image.camera_id]
                    .pixel(view.truncate() / view.z)
                    .distance(image.observations[*at as usize].0)
            });
            recomputed += distances.sum::<f64>() / point.track.len() as f64;
            stored += point.error_px;
            count += 1.0;
        }
        (count > 0.0).then(|| ReprojectionError { recomputed_px: recomputed / count, stored_px: stored / count })
    }
}

/// Hint for ids that do not exist.
const MIXED_MODELS: &str = "check that the three files belong to the same model";

impl RegisteredImage {
    /// The pose as a rigid transform.
    pub(crate) fn camera_from_world(&self) -> RigidTransform {
        let [w, x, y, z] = self.quaternion;
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        RigidTransform { rotation, translation: DVec3::from(self.translation) }
    }
}
