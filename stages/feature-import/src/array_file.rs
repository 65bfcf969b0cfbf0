//! Arrays in `.npy` files, or in safetensors files with one f32 tensor.

use std::path::{Path, PathBuf};

use engine::{Failure, FailureKind};
use scene::npy_file;

use crate::tensor_file;

/// Extensions of arrays, in order of preference.
pub(crate) const EXTENSIONS: [&str; 2] = ["npy", "safetensors"];

/// Finds the file of an array from its path without extension.
pub(crate) fn array_path(stem: &Path) -> Option<PathBuf> {
    // Names may contain dots, which `with_extension` would cut.
    let with = |extension| PathBuf::from(format!("{}.{extension}", stem.display()));
    EXTENSIONS.into_iter().map(with).find(|path| path.is_file())
}

/// Reads shape and values of an array, which must not be empty.
pub(crate) fn read_array(path: &Path) -> anyhow::Result<(Vec<usize>, Vec<f32>)> {
    let (shape, values) = if path.extension().is_some_and(|extension| extension == "safetensors") {
        tensor_file::read(path)?
    } else {
        let array = npy_file::read(path)?;
        (array.shape, array.values.into_iter().map(|value| value as f32).collect())
    };
    if values.is_empty() { Err(wrong_shape(&shape, "values", path)) } else { Ok((shape, values)) }
}

/// The failure for an array of another shape.
pub(crate) fn wrong_shape(shape: &[usize], expected: &str, path: &Path) -> anyhow::Error {
    Failure::new(FailureKind::BadInput, format!("shape {shape:?} instead of {expected}")).at(path).into()
}
