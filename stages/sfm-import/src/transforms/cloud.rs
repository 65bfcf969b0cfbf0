//! The point cloud of transforms files: the file that `ply_file_path` names, or one with a usual name in the folder.

use std::path::{Path, PathBuf};

use super::document::TransformsFile;
use super::listed::{find, relative};
use crate::cloud_file::CloudFile;
use crate::files::children;

/// File names of clouds: of 4DGaussians, of 3DGS, of COLMAP's exporters, and of nerfstudio.
const NAMES: [&str; 7] =
    ["fused.ply", "points3d.ply", "points3D.ply", "sparse_pc.ply", "point_cloud.ply", "pointcloud.ply", "points.ply"];

/// The cloud of a capture whose poses are in `file`; `None` if there is none.
pub(crate) fn cloud(dir: &Path, file: &TransformsFile, warnings: &mut Vec<String>) -> Option<CloudFile> {
    let stated = file.document.ply_file_path.as_deref().filter(|path| !path.is_empty());
    let named = stated.and_then(|path| find(dir, &relative(path)));
    if let (Some(stated), None) = (stated, &named) {
        warnings.push(format!("the point cloud that ply_file_path names is missing: {stated}"));
    }
    Some(CloudFile { path: named.or_else(|| usual(dir, warnings))?, applied: file.applied })
}

/// The first cloud with a usual name. Names are compared with the folder's entries, because some file systems ignore case.
fn usual(dir: &Path, warnings: &mut Vec<String>) -> Option<PathBuf> {
    let names = children(dir);
    let mut present = NAMES.iter().filter(|name| names.iter().any(|entry| entry == *name));
    let first = present.next()?;
    let others: Vec<&str> = present.copied().collect();
    if !others.is_empty() {
        warnings.push(format!("several clouds: {first} is used, not {}", others.join(", ")));
    }
    Some(dir.join(first))
}
