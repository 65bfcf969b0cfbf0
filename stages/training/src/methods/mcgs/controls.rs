//! What changes from step to step without being learnt, kept in the model so that a checkpoint and a render know it: the
//! shares of the mixture, what is left of the noise, and how visible every node is.

use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use shaders::neighbor_blend::Neighbors;
use shaders::tape::{Real, Tensor};

use super::settings::Settings;
use crate::bases::gaussians::GAUSSIANS;
use crate::method::{PopulationControl, SceneFacts};
use crate::optimizer::Optimizer;
use crate::schedule::stretch;
use crate::screen::Screen;
use crate::state::ModelState;

/// [2]: λ_pos and λ_rot.
pub const SHARES: &str = "mixing.shares";
/// [1]: what is left of the noise, 1 to 0.
pub const NOISE: &str = "mixing.noise";
/// [M, 1]: a running mean of the share of a node's Gaussians that a step's view saw, 1 at first.
pub const VISIBILITY: &str = "nodes.visibility";

/// What one step counts in the running mean: the memory is of a hundred views, about one round through a capture.
const STEP_SHARE: f32 = 0.01;

/// Adds the tensors of this module.
pub fn insert<T: Real>(state: &mut ModelState<T>, settings: &Settings, has_noise: bool) -> anyhow::Result<()> {
    state.insert(SHARES, Tensor::full([2], T::from_f64(settings.mixing.first)));
    if has_noise {
        let nodes = state.get("nodes.positions")?.rows();
        state.insert(NOISE, Tensor::full([1], T::ONE));
        state.insert(VISIBILITY, Tensor::full([nodes, 1], T::ONE));
    }
    Ok(())
}

/// Raises the shares and lowers the noise, evenly.
#[derive(Clone)]
pub struct Ramp {
    shares: [f64; 3],
    shares_until: u64,
    noise_until: u64,
}

impl Ramp {
    /// For a phase that begins after `steps_before` steps of the same schedule.
    pub fn new(settings: &Settings, steps_before: u64, schedule_scale: f64) -> Self {
        let left = |until: u64| stretch(until.saturating_sub(steps_before), schedule_scale).max(1);
        let mixing = &settings.mixing;
        Self {
            shares: [mixing.first, mixing.position, mixing.rotation],
            shares_until: left(mixing.until),
            noise_until: left(settings.noise.until),
        }
    }

    /// λ_pos and λ_rot after so many steps.
    fn shares_at(&self, iteration: u64) -> [f64; 2] {
        let [first, position, rotation] = self.shares;
        let progress = (iteration as f64 / self.shares_until as f64).min(1.0);
        [position, rotation].map(|last| first + (last - first) * progress)
    }

    fn noise_at(&self, iteration: u64) -> f64 {
        (1.0 - iteration as f64 / self.noise_until as f64).max(0.0)
    }
}

impl PopulationControl for Ramp {
    fn watches(&self, _iteration: u64) -> bool {
        false
    }

    fn observe(&mut self, _screen: &Screen<'_>) {}

    fn judges(&self, _iteration: u64) -> bool {
        false
    }

    fn act(
        &mut self,
        iteration: u64,
        optimizer: &mut Optimizer,
        _scene: &SceneFacts,
        _random: &mut ChaCha8Rng,
    ) -> anyhow::Result<()> {
        let shares = self.shares_at(iteration).map(|share| share as f32);
        optimizer.edit(SHARES, |values| values.copy_from_slice(&shares))?;
        if optimizer.tensor(NOISE).is_ok() {
            optimizer.edit(NOISE, |left| left.fill(self.noise_at(iteration) as f32))?;
        }
        Ok(())
    }

    fn save(&self) -> Value {
        Value::Null
    }

    fn restore(&mut self, _saved: Value) -> anyhow::Result<()> {
        Ok(())
    }
}

/// Follows how much of every node's Gaussians is seen.
#[derive(Clone)]
pub struct Visibility {
    per_gaussian: usize,
    /// The step after which nobody asks any more.
    noise_until: u64,
    /// Of the step before [`PopulationControl::act`].
    visible: Vec<bool>,
}

impl Visibility {
    /// For Gaussians that follow so many nodes, as long as a ramp has noise left.
    pub fn new(per_gaussian: usize, ramp: &Ramp) -> Self {
        Self { per_gaussian, noise_until: ramp.noise_until, visible: Vec::new() }
    }
}

impl PopulationControl for Visibility {
    fn watches(&self, iteration: u64) -> bool {
        iteration < self.noise_until
    }

    fn observe(&mut self, screen: &Screen<'_>) {
        if screen.population == GAUSSIANS {
            self.visible.clone_from(&screen.on_host().visible);
        }
    }

    fn judges(&self, iteration: u64) -> bool {
        self.watches(iteration)
    }

    fn act(
        &mut self,
        _iteration: u64,
        optimizer: &mut Optimizer,
        _scene: &SceneFacts,
        _random: &mut ChaCha8Rng,
    ) -> anyhow::Result<()> {
        let visible = std::mem::take(&mut self.visible);
        if visible.is_empty() {
            return Ok(());
        }
        let (gaussians, nodes) = (optimizer.tensor("gaussians.positions")?, optimizer.tensor("nodes.positions")?);
        let neighbors = Neighbors::nearest(gaussians, nodes, self.per_gaussian);
        optimizer.edit(VISIBILITY, |means| {
            for (node, mean) in means.iter_mut().enumerate() {
                let (seen, all) = neighbors
                    .followers(node)
                    .fold((0u32, 0u32), |(seen, all), (gaussian, _)| (seen + u32::from(visible[gaussian]), all + 1));
                if all > 0 {
                    *mean += STEP_SHARE * (seen as f32 / all as f32 - *mean);
                }
            }
        })
    }

    fn save(&self) -> Value {
        Value::Null
    }

    fn restore(&mut self, _saved: Value) -> anyhow::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_grow_and_noise_fades_evenly_from_the_start_of_motion() {
        let ramp = Ramp::new(&Settings::default(), 3000, 0.5);
        assert_eq!(ramp.shares_at(0), [0.0; 2]);
        assert_eq!(ramp.shares_at(3000), [0.25; 2]);
        assert_eq!(ramp.shares_at(6000), [0.5; 2]);
        assert_eq!(ramp.shares_at(60_000), [0.5; 2]);
        assert_eq!([0, 4250, 8500, 10_000].map(|iteration| ramp.noise_at(iteration)), [1.0, 0.5, 0.0, 0.0]);
    }
}
