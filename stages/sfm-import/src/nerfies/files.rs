//! The JSON files of the layout, and the camera that a camera file describes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use scene::{Intrinsics, RigidTransform};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::error::{Result, bad};
use crate::files::read_text;
use crate::lens::{Distortion, Lens};

/// Largest skew in pixels that is treated as zero.
const MAX_SKEW_PX: f64 = 1e-3;

/// `dataset.json`: the official split.
#[derive(Deserialize)]
pub(crate) struct Dataset {
    /// The ids of all views, in order of time.
    pub(crate) ids: Vec<String>,
    /// The ids of training views; empty or missing if another file states the split.
    #[serde(default)]
    pub(crate) train_ids: Vec<String>,
    /// The ids of held-out views; empty for interpolation captures.
    #[serde(default)]
    pub(crate) val_ids: Vec<String>,
}

/// `splits/{train,val}.json` of DyCheck.
#[derive(Deserialize)]
pub(crate) struct SplitNames {
    /// The ids of the split's views.
    pub(crate) frame_names: Vec<String>,
}

/// A view's entry in `metadata.json`.
#[derive(Deserialize)]
pub(crate) struct ViewMetadata {
    /// Index of the instant, if there is no `time_id`.
    warp_id: Option<u32>,
    /// Index of the instant, in captures that distinguish it from the warp code.
    time_id: Option<u32>,
    /// Index of the physical camera.
    #[serde(default)]
    pub(crate) camera_id: u32,
}

impl ViewMetadata {
    /// Replaces the index of the instant.
    pub(crate) fn set_instant(&mut self, instant: u32) {
        self.time_id = Some(instant);
    }

    /// Index of the instant, if the entry has one.
    pub(crate) fn instant(&self) -> Option<u32> {
        self.time_id.or(self.warp_id)
    }
}

/// `scene.json`: the normalised coordinate frame.
#[derive(Clone, Copy, Deserialize)]
pub(crate) struct SceneFrame {
    /// Scale factor, applied after centring.
    pub(crate) scale: f64,
    /// The new origin, in the units of the camera files.
    pub(crate) center: [f64; 3],
}

/// `camera/<id>.json`, with values for the full-size image (1x).
#[derive(Deserialize)]
struct CameraFile {
    /// World to camera (x right, y down, z forward), as rows.
    orientation: [[f64; 3]; 3],
    /// The camera's centre in the world.
    position: [f64; 3],
    focal_length: f64,
    principal_point: [f64; 2],
    #[serde(default)]
    skew: f64,
    #[serde(default = "square")]
    pixel_aspect_ratio: f64,
    #[serde(default)]
    radial_distortion: [f64; 3],
    /// Named `tangential` in the oldest files.
    #[serde(default, alias = "tangential")]
    tangential_distortion: [f64; 2],
    image_size: [u32; 2],
}

fn square() -> f64 {
    1.0
}

/// Parses one JSON file.
pub(crate) fn parse<T: DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_str(&read_text(path)?)
        .map_err(|error| bad(format!("not a valid file of the Nerfies layout ({error})")).at(path))
}

/// Reads `metadata.json`, keyed by view id.
pub(crate) fn metadata(dir: &Path) -> Result<BTreeMap<String, ViewMetadata>> {
    parse(&dir.join("metadata.json"))
}

/// The path of a view's camera file.
pub(crate) fn camera_path(dir: &Path, id: &str) -> PathBuf {
    dir.join("camera").join(format!("{id}.json"))
}

impl SceneFrame {
    /// Checks for a positive, finite scale and a finite centre.
    pub(crate) fn check(self) -> Result<Self> {
        let finite = self.scale > 0.0 && self.scale.is_finite() && DVec3::from(self.center).is_finite();
        let message = || format!("scale {} and center {:?} do not define a coordinate frame", self.scale, self.center);
        if finite { Ok(self) } else { Err(bad(message())) }
    }

    /// Normalises a position of the camera files.
    pub(crate) fn apply(&self, point: DVec3) -> DVec3 {
        self.scale * (point - DVec3::from(self.center))
    }
}

/// The lens and the normalised pose of a camera file, for images at 1/`factor` of the full size.
pub(crate) fn camera(path: &Path, frame: &SceneFrame, factor: u32) -> Result<(Lens, RigidTransform)> {
    let file: CameraFile = parse(path)?;
    if !(file.skew.abs() <= MAX_SKEW_PX) {
        let message = format!("the camera has a skew of {} px, but skew is not supported", file.skew);
        return Err(bad(message).at(path));
    }
    let scale = 1.0 / f64::from(factor);
    let [width, height] = file.image_size.map(|pixels| (f64::from(pixels) * scale).round() as u32);
    let intrinsics = Intrinsics {
        width,
        height,
        focal_x: scale * file.focal_length,
        focal_y: scale * file.focal_length * file.pixel_aspect_ratio,
        center_x: scale * file.principal_point[0],
        center_y: scale * file.principal_point[1],
    };
    let [k1, k2, k3] = file.radial_distortion;
    let distortion = Distortion::brown([k1, k2, k3, 0.0], file.tangential_distortion);
    let rotation = DMat3::from_cols_array_2d(&file.orientation).transpose();
    let position = frame.apply(DVec3::from(file.position));
    let camera_from_world = RigidTransform { rotation, translation: -(rotation * position) };
    Ok((Lens { intrinsics, distortion }, camera_from_world))
}
