//! Writes captures of other layouts as a single `transforms.json`.

use std::path::Path;

use glam::{DMat4, DVec3, DVec4};
use scene::ply::PlyFormat;
use scene::{PointCloud, Split};
use serde_json::{Value, json};

use crate::source::{Frame, SourceCapture};

/// How a capture is rewritten.
#[derive(Clone, Default)]
pub(crate) struct Rewriting {
    /// Moves poses and points, as ns-process-data does: the matrix and the scale.
    pub(crate) applied: Option<(DMat4, f64)>,
    /// Leaves the points where they were, as early versions did.
    pub(crate) keeps_points: bool,
    /// The camera model and its coefficients; null for none.
    pub(crate) distortion: Value,
    /// States times and lists of file names.
    pub(crate) is_timed: bool,
}

/// Writes `transforms.json` and `sparse_pc.ply` into `dir`, for a capture whose images lie there.
pub(crate) fn rewrite(dir: &Path, source: &SourceCapture, rewriting: &Rewriting) {
    let (matrix, scale) = rewriting.applied.unwrap_or((DMat4::IDENTITY, 1.0));
    let file_path = |frame: &Frame| frame.image.strip_prefix(dir).unwrap().display().to_string();
    let stated = |frame: &Frame| {
        let mut stated = lens(frame);
        stated.as_object_mut().unwrap().extend(rewriting.distortion.as_object().cloned().unwrap_or_default());
        stated["file_path"] = file_path(frame).into();
        stated["transform_matrix"] = opengl(frame, matrix, scale);
        if rewriting.is_timed {
            stated["time"] = frame.time_secs.into();
        }
        stated
    };
    let mut file = json!({ "frames": source.frames.iter().map(stated).collect::<Vec<_>>() });
    if rewriting.applied.is_some() {
        file["applied_transform"] = json!(matrix.transpose().to_cols_array_2d()[..3]);
        file["applied_scale"] = scale.into();
    }
    for (key, split) in [("train", Split::Train), ("val", Split::Val), ("test", Split::Test)] {
        let of_split = source.frames.iter().filter(|frame| frame.split == split);
        if rewriting.is_timed {
            file[format!("{key}_filenames")] = of_split.map(file_path).collect();
        }
    }
    if !source.points.is_empty() {
        let moved = |position: &[f64; 3]| {
            let moved = scale * matrix.transform_point3(DVec3::from(*position));
            if rewriting.keeps_points { position.map(|value| value as f32) } else { moved.as_vec3().to_array() }
        };
        let positions = source.points.iter().map(|(position, _)| moved(position)).collect();
        let colors = source.points.iter().map(|(_, rgb)| *rgb).collect();
        let cloud = PointCloud { positions, colors };
        cloud.write_ply(&dir.join("sparse_pc.ply"), PlyFormat::Ascii).unwrap();
        file["ply_file_path"] = "sparse_pc.ply".into();
    }
    std::fs::write(dir.join("transforms.json"), file.to_string()).unwrap();
}

fn lens(frame: &Frame) -> Value {
    let k = frame.lens.intrinsics;
    json!({
        "fl_x": k.focal_x, "fl_y": k.focal_y, "cx": k.center_x, "cy": k.center_y, "w": k.width, "h": k.height,
    })
}

/// Camera to the moved world, with OpenGL's axes, rows first.
fn opengl(frame: &Frame, matrix: DMat4, scale: f64) -> Value {
    let world_from_camera = frame.camera_from_world.inverse();
    let mut opencv = DMat4::from_mat3(world_from_camera.rotation);
    opencv.w_axis = world_from_camera.translation.extend(1.0);
    let mut moved = matrix * opencv * DMat4::from_diagonal(DVec4::new(1.0, -1.0, -1.0, 1.0));
    moved.w_axis = (scale * moved.w_axis.truncate()).extend(1.0);
    json!(moved.transpose().to_cols_array_2d())
}
