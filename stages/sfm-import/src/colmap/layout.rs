//! Where a COLMAP workspace keeps its model and masks.

use std::path::{Path, PathBuf};

use crate::colmap::model_files::registered_count;

/// The folder of the sparse model: that of `sparse/0`, `sparse/1`, … with the most registered images, then `sparse`, then the
/// same below `colmap` (the layout of nerfstudio), then `sparse_` (4DGaussians), then `dir` itself.
///
/// One model file is enough for a folder below `sparse` to be chosen; reading it then reports the missing files.
pub(crate) fn sparse_dir(dir: &Path) -> Option<PathBuf> {
    let beside = |dir: &Path| largest(numbered_models(&dir.join("sparse"))).into_iter().chain([dir.join("sparse")]);
    let below = beside(dir).chain(beside(&dir.join("colmap"))).chain([dir.join("sparse_")]);
    let here = (has(dir, "cameras") && has(dir, "images")).then(|| dir.to_owned());
    below.into_iter().find(|candidate| is_model(candidate)).or(here)
}

/// The model with the most registered images, the first of several: COLMAP numbers models by attempt, not by size.
fn largest(mut models: Vec<PathBuf>) -> Option<PathBuf> {
    match models.len() {
        0 | 1 => models.pop(),
        _ => models.into_iter().rev().max_by_key(|model| registered_count(model)),
    }
}

/// The folders `N` in `sparse`, by number. Several folders mean that structure from motion broke the scene into parts.
pub(crate) fn numbered_models(sparse: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(sparse).into_iter().flatten().flatten().map(|entry| entry.path());
    let number = |path: &Path| path.file_name()?.to_str()?.parse::<u32>().ok();
    let mut models: Vec<_> = entries.filter(|path| is_model(path)).filter_map(|p| Some((number(&p)?, p))).collect();
    models.sort();
    models.into_iter().map(|(_, path)| path).collect()
}

fn is_model(dir: &Path) -> bool {
    has(dir, "cameras") || has(dir, "images")
}

/// Whether a model file with this name exists, binary or text.
fn has(dir: &Path, name: &str) -> bool {
    ["bin", "txt"].iter().any(|extension| dir.join(format!("{name}.{extension}")).is_file())
}

/// The mask of an image: the file in `masks/` with the same name and `.png` or `.PNG` in place of or after its extension.
pub(crate) fn mask_path(dir: &Path, name: &str) -> Option<PathBuf> {
    let masks = dir.join("masks");
    let of_extension =
        |png: &str| [masks.join(Path::new(name).with_extension(png)), masks.join(format!("{name}.{png}"))];
    ["png", "PNG"].into_iter().flat_map(of_extension).find(|path| path.is_file())
}
