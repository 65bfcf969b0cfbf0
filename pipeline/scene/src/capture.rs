//! A capture: posed, timed images of one moving scene, in one folder, whoever made it.

mod reading;
mod writing;

#[cfg(test)]
mod tests;

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

pub use writing::{CaptureInfo, CaptureWriter, Frame};

use crate::{Camera, Protocol, TimeMap};

/// The version of the folder format below.
pub const SCHEMA: u32 = 1;

/// What label 0 of a mask is called: everything that is no instance.
pub const BACKGROUND: &str = "background";

/// A capture on disk: `capture.json` (this structure) beside the image files that its views name.
///
/// Images stay in their files (8 bit) and are read one at a time, so that a long capture does not need its size in
/// memory. Made by [`CaptureWriter`], read by [`Capture::open`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Capture {
    /// The folder; not stored.
    #[serde(skip)]
    pub dir: PathBuf,
    /// The scene's name, as `bouncingballs`.
    pub name: String,
    /// Where the poses come from, as `blender`, `colmap`, `analytic`.
    pub pose_source: String,
    /// How the images came to be what they are.
    pub protocol: Protocol,
    /// The colour that images were composited on and that models render on.
    pub background: [f32; 3],
    /// Seconds to [0, 1].
    pub time_map: TimeMap,
    /// Every image, ordered by split, then time, then camera.
    pub views: Vec<View>,
    /// Names of the instances in the masks: label k of a mask is `class_names[k - 1]`; 0 is the static [`BACKGROUND`].
    pub class_names: Vec<String>,
    /// Whether `points.ply` holds a point cloud (from structure from motion, or sampled on surfaces).
    pub has_points: bool,
    /// The box that holds the scene (min, max corner, world), where it is known without points; random initial
    /// points are drawn in it.
    pub bounds_world: Option<[[f64; 3]; 2]>,
}

/// One posed, timed image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Unique within the capture, safe as a file name: `train_000`, `cam00_0010`.
    pub name: String,
    /// What the view may be used for.
    pub split: Split,
    /// Pinhole and pose.
    pub camera: Camera,
    /// Which camera of a rig (0 for a monocular capture).
    pub camera_index: u32,
    /// Frame number within that camera's video.
    pub frame_index: u32,
    /// When the image was taken.
    pub time_secs: f64,
    /// 8-bit RGB PNG, composited on the capture's background.
    pub image: PathBuf,
    /// 8-bit grey PNG: coverage before compositing.
    pub alpha: Option<PathBuf>,
    /// EXR, f32, view-space z in scene units; 0 where there is none.
    pub depth: Option<PathBuf>,
    /// EXR, f32 x and y: pixel displacement of what this pixel sees, to the next frame as seen by this camera pose
    /// at the next frame's time (forward optical flow); NaN where the point is hidden or leaves the image.
    pub flow: Option<PathBuf>,
    /// 8-bit grey PNG of instance labels (see [`Capture::class_names`]).
    pub mask: Option<PathBuf>,
    /// EXR, f32 x, y and z: 3D velocity of the surface point that this pixel sees, world, scene units per second.
    pub velocity: Option<PathBuf>,
}

/// What a view may be used for: test views never choose anything.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// Optimised against.
    Train,
    /// Watched during training (quality curves, budgets).
    Val,
    /// Measured once, at the end.
    Test,
}
