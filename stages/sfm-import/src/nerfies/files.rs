//! The JSON files of the layout, and what one camera file means.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DVec3};
use scene::{Intrinsics, RigidTransform};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::lens::{Distortion, Lens};
use crate::source::{Result, bad, read_bytes};

/// Pixels of shear across an image below which a camera counts as having none.
const MAX_SKEW_PX: f64 = 1e-3;

/// `dataset.json`: the official split.
#[derive(Deserialize)]
pub struct Dataset {
    /// Every view in order of time.
    pub ids: Vec<String>,
    /// Empty or absent where another file states the split.
    #[serde(default)]
    pub train_ids: Vec<String>,
    /// Empty for interpolation captures.
    #[serde(default)]
    pub val_ids: Vec<String>,
}

/// `splits/{train,val}.json` of DyCheck.
#[derive(Deserialize)]
pub struct SplitNames {
    /// View ids.
    pub frame_names: Vec<String>,
}

/// A view's entry in `metadata.json`.
#[derive(Deserialize)]
pub struct ViewMetadata {
    /// Index of the instant, unless there is a `time_id`.
    pub warp_id: u32,
    /// Index of the instant, where the capture distinguishes it from the warp code.
    pub time_id: Option<u32>,
    /// The physical camera.
    #[serde(default)]
    pub camera_id: u32,
}

/// `scene.json`: the frame that coordinates are normalised to.
#[derive(Clone, Copy, Deserialize)]
pub struct SceneFrame {
    /// Multiplies lengths after centring.
    pub scale: f64,
    /// Becomes the origin, in the units of the camera files.
    pub center: [f64; 3],
}

/// `camera/<id>.json`, with values for the image at 1x.
#[derive(Deserialize)]
struct CameraFile {
    /// World to camera (x right, y down, z forward), rows first.
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
    /// Called `tangential` in the oldest files.
    #[serde(default, alias = "tangential")]
    tangential_distortion: [f64; 2],
    image_size: [u32; 2],
}

fn square() -> f64 {
    1.0
}

/// Reads one JSON file.
pub fn parse<T: DeserializeOwned>(path: &Path) -> Result<T> {
    serde_json::from_slice(&read_bytes(path)?)
        .map_err(|error| bad(format!("not a file of the Nerfies layout ({error})")).at(path))
}

/// `metadata.json`, by view id.
pub fn metadata(dir: &Path) -> Result<BTreeMap<String, ViewMetadata>> {
    parse(&dir.join("metadata.json"))
}

/// Where a view's camera is described.
pub fn camera_path(dir: &Path, id: &str) -> PathBuf {
    dir.join("camera").join(format!("{id}.json"))
}

impl SceneFrame {
    /// A scale and a centre that can be computed with.
    pub fn check(self) -> Result<Self> {
        let finite = self.scale > 0.0 && self.scale.is_finite() && DVec3::from(self.center).is_finite();
        let message = || format!("scale {} and center {:?} are no coordinate frame", self.scale, self.center);
        if finite { Ok(self) } else { Err(bad(message())) }
    }

    /// The normalised position of a point of the camera files.
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.scale * (point - DVec3::from(self.center))
    }
}

/// How the image at 1/`factor` of the full size was taken, and from where, in the normalised frame.
pub fn camera(path: &Path, frame: &SceneFrame, factor: u32) -> Result<(Lens, RigidTransform)> {
    let file: CameraFile = parse(path)?;
    if !(file.skew.abs() <= MAX_SKEW_PX) {
        let message = format!("the camera has a skew of {} px, which is not supported", file.skew);
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
    let ([k1, k2, k3], [p1, p2]) = (file.radial_distortion, file.tangential_distortion);
    let rotation = DMat3::from_cols_array_2d(&file.orientation).transpose();
    let position = frame.apply(DVec3::from(file.position));
    let camera_from_world = RigidTransform { rotation, translation: -(rotation * position) };
    Ok((Lens { intrinsics, distortion: Distortion { k1, k2, k3, p1, p2 } }, camera_from_world))
}
