//! Names of what can be known of an artifact before it is made, so that whoever tells and whoever asks use the same ones.
//!
//! A fact that is not told is unknown. Counts are numbers; everything else is a truth value.

/// Count: different times among the training views.
pub const TIMES: &str = "times";
/// Whether anything moves between the first and the last time.
pub const MOVING: &str = "moving";
/// Whether colours depend on the viewpoint.
pub const VIEW_DEPENDENT: &str = "view dependent";
/// Whether successive training frames come from unrelated viewpoints, so that the video shows no parallax of its own.
pub const TELEPORTING_CAMERA: &str = "teleporting camera";
/// Whether there is a point cloud.
pub const POINTS: &str = "points";
/// Whether views have depth maps.
pub const DEPTH: &str = "depth";
/// Whether views have optical flow.
pub const FLOW: &str = "flow";
/// Whether views have normal maps.
pub const NORMALS: &str = "normals";
/// Whether views have maps of the seen surface's 3D velocity.
pub const VELOCITY: &str = "velocity";
/// Whether views have instance masks.
pub const MASKS: &str = "masks";
