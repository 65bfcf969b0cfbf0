//! Candidates for nodes: isotropic Gaussians that the network moves, so that they gather on moving parts.

use scene::cloud::PointCloud;
use shaders::arrays::rows::{concat_columns, row_sum};
use shaders::pointwise::{add, scale};
use shaders::rasteriser::{ShapeVars, SplatVars};
use shaders::tape::{Real, Tape};

use super::CANDIDATES;
use super::nodes::Nodes;
use crate::bases::canonical::scales_and_rotations;
use crate::bases::gaussians;
use crate::data::SceneFacts;
use crate::method::Moment;
use crate::model::{ModelState, Variables};
use crate::schedule::LogLinear;
use crate::shared::LearningRates;

/// Adds Gaussians at up to `count` of the points, evenly chosen.
pub(crate) fn insert<T: Real>(
    state: &mut ModelState<T>,
    scene: &SceneFacts,
    points: &PointCloud,
    count: usize,
    sh_degree: usize,
) -> anyhow::Result<()> {
    let chosen: Vec<usize> = match points.len() <= count {
        true => (0..points.len()).collect(),
        false => (0..count).map(|at| at * points.len() / count).collect(),
    };
    let points = PointCloud {
        positions: chosen.iter().map(|&at| points.positions[at]).collect(),
        colors: chosen.iter().map(|&at| points.colors[at]).collect(),
    };
    gaussians::insert_gaussians(state, CANDIDATES, &points, sh_degree, gaussians::LONE_SCALE * scene.extent)
}

/// Learning rates of the candidates; isotropic Gaussians have no rotation to train.
pub(crate) fn learning_rate(rates: &LearningRates, tensor: &str, scene: &SceneFacts) -> Option<LogLinear> {
    let rate = gaussians::learning_rate(rates, CANDIDATES, tensor, scene)?;
    (tensor != "candidates.rotations").then_some(rate)
}

/// The candidates at a moment, moved if `nodes` are given.
pub(crate) fn splats<T: Real>(
    tape: &mut Tape<T>,
    model: &Variables,
    nodes: Option<&Nodes>,
    moment: &Moment<'_>,
) -> SplatVars {
    let canonical = gaussians::static_splats(tape, model, CANDIDATES, moment.sh_degree);
    let positions = match nodes {
        Some(nodes) => {
            let shift = nodes.translations(tape, model, canonical.positions, &[moment.time]);
            add(tape, canonical.positions, shift)
        }
        None => canonical.positions,
    };
    let (log_scales, rotations) = scales_and_rotations(&canonical);
    let sums = row_sum(tape, log_scales);
    let mean = scale(tape, sums, 1.0 / 3.0);
    let log_scales = concat_columns(tape, &[mean; 3]);
    SplatVars { positions, shape: ShapeVars::ScaleRotation { log_scales, rotations }, ..canonical }
}
