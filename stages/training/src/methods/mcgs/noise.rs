//! Annealed noise on the chain's prediction, stronger for nodes with rarely visible Gaussians (equations 6 and 7).

use serde::{Deserialize, Serialize};
use shaders::arrays::rows::scale_rows;
use shaders::geometry::camera::PinholeCamera;
use shaders::geometry::quaternion;
use shaders::pointwise;
use shaders::pointwise::{add, scale, shift};
use shaders::tape::{Real, Tensor};

use super::node_motion::{NodeMotion, Predictions};
use super::{NOISE, VISIBILITY};
use crate::bases::layers::normal;
use crate::method::Step;

/// Strength and duration of the noise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct NoiseSettings {
    /// Initial standard deviation of positions, px of an image at the distance of one extent of the scene. In lengths
    /// of the scene, noise of one pixel in an image of 800 px would be an eighth of a pixel in an image of 100 px.
    pub position_px: f64,
    /// Initial standard deviation of quaternions.
    pub rotation: f64,
    /// The iteration at which the noise reaches zero, counted from the start of the warm-up.
    pub until: u64,
}

impl Default for NoiseSettings {
    fn default() -> Self {
        Self { position_px: 5.0, rotation: 0.1, until: 20_000 }
    }
}

impl NoiseSettings {
    /// The initial standard deviation of positions in the images of a camera, scene units.
    pub(super) fn position_world(&self, extent: f64, camera: &PinholeCamera) -> f64 {
        self.position_px * extent / camera.focal[0]
    }
}

/// The remaining share of the noise.
pub(crate) fn left<T: Real>(step: &Step<'_, T>) -> f64 {
    step.tape.value(step.model.get(NOISE)).as_slice()[0].to_f64()
}

/// Adds noise to the chained motion of one time: Δμ + η·N(0, σ²) and SLERP(Δq, Δq + N(0, σ²), η_q), with η = 1 + 2(1 −
/// visibility) per node and η_q half of it, at most 1.
pub(crate) fn disturb<T: Real>(
    step: &mut Step<'_, T>,
    predictions: &Predictions,
    settings: &NoiseSettings,
    camera: &PinholeCamera,
) -> Predictions {
    let left = left(step);
    if left == 0.0 {
        return *predictions;
    }
    let visibility = step.model.get(VISIBILITY);
    let scaled = scale(step.tape, visibility, -2.0);
    let strength = shift(step.tape, scaled, 3.0);
    let shares = at_most_one(step.tape, strength, 0.5);
    let position = left * settings.position_world(step.scene.extent, camera);
    let [shifts, turns] = [(3, position), (4, left * settings.rotation)].map(|(columns, deviation)| {
        let draws = draws(step, columns, deviation);
        step.tape.constant(draws)
    });
    let shifts = scale_rows(step.tape, shifts, strength);
    let NodeMotion { translations, rotations } = predictions.chained;
    let translations = add(step.tape, translations, shifts);
    let turned = add(step.tape, rotations, turns);
    let rotations = quaternion::slerp(step.tape, rotations, turned, shares);
    Predictions { chained: NodeMotion { translations, rotations }, ..*predictions }
}

/// [M, columns] normal samples with this standard deviation.
fn draws<T: Real>(step: &mut Step<'_, T>, columns: usize, deviation: f64) -> Tensor<T> {
    let nodes = step.tape.value(step.model.get(VISIBILITY)).rows();
    normal(&[nodes, columns], deviation, step.random.of("noise"))
}

pointwise! {
    /// y = min(factor·x, 1)
    fn at_most_one(x) with(factor) -> y {
        return min(factor * x, 1.0);
    }
    gradients(dy) {
        x: { return select(0.0, factor * dy, factor * x < 1.0); }
    }
}
