//! A capture: the posed and timed images of one dynamic scene in one folder, from any importer.

mod reading;
mod scale;
mod writing;

#[cfg(test)]
mod tests;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

pub use scale::SceneScale;
pub use writing::{CaptureInfo, CaptureWriter, Frame};

use crate::{Camera, Protocol, TimeMap};

/// Version of the folder format.
pub const SCHEMA: u32 = 1;

/// The name of label 0 of a mask: everything that is not an instance.
pub const BACKGROUND: &str = "background";

/// A capture on disk: the index `capture.json` (this structure) and the image files that its views name.
///
/// Images stay in their files and are read one at a time, so that a long capture need not fit in memory.
/// [`CaptureWriter`] writes a capture, [`Capture::open`] reads it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Capture {
    /// The folder of the capture; not stored.
    #[serde(skip)]
    pub dir: PathBuf,
    /// Name of the scene, e.g. `bouncingballs`.
    pub name: String,
    /// Origin of the poses, e.g. `blender`, `colmap` or `analytic`.
    pub pose_source: String,
    /// How the images were made.
    pub protocol: Protocol,
    /// The background colour of the images and of renders, sRGB-encoded in [0, 1].
    pub background: [f32; 3],
    /// Normalisation of time.
    pub time_map: TimeMap,
    /// All views, ordered by split, then time, then camera.
    pub views: Vec<View>,
    /// Names of the instances in the masks: label k of a mask is `class_names[k - 1]`; 0 is the static [`BACKGROUND`].
    pub class_names: Vec<String>,
    /// Whether `points.ply` holds a point cloud (from structure from motion, or sampled on surfaces).
    pub has_points: bool,
    /// Bounding box of the scene (min, max corner, world), if known without points; random initial points are drawn in
    /// it.
    pub bounds_world: Option<[[f64; 3]; 2]>,
}

/// One posed and timed image, with its maps. Paths are relative to the folder of the capture.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Name, unique within the capture and safe as a file name, e.g. `train_000` or `cam00_0010`.
    pub name: String,
    /// The purpose of the view.
    pub split: Split,
    /// Intrinsics and pose.
    pub camera: Camera,
    /// Number of the camera in a rig; 0 for a monocular capture.
    pub camera_index: u32,
    /// Frame number within the video of that camera.
    pub frame_index: u32,
    /// Time of the image in seconds.
    pub time_secs: f64,
    /// 8-bit RGB PNG, composited on the background of the capture.
    pub image: PathBuf,
    /// 8-bit grey PNG of coverage before compositing.
    pub alpha: Option<PathBuf>,
    /// EXR of view-space z (f32) in scene units; 0 where unknown.
    pub depth: Option<PathBuf>,
    /// EXR of forward optical flow (f32 x and y) in pixels: the displacement of the visible point until the time of the
    /// next frame, as seen by this camera pose. NaN where the point is then hidden or outside the image.
    pub flow: Option<PathBuf>,
    /// 8-bit grey PNG of instance labels (see [`Capture::class_names`]).
    pub mask: Option<PathBuf>,
    /// EXR of the 3D velocity of the visible surface point (f32 x, y and z), world, in scene units per second.
    pub velocity: Option<PathBuf>,
}

/// The purpose of a view. Test views never influence a choice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Optimised against during training.
    Train,
    /// Monitored during training, for quality curves and budgets.
    Val,
    /// Evaluated once, at the end.
    Test,
}

impl Split {
    /// Every split, in the order of captures.
    pub const ALL: [Self; 3] = [Self::Train, Self::Val, Self::Test];

    /// The name in files, recipes and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::Test => "test",
        }
    }
}
