//! Noise on what the chain predicts, annealed, and stronger for nodes whose Gaussians are seldom seen (equations 6 and 7).

use rand_distr::{Distribution as _, StandardNormal};
use serde::{Deserialize, Serialize};
use shaders::pointwise::add;
use shaders::quaternion;
use shaders::tape::{Real, Tensor};

use super::controls::{NOISE, VISIBILITY};
use super::motion::{NodeMotion, Predictions};
use crate::method::Step;

/// How strong, and until when.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NoiseSettings {
    /// First standard deviation of positions, as a share of the scene's extent.
    pub position: f64,
    /// First standard deviation of quaternions.
    pub rotation: f64,
    /// The iteration at which nothing is left, counted from the start of the training.
    pub until: u64,
}

impl Default for NoiseSettings {
    fn default() -> Self {
        Self { position: 5e-3, rotation: 0.02, until: 20_000 }
    }
}

/// Δμ + η·N(0, σ²) and SLERP(Δq, Δq + N(0, σ²), η_q) of the chained motion of one time; η = 1 + 2(1 − visibility) per node,
/// η_q half of it, at most 1.
pub fn disturb<T: Real>(step: &mut Step<'_, T>, predictions: &Predictions, settings: &NoiseSettings) -> Predictions {
    let left = step.tape.value(step.model.get(NOISE)).as_slice()[0].to_f64();
    if left == 0.0 {
        return *predictions;
    }
    let visibility = step.tape.value(step.model.get(VISIBILITY)).as_slice().to_vec();
    let strength: Vec<f64> = visibility.iter().map(|seen| 1.0 + 2.0 * (1.0 - seen.to_f64())).collect();
    let position = left * settings.position * step.scene.extent;
    let shifts = draws::<T>(step, 3, |node| position * strength[node]);
    let turns = draws::<T>(step, 4, |_| left * settings.rotation);
    let shares = strength.iter().map(|strength| T::from_f64((0.5 * strength).clamp(0.0, 1.0))).collect();
    let [shifts, turns, shares] =
        [shifts, turns, Tensor::from_vec([strength.len(), 1], shares)].map(|tensor| step.tape.constant(tensor));
    let NodeMotion { translations, rotations } = predictions.chained;
    let translations = add(step.tape, translations, shifts);
    let turned = add(step.tape, rotations, turns);
    let rotations = quaternion::slerp(step.tape, rotations, turned, shares);
    Predictions { chained: NodeMotion { translations, rotations }, ..*predictions }
}

/// [M, columns] normal draws, each row with its own standard deviation.
fn draws<T: Real>(step: &mut Step<'_, T>, columns: usize, deviation: impl Fn(usize) -> f64) -> Tensor<T> {
    let nodes = step.tape.value(step.model.get(VISIBILITY)).rows();
    let mut values = Vec::with_capacity(nodes * columns);
    for at in 0..nodes * columns {
        let standard: f64 = StandardNormal.sample(step.random);
        values.push(T::from_f64(deviation(at / columns) * standard));
    }
    Tensor::from_vec([nodes, columns], values)
}
