//! Keys of static facts: properties of an artifact that are known before it is computed. Producers and consumers share
//! these keys.
//!
//! A missing fact is unknown. [`TIMES`] and the facts from [`WIDTH`] to [`TEST_VIEWS`] are counts, [`SPLIT`] is a name, and
//! the others are booleans.

/// Number of distinct times among the training views.
pub const TIMES: &str = "times";
/// Whether anything moves between the first and the last time.
pub const MOVING: &str = "moving";
/// Whether colours depend on the viewpoint.
pub const VIEW_DEPENDENT: &str = "view dependent";
/// Whether successive training frames have unrelated viewpoints, so the video has no continuous parallax.
pub const TELEPORTING_CAMERA: &str = "teleporting camera";
/// Whether there is a point cloud.
pub const POINTS: &str = "points";
/// Whether views have depth maps.
pub const DEPTH: &str = "depth";
/// Whether views have optical flow.
pub const FLOW: &str = "flow";
/// Whether views have normal maps.
pub const NORMALS: &str = "normals";
/// Whether views have maps of the 3D velocity of the visible surface.
pub const VELOCITY: &str = "velocity";
/// Whether views have instance masks.
pub const MASKS: &str = "masks";
/// Width of the images in pixels.
pub const WIDTH: &str = "width";
/// Height of the images in pixels.
pub const HEIGHT: &str = "height";
/// Number of training views.
pub const TRAIN_VIEWS: &str = "train views";
/// Number of validation views.
pub const VAL_VIEWS: &str = "val views";
/// Number of test views.
pub const TEST_VIEWS: &str = "test views";
/// The split whose views are rendered.
pub const SPLIT: &str = "split";
