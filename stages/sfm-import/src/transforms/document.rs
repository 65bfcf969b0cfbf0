//! The JSON of transforms files.

use std::path::{Path, PathBuf};

use glam::{DMat4, DVec4};
use scene::RigidTransform;
use serde::Deserialize;
use serde_json::Value;

use super::stated_lens::{NUMBERS, StatedLens};
use crate::applied::{Applied, affine};
use crate::error::{Result, bad, invalid};
use crate::files::read_text;
use crate::matrices::{is_rounded, straightened};

/// Tolerance for the last row of a homogeneous matrix.
const LAST_ROW_TOLERANCE: f64 = 1e-6;

/// A transforms file.
pub(crate) struct TransformsFile {
    /// Where it lies.
    pub(crate) path: PathBuf,
    /// Its content.
    pub(crate) document: Document,
    /// The frame of its poses.
    pub(crate) applied: Applied,
}

/// The content of a transforms file. Unknown keys are ignored.
#[derive(Deserialize)]
pub(crate) struct Document {
    #[serde(flatten)]
    pub(super) lens: StatedLens,
    /// The views.
    pub(crate) frames: Vec<StatedFrame>,
    /// ScanNet++: the official test views.
    #[serde(default)]
    pub(crate) test_frames: Vec<StatedFrame>,
    /// nerfstudio: the point cloud, in the frame of the poses.
    pub(crate) ply_file_path: Option<String>,
    /// nerfstudio: [3, 4] or [4, 4], from the original world to the frame of the poses, before `applied_scale`.
    applied_transform: Option<Vec<[f64; 4]>>,
    applied_scale: Option<f64>,
    /// nerfstudio: the `file_path`s of a split.
    pub(crate) train_filenames: Option<Vec<String>>,
    pub(crate) val_filenames: Option<Vec<String>>,
    pub(crate) test_filenames: Option<Vec<String>>,
    /// nerfstudio: scene units per unit of a depth file.
    depth_unit_scale_factor: Option<f64>,
    /// NeRFCapture: the same.
    integer_depth_scale: Option<f64>,
    /// Dense depth priors: units of a depth file per scene unit.
    depth_scaling_factor: Option<f64>,
    /// Two corners in the frame of the poses.
    pub(super) aabb: Option<Value>,
    /// SDFStudio: an object with a key `aabb`.
    pub(super) scene_box: Option<Value>,
    /// instant-ngp: side of the cube that can be non-empty, in its own units; `scale` and `offset` lead to these.
    pub(super) aabb_scale: Option<f64>,
    pub(super) scale: Option<f64>,
    pub(super) offset: Option<Offset>,
}

/// instant-ngp's `offset`: one number stands for three equal ones.
#[derive(Clone, Copy, Deserialize)]
#[serde(untagged)]
pub(super) enum Offset {
    Equal(f64),
    PerAxis([f64; 3]),
}

/// One view of a transforms file.
#[derive(Deserialize)]
pub(crate) struct StatedFrame {
    /// The image, relative to the folder of the file; without an extension in Blender's files.
    pub(crate) file_path: String,
    /// The time, usually in [0, 1].
    time: Option<f64>,
    /// GaussianAvatars: the number of the frame.
    timestep_index: Option<f64>,
    /// A time that apps write, e.g. in nanoseconds; not read, because static scans have it too.
    timestamp: Option<Value>,
    /// ScanNet++: true for images that are blurred or have a wrong pose.
    is_bad: Option<Value>,
    /// [3, 4] or [4, 4]: camera to world with OpenGL's axes (x right, y up, looking along −z).
    transform_matrix: Vec<[f64; 4]>,
    /// The mask of the image: nerfstudio trains on its set pixels.
    mask_path: Option<String>,
    /// GaussianAvatars: the mask of the subject.
    fg_mask_path: Option<String>,
    /// The depth map of the image.
    depth_file_path: Option<String>,
    /// NeRFCapture: the same.
    depth_path: Option<String>,
    #[serde(flatten)]
    pub(super) lens: StatedLens,
}

impl StatedFrame {
    /// The time in the unit of the file: `time`, or else `timestep_index`.
    pub(crate) fn time(&self) -> Option<f64> {
        self.time.or(self.timestep_index)
    }

    /// The path of the mask, if the frame states it: that of the subject, or else the other one.
    pub(super) fn mask_path(&self) -> Option<&str> {
        self.subject_mask_path().or(self.mask_path.as_deref().filter(|path| !path.is_empty()))
    }

    /// The path of the mask of the subject, if the frame states it.
    pub(super) fn subject_mask_path(&self) -> Option<&str> {
        self.fg_mask_path.as_deref().filter(|path| !path.is_empty())
    }

    /// The path of the depth map, if the frame states it.
    pub(super) fn depth_path(&self) -> Option<&str> {
        self.depth_file_path.as_deref().or(self.depth_path.as_deref())
    }

    /// Whether the frame has a key of a time that is not read.
    pub(super) fn has_timestamp(&self) -> bool {
        self.timestamp.is_some()
    }

    /// Whether the file advises against the use of the view.
    pub(crate) fn is_bad(&self) -> bool {
        self.is_bad == Some(Value::Bool(true))
    }

    /// Whether the rotation of the pose is not orthonormal, but only because its numbers have few digits.
    pub(super) fn is_rounded(&self) -> bool {
        affine(&self.transform_matrix).is_some_and(|matrix| is_rounded(&RigidTransform::from_matrix(matrix)))
    }

    /// Whether both frames have the same pose and time.
    pub(super) fn repeats(&self, other: &Self) -> bool {
        self.time() == other.time() && self.transform_matrix == other.transform_matrix
    }
}

impl TransformsFile {
    /// Parses a file.
    pub(crate) fn read(path: PathBuf) -> Result<Self> {
        let document = parse(&path)?;
        let applied = Applied::of(document.applied_transform.as_deref(), document.applied_scale);
        let applied = applied.map_err(|failure| failure.at(&path))?;
        Ok(Self { path, document, applied })
    }

    /// World-to-camera in the original world, with OpenCV's axes.
    pub(super) fn camera_from_world(&self, frame: &StatedFrame) -> Result<RigidTransform> {
        let opengl = affine(&frame.transform_matrix)
            .ok_or_else(|| bad(format!("transform_matrix has {} rows", frame.transform_matrix.len())))?;
        let last_row = opengl.row(3);
        if !last_row.abs_diff_eq(DVec4::W, LAST_ROW_TOLERANCE) {
            let hint =
                "transpose the matrices if their last column is 0, 0, 0, 1; otherwise correct the row, or omit it";
            let message = format!("the last row of transform_matrix is {last_row} instead of [0, 0, 0, 1]");
            return Err(bad(message).hint(hint));
        }
        let flip = DMat4::from_diagonal(DVec4::new(1.0, -1.0, -1.0, 1.0));
        let stated = RigidTransform::from_matrix(opengl * flip);
        let world_from_camera = if frame.is_rounded() { straightened(stated) } else { stated };
        world_from_camera.check().map_err(invalid)?;
        Ok(self.applied.undo_pose(&world_from_camera).inverse())
    }

    /// Scene units per unit of a depth file, if the file states it.
    pub(super) fn depth_unit(&self) -> Option<f64> {
        let inverse = || self.document.depth_scaling_factor.map(f64::recip);
        let unit = self.document.depth_unit_scale_factor.or(self.document.integer_depth_scale).or_else(inverse)?;
        (unit > 0.0 && unit.is_finite()).then_some(unit)
    }
}

fn parse(path: &Path) -> Result<Document> {
    let text = read_text(path)?;
    serde_json::from_str(&text).map_err(|error| {
        let why = wrong_number(&text).unwrap_or_else(|| error.to_string());
        let failure = bad(format!("not a valid transforms file ({why})")).at(path);
        match ["NaN", "Infinity"].iter().find(|word| text.contains(**word)) {
            Some(word) => failure.hint(format!("it contains {word}, which is not valid JSON: correct the number")),
            None if error.is_data() => failure
                .hint("the file has a list frames; each frame has file_path and transform_matrix, rows of 4 numbers"),
            None => failure,
        }
    })
}

/// The first value that should be a number. The parser's own error names neither the key nor the place.
fn wrong_number(text: &str) -> Option<String> {
    let document: Value = serde_json::from_str(text).ok()?;
    let frames = document.get("frames").and_then(Value::as_array).into_iter().flatten();
    let entries = std::iter::once((&document, "at the top".to_owned()));
    let entries = entries.chain(frames.zip(0..).map(|(frame, index)| (frame, format!("of frame {index}"))));
    let wrong = |(entry, place): (&Value, String)| {
        let keys = NUMBERS.into_iter().chain(["time", "timestep_index"]);
        let mut values = keys.filter_map(|key| Some((key, entry.get(key)?)));
        let (key, value) = values.find(|(_, value)| !value.is_number() && !value.is_null())?;
        Some(format!("{key} {place} is {value}, which is not a number"))
    };
    entries.filter_map(wrong).next()
}
