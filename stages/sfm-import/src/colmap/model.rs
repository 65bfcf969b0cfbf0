//! What a sparse model says, whichever way it is written.

use std::collections::BTreeMap;
use std::path::Path;

use engine::{Failure, FailureKind};
use glam::{DMat3, DQuat, DVec2, DVec3};
use scene::{Intrinsics, RigidTransform};
use serde::Serialize;

use crate::colmap::{binary, text};
use crate::lens::{Distortion, Lens};
use crate::source::{Result, bad};

/// Names and parameter counts of COLMAP's camera models; the position is the number in binary files.
pub const CAMERA_MODELS: [(&str, usize); 11] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
];

/// How far the norm of a pose's quaternion may be from 1: above the rounding of text files.
const UNIT_TOLERANCE: f64 = 1e-3;

/// Cameras, registered images and points by COLMAP's ids.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    /// Shared intrinsics.
    pub cameras: BTreeMap<u32, Lens>,
    /// Images that have a pose.
    pub images: BTreeMap<u32, RegisteredImage>,
    /// The sparse cloud.
    pub points: BTreeMap<u64, Point>,
}

/// One image with its pose.
#[derive(Clone, Debug, PartialEq)]
pub struct RegisteredImage {
    /// File name relative to the images' folder.
    pub name: String,
    /// Key of [`Model::cameras`].
    pub camera_id: u32,
    /// World-to-camera rotation (w, x, y, z), of unit length.
    pub quaternion: [f64; 4],
    /// World-to-camera translation.
    pub translation: [f64; 3],
    /// Detected keypoints in pixels, with the id of the point that they see.
    pub observations: Vec<(DVec2, Option<u64>)>,
}

/// One triangulated point.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// World.
    pub position: DVec3,
    /// sRGB.
    pub rgb: [u8; 3],
    /// Mean reprojection error in pixels as COLMAP stored it; negative where it did not compute one.
    pub error_px: f64,
    /// Image ids and positions in their observations.
    pub track: Vec<(u32, u32)>,
}

/// More pixels than images have in a row.
const MOST_ERROR_PX: f64 = 1e6;

/// Reprojection error in pixels, recomputed from poses and observations, beside what COLMAP stored.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ReprojectionError {
    /// Mean over points of the mean distance over their tracks.
    pub recomputed_px: f64,
    /// Mean over points of the stored error.
    pub stored_px: f64,
}

impl ReprojectionError {
    /// Whether images could have such an error: beyond their sizes it measures nothing.
    pub fn is_of_images(&self) -> bool {
        self.recomputed_px < MOST_ERROR_PX
    }
}

impl Model {
    /// Reads `cameras`, `images` and `points3D` in `sparse_dir`, binary where `cameras.bin` exists, else text; refuses
    /// a model without registered images or with ids that lead nowhere.
    pub fn read(sparse_dir: &Path) -> Result<Self> {
        let binary = sparse_dir.join("cameras.bin").is_file();
        let path = |name: &str| sparse_dir.join(format!("{name}.{}", if binary { "bin" } else { "txt" }));
        let (cameras, images, points) = (path("cameras"), path("images"), path("points3D"));
        let model = if binary {
            Self {
                cameras: binary::cameras(&cameras)?,
                images: binary::images(&images)?,
                points: binary::points(&points)?,
            }
        } else {
            Self { cameras: text::cameras(&cameras)?, images: text::images(&images)?, points: text::points(&points)? }
        };
        model.check_images().map_err(|failure| failure.at(images))?;
        model.check_points().map_err(|failure| failure.at(points))?;
        Ok(model)
    }

    /// Registered images have cameras, unit quaternions and points that exist.
    fn check_images(&self) -> Result<()> {
        if self.images.is_empty() {
            let hint = "structure from motion found no pose: mask moving objects, add texture, or use other poses";
            return Err(bad("no image is registered").hint(hint));
        }
        for image in self.images.values() {
            let name = &image.name;
            if !self.cameras.contains_key(&image.camera_id) {
                return Err(bad(format!("image {name} has camera {}, which does not exist", image.camera_id)));
            }
            let norm = image.quaternion.iter().map(|value| value * value).sum::<f64>().sqrt();
            if !((norm - 1.0).abs() <= UNIT_TOLERANCE) {
                return Err(bad(format!("the rotation of {name} is a quaternion of length {norm} instead of 1")));
            }
            let dangling = |(_, id): &&(DVec2, Option<u64>)| id.is_some_and(|id| !self.points.contains_key(&id));
            if let Some((_, Some(id))) = image.observations.iter().find(dangling) {
                return Err(bad(format!("image {name} sees point {id}, which does not exist")).hint(MIXED_MODELS));
            }
        }
        Ok(())
    }

    /// Points are finite and seen by observations that exist.
    fn check_points(&self) -> Result<()> {
        for (id, point) in &self.points {
            if !point.position.is_finite() {
                return Err(bad(format!("point {id} lies at {}", point.position)));
            }
            let exists = |(image, at): &&(u32, u32)| {
                self.images.get(image).is_some_and(|image| (*at as usize) < image.observations.len())
            };
            if let Some((image, at)) = point.track.iter().find(|seen| !exists(seen)) {
                let message = format!("point {id} is seen by keypoint {at} of image {image}, which does not exist");
                return Err(bad(message).hint(MIXED_MODELS));
            }
        }
        Ok(())
    }

    /// Reprojection error of the tracks through the lenses; `None` without a point that is seen and has an error.
    pub fn reprojection_error(&self) -> Option<ReprojectionError> {
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

/// Advice for ids that lead nowhere.
const MIXED_MODELS: &str = "are the three files of one and the same model?";

impl RegisteredImage {
    /// The pose as a transform.
    pub fn camera_from_world(&self) -> RigidTransform {
        let [w, x, y, z] = self.quaternion;
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        RigidTransform { rotation, translation: DVec3::from(self.translation) }
    }
}

/// A lens from a camera model and its parameters; models that are not a pinhole with OpenCV's first four distortion
/// coefficients are refused by name.
pub fn lens(model: &str, width: u64, height: u64, params: &[f64]) -> Result<Lens> {
    let (fx, fy, rest) = match (model, params) {
        ("SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL", [f, rest @ ..]) => (*f, *f, rest),
        ("PINHOLE" | "OPENCV", [fx, fy, rest @ ..]) => (*fx, *fy, rest),
        _ => return Err(unsupported(model)),
    };
    let (center, k1, k2, p1, p2) = match (model, rest) {
        ("SIMPLE_PINHOLE" | "PINHOLE", [cx, cy]) => ((*cx, *cy), 0.0, 0.0, 0.0, 0.0),
        ("SIMPLE_RADIAL", [cx, cy, k]) => ((*cx, *cy), *k, 0.0, 0.0, 0.0),
        ("RADIAL", [cx, cy, k1, k2]) => ((*cx, *cy), *k1, *k2, 0.0, 0.0),
        ("OPENCV", [cx, cy, k1, k2, p1, p2]) => ((*cx, *cy), *k1, *k2, *p1, *p2),
        _ => return Err(bad(format!("camera model {model} with {} parameters", params.len()))),
    };
    if let Some(value) = params.iter().find(|value| !value.is_finite()) {
        return Err(bad(format!("a parameter of the camera is {value}")));
    }
    let size = |pixels: u64| u32::try_from(pixels).map_err(|_| bad(format!("camera of {width}×{height} pixels")));
    let intrinsics = Intrinsics {
        width: size(width)?,
        height: size(height)?,
        focal_x: fx,
        focal_y: fy,
        center_x: center.0,
        center_y: center.1,
    };
    Ok(Lens { intrinsics, distortion: Distortion { k1, k2, k3: 0.0, p1, p2 } })
}

fn unsupported(model: &str) -> Failure {
    let known = CAMERA_MODELS.iter().any(|(name, _)| *name == model);
    let what = if known { "not supported" } else { "unknown" };
    let hint = "run `colmap image_undistorter`; read here: SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV";
    Failure::new(FailureKind::BadInput, format!("camera model {model} is {what}")).hint(hint)
}
