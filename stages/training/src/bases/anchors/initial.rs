//! Initial values of anchors on a point cloud (Lu et al. 2024, section 3.1).

use std::collections::BTreeMap;

use scene::cloud::PointCloud;
use shaders::tape::{Real, Tensor};

use super::{ANCHORS, AnchorSettings};
use crate::bases::gaussians;
use crate::data::SceneFacts;
use crate::model::ModelState;

/// The cell of a position in a grid of cells whose centres are the multiples of `size`.
pub(super) fn cell(position: [f32; 3], size: f64) -> [i64; 3] {
    position.map(|axis| (f64::from(axis) / size).round() as i64)
}

/// The centre of a cell.
pub(super) fn center(cell: [i64; 3], size: f64) -> [f32; 3] {
    cell.map(|axis| (axis as f64 * size) as f32)
}

/// The centres of the voxels that hold points, in the order of their cells, each with the index of its first point.
pub(crate) fn voxels(positions: &[[f32; 3]], size: f64) -> Vec<([f32; 3], usize)> {
    let mut first = BTreeMap::new();
    for (index, &position) in positions.iter().enumerate() {
        first.entry(cell(position, size)).or_insert(index);
    }
    first.into_iter().map(|(cell, index)| (center(cell, size), index)).collect()
}

/// Adds anchors at `positions` with zero features and offsets. Scales are the root mean square distance to the three
/// nearest anchors.
pub(crate) fn insert_anchors<T: Real>(
    state: &mut ModelState<T>,
    positions: Vec<[f32; 3]>,
    settings: &AnchorSettings,
    scene: &SceneFacts,
) {
    let count = positions.len();
    let tensor = |columns: usize, values: Vec<f64>| {
        Tensor::from_vec([count, columns], values.into_iter().map(T::from_f64).collect())
    };
    let points = PointCloud { colors: vec![[0; 3]; count], positions };
    let scales = gaussians::nearest_scales(&points, scene);
    let coordinates = points.positions.iter().flatten().map(|&value| f64::from(value)).collect();
    let mut insert = |attribute: &str, tensor: Tensor<T>| state.insert(format!("{ANCHORS}.{attribute}"), tensor);
    insert("positions", tensor(3, coordinates));
    insert("features", Tensor::zeros([count, settings.features]));
    insert("offsets", Tensor::zeros([count, 3 * settings.offsets]));
    insert("log_scales", tensor(6, scales.iter().flat_map(|scale| [scale.ln(); 6]).collect()));
}
