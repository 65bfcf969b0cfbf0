//! The point cloud of transforms files: the file that `ply_file_path` names, or one with a usual name in the folder, or the points of
//! the model of COLMAP from which nerfstudio made the poses.

use std::path::{Path, PathBuf};

use scene::PointCloud;

use super::document::TransformsFile;
use super::listed::{find, relative};
use crate::cloud_file::{CloudFile, CloudSource};
use crate::colmap::layout::sparse_dir;
use crate::files::children;

/// File names of clouds: of 4DGaussians, of 3DGS, of COLMAP's exporters, and of nerfstudio.
const NAMES: [&str; 7] =
    ["fused.ply", "points3d.ply", "points3D.ply", "sparse_pc.ply", "point_cloud.ply", "pointcloud.ply", "points.ply"];

/// Names of the clouds that 3DGS (Kerbl et al. 2023) and 4DGaussians leave in folders without one: random grey points.
const DRAWN: [&str; 2] = ["fused.ply", "points3d.ply"];
/// The half side of the cube in which they are drawn.
const DRAWN_HALF_SIDE: f32 = 1.3;
/// The number of cells of the cube along each axis, and the range of the number of points in a cell relative to its mean. The middle
/// and the corners of a surface are empty.
const CELLS: (usize, std::ops::Range<f64>) = (3, 0.5..2.0);
/// Fewer points than this differ by more between the cells; 4DGaussians draws 2000.
const LEAST_DRAWN: usize = 1000;

/// The cloud of a capture whose poses are in `file`; `None` if there is none.
pub(crate) fn cloud(dir: &Path, file: &TransformsFile, warnings: &mut Vec<String>) -> Option<CloudSource> {
    let stated = file.document.ply_file_path.as_deref().filter(|path| !path.is_empty());
    let named = stated.and_then(|path| find(dir, &relative(path)));
    if let (Some(stated), None) = (stated, &named) {
        warnings.push(format!("the point cloud that ply_file_path names is missing: {stated}"));
    }
    match named.or_else(|| usual(dir, warnings)) {
        Some(path) => Some(CloudSource::File(CloudFile { path, applied: file.applied })),
        None => sparse_dir(dir).filter(|sparse| sparse.starts_with(dir.join("colmap"))).map(CloudSource::Model),
    }
}

/// Whether the points of a file are drawn at random in the cube of 3DGS, in one grey.
fn is_drawn(path: &Path) -> bool {
    let Ok(PointCloud { positions, colors }) = PointCloud::read_ply(path) else { return false };
    let is_grey =
        colors.first().is_some_and(|first| [[127; 3], [128; 3]].contains(first) && colors.iter().all(|it| it == first));
    let (per_axis, range) = CELLS;
    let mut counts = vec![0_u32; per_axis.pow(3)];
    for position in &positions {
        let cell = position.map(|value| (value / DRAWN_HALF_SIDE + 1.0) * 0.5 * per_axis as f32);
        let Some([x, y, z]) = cell.iter().all(|it| (0.0..=per_axis as f32).contains(it)).then_some(cell) else {
            return false;
        };
        let [x, y, z] = [x, y, z].map(|it| (it as usize).min(per_axis - 1));
        counts[(x * per_axis + y) * per_axis + z] += 1;
    }
    let mean = positions.len() as f64 / counts.len() as f64;
    is_grey && positions.len() >= LEAST_DRAWN && counts.iter().all(|count| range.contains(&(f64::from(*count) / mean)))
}

/// The first cloud with a usual name. Names are compared with the folder's entries, because some file systems ignore case.
fn usual(dir: &Path, warnings: &mut Vec<String>) -> Option<PathBuf> {
    let names = children(dir);
    let present = NAMES.into_iter().filter(|name| names.iter().any(|entry| entry == name));
    let (drawn, present): (Vec<&str>, Vec<&str>) =
        present.partition(|name| DRAWN.contains(name) && is_drawn(&dir.join(name)));
    warnings.extend(drawn.iter().map(|name| {
        format!(
            "{name} is ignored: its points are not from the scene, but drawn in ±{DRAWN_HALF_SIDE} by a trainer that found no cloud"
        )
    }));
    let mut present = present.into_iter();
    let first = present.next()?;
    let others: Vec<&str> = present.collect();
    if !others.is_empty() {
        warnings.push(format!("several clouds: {first} is used, not {}", others.join(", ")));
    }
    Some(dir.join(first))
}
