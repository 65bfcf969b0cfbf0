//! Initial values of Gaussians on a point cloud (Kerbl et al. 2023).

use rayon::prelude::*;
use scene::cloud::PointCloud;
use scene::gaussians::SH_C0;
use scene::point_tree::PointTree;
use shaders::tape::{Real, Tensor};

use super::GAUSSIANS;
use crate::data::SceneFacts;
use crate::model::ModelState;
use crate::shared::Shared;

/// The size of a Gaussian without neighbours, as a share of the scene's extent; density control splits larger ones.
const LONE_SCALE: f64 = 0.01;
/// The initial opacity.
pub(super) const INITIAL_OPACITY: f64 = 0.1;
/// Number of neighbours whose distance sets the initial size.
const NEIGHBORS: usize = 3;
/// Minimum mean squared distance in squares of [`SceneFacts::unit_world`], so that duplicate points do not give
/// Gaussians of size 0 (published code).
const MIN_SQUARED_DISTANCE: f64 = 1e-7;

/// Adds the population [`GAUSSIANS`] on the points.
pub(crate) fn insert_initial<T: Real>(
    state: &mut ModelState<T>,
    shared: &Shared,
    scene: &SceneFacts,
    points: &PointCloud,
) {
    insert_gaussians(state, GAUSSIANS, points, shared.harmonics.degree, scene);
}

/// Adds `{population}.positions`, `.log_scales`, `.rotations`, `.opacity_logits`, `.sh_dc` and, above degree 0,
/// `.sh_rest`.
///
/// Scales are the root mean square distance to the three nearest points, rotations the identity, opacities 0.1. The
/// points' colours set the constant harmonic; higher harmonics are zero.
pub(crate) fn insert_gaussians<T: Real>(
    state: &mut ModelState<T>,
    population: &str,
    points: &PointCloud,
    sh_degree: usize,
    scene: &SceneFacts,
) {
    let count = points.len();
    let tensor = |row: &[usize], values: Vec<f64>| {
        let shape = [&[count], row].concat();
        Tensor::from_vec(shape, values.into_iter().map(T::from_f64).collect())
    };
    let positions = points.positions.iter().flatten().map(|&value| f64::from(value)).collect();
    let log_scales = nearest_scales(points, scene).iter().flat_map(|scale| [scale.ln(); 3]).collect();
    let color = |&value: &u8| (f64::from(value) / 255.0 - 0.5) / f64::from(SH_C0);
    let mut insert = |attribute: &str, tensor: Tensor<T>| state.insert(format!("{population}.{attribute}"), tensor);
    insert("positions", tensor(&[3], positions));
    insert("log_scales", tensor(&[3], log_scales));
    insert("rotations", tensor(&[4], [1.0, 0.0, 0.0, 0.0].repeat(count)));
    insert("opacity_logits", tensor(&[1], vec![logit(INITIAL_OPACITY); count]));
    insert("sh_dc", tensor(&[1, 3], points.colors.iter().flatten().map(color).collect()));
    let rest = (sh_degree + 1).pow(2) - 1;
    if rest > 0 {
        insert("sh_rest", Tensor::zeros([count, rest, 3]));
    }
}

/// The root mean square distance of each point to its three nearest neighbours; [`LONE_SCALE`] for a point without
/// neighbours.
pub(crate) fn nearest_scales(points: &PointCloud, scene: &SceneFacts) -> Vec<f64> {
    let positions: Vec<[f64; 3]> = points.positions.iter().map(|point| point.map(f64::from)).collect();
    if positions.len() < 2 {
        return vec![LONE_SCALE * scene.extent; positions.len()];
    }
    let smallest = MIN_SQUARED_DISTANCE * scene.unit_world.powi(2);
    let tree = PointTree::new(&positions);
    let scale = |point: &[f64; 3]| {
        // The nearest point is the point itself (or a duplicate at distance 0).
        let found = tree.nearests(point, NEIGHBORS + 1);
        let squared: f64 = found.iter().skip(1).map(|neighbor| neighbor.squared_distance).sum();
        (squared / (found.len() - 1) as f64).max(smallest).sqrt()
    };
    positions.par_iter().map(scale).collect()
}

/// The logit ln(p / (1 − p)).
pub(crate) fn logit(share: f64) -> f64 {
    (share / (1.0 - share)).ln()
}
