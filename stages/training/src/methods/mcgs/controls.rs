//! Values that change per step without being learnt: the mixing shares, the noise level and the visibility of every
//! node. They are model tensors, so that checkpoints and renders include them.

use shaders::arrays::rows::columns;
use shaders::geometry::neighbor_blend::{Neighbors, blend};
use shaders::pointwise;
use shaders::tape::{Real, Tape, Tensor};

use super::settings::Settings;
use super::{NOISE, SHARES, VISIBILITY};
use crate::method::{AfterStep, StepHook};
use crate::model::ModelState;
use crate::schedule::stretch;

/// Number of steps between two measurements of visibility, each of which costs about a render.
pub(crate) const VISIBILITY_INTERVAL: u64 = 10;
/// Weight of one measurement in the running mean of visibility: a memory of about a hundred steps, roughly one pass over
/// a capture.
const VISIBILITY_SHARE: f64 = 0.1;

/// Adds the mixing shares and, if `has_noise`, the noise level and the visibility of the nodes.
pub(crate) fn insert<T: Real>(state: &mut ModelState<T>, settings: &Settings, has_noise: bool) -> anyhow::Result<()> {
    state.insert(SHARES, Tensor::full([2], T::from_f64(settings.mixing.first)));
    if has_noise {
        let nodes = state.get("nodes.positions")?.rows();
        state.insert(NOISE, Tensor::full([1], T::ONE));
        state.insert(VISIBILITY, Tensor::full([nodes, 1], T::ONE));
    }
    Ok(())
}

/// Raises the mixing shares and lowers the noise, both linearly in the iteration.
#[derive(Clone)]
pub(crate) struct Ramp {
    shares: [f64; 3],
    shares_until: u64,
    noise_until: u64,
}

impl Ramp {
    /// The ramp of a phase that begins after `steps_before` steps of the same schedule.
    pub(crate) fn new(settings: &Settings, steps_before: u64, schedule_scale: f64) -> Self {
        let left = |until: u64| stretch(until.saturating_sub(steps_before), schedule_scale).max(1);
        let mixing = &settings.mixing;
        Self {
            shares: [mixing.first, mixing.position, mixing.rotation],
            shares_until: left(mixing.until),
            noise_until: left(settings.noise.until),
        }
    }

    /// The mixing shares [λ_pos, λ_rot] after `iteration` steps.
    pub(super) fn shares_at(&self, iteration: u64) -> [f64; 2] {
        let [first, position, rotation] = self.shares;
        let progress = (iteration as f64 / self.shares_until as f64).min(1.0);
        [position, rotation].map(|last| first + (last - first) * progress)
    }

    pub(super) fn noise_at(&self, iteration: u64) -> f64 {
        (1.0 - iteration as f64 / self.noise_until as f64).max(0.0)
    }
}

impl StepHook for Ramp {
    fn after_step(&mut self, AfterStep { iteration, optimizer, .. }: AfterStep<'_>) -> anyhow::Result<()> {
        let shares = self.shares_at(iteration).map(|share| share as f32);
        optimizer.edit(SHARES, |values| values.copy_from_slice(&shares))?;
        if optimizer.tensor(NOISE).is_ok() {
            optimizer.edit(NOISE, |left| left.fill(self.noise_at(iteration) as f32))?;
        }
        Ok(())
    }
}

/// Maintains a running mean of the visible share of the weight of every node's Gaussians.
#[derive(Clone)]
pub(crate) struct Visibility {
    per_gaussian: usize,
    /// First iteration at which visibility is no longer needed, because no noise is left.
    noise_until: u64,
    /// [N, 2], sums over the views of a step: the visible and the whole weight of every Gaussian.
    pub(super) seen: Option<Tensor<f32>>,
}

impl Visibility {
    /// Observes Gaussians that follow `per_gaussian` nodes each, as long as the ramp has noise left.
    pub(crate) fn new(per_gaussian: usize, ramp: &Ramp) -> Self {
        Self { per_gaussian, noise_until: ramp.noise_until, seen: None }
    }
}

impl StepHook for Visibility {
    fn observes_at(&self, iteration: u64) -> bool {
        iteration < self.noise_until
    }

    fn observe_value(&mut self, name: &str, value: &Tensor<f32>) {
        if name == VISIBILITY {
            match &mut self.seen {
                Some(seen) => seen.make_mut().iter_mut().zip(value.as_slice()).for_each(|(sum, new)| *sum += new),
                None => self.seen = Some(value.clone()),
            }
        }
    }

    fn after_step(&mut self, AfterStep { optimizer, .. }: AfterStep<'_>) -> anyhow::Result<()> {
        let Some(seen) = self.seen.take() else { return Ok(()) };
        let [gaussians, nodes, before] =
            ["gaussians.positions", "nodes.positions", VISIBILITY].map(|name| optimizer.tensor(name));
        let neighbors = Neighbors::nearest(gaussians?, nodes?, self.per_gaussian);
        let after = updated_visibility(&seen, before?, &neighbors);
        optimizer.set_values(VISIBILITY, after)
    }
}

pointwise! {
    /// The running mean `before`, updated with the value seen / all; unchanged where all is 0.
    fn updated_mean(before, seen, all) with(share) -> y {
        return select(before + share * (seen / all - before), before, all == 0.0);
    }
    gradients(dy) {
        before: { return select((1.0 - share) * dy, dy, all == 0.0); }
        seen: { return select(share / all * dy, 0.0, all == 0.0); }
        all: { return select(-share * seen / (all * all) * dy, 0.0, all == 0.0); }
    }
}

/// The running means [M, 1] updated with the visible and the whole weights [N, 2] of one step, on their device.
fn updated_visibility(seen: &Tensor<f32>, before: &Tensor<f32>, neighbors: &Neighbors) -> Tensor<f32> {
    let (gaussians, nodes) = (neighbors.points(), neighbors.nodes());
    let mut tape = Tape::new(seen.device());
    // The gradient of a blend with weights of 1 sums over the Gaussians that follow each node.
    let weights = tape.constant(Tensor::full([gaussians, neighbors.per_point()], 1.0));
    let of_nodes = tape.leaf(Tensor::zeros([nodes, 2]));
    let blended = blend(&mut tape, weights, of_nodes, neighbors);
    let sums = tape.backward(&[(blended, seen.clone())]).take(of_nodes).expect("a leaf");
    let sums = tape.constant(sums);
    let [seen, all] = [0, 1].map(|column| columns(&mut tape, sums, column..column + 1));
    let before = tape.constant(before.clone());
    let after = updated_mean(&mut tape, before, seen, all, VISIBILITY_SHARE);
    tape.value(after).clone()
}

#[cfg(test)]
mod tests {
    use shaders::check::test_gpu;
    use shaders::tape::Device;

    use super::*;

    #[test]
    fn visibility_is_a_running_mean_of_visible_weights() {
        let tensor = |shape: [usize; 2], values: &[f32]| Tensor::from_vec(shape, values.to_vec());
        let gaussians = tensor([4, 1], &[0.0, 0.1, 0.2, 1.0]);
        let nodes = tensor([3, 1], &[0.0, 1.0, 9.0]);
        let weights = tensor([4, 2], &[0.9, 0.9, 0.0, 0.2, 0.1, 0.4, 0.0, 0.6]);
        let before = tensor([3, 1], &[0.5, 1.0, 0.25]);
        for device in [Some(Device::Cpu), test_gpu().map(Device::Gpu)].into_iter().flatten() {
            let [weights, before] = [&weights, &before].map(|tensor| tensor.clone().moved_to(device));
            let after = updated_visibility(&weights, &before, &Neighbors::nearest(&gaussians, &nodes, 1));
            let expected = [0.5 + 0.1 * (1.0 / 1.5 - 0.5), 0.9, 0.25];
            assert!(after.as_slice().iter().zip(expected).all(|(a, b)| (a - b).abs() <= 1e-6), "{after:?}");
        }
    }

    #[test]
    fn shares_grow_and_noise_fades_linearly() {
        let ramp = Ramp::new(&Settings::default(), 3000, 0.5);
        assert_eq!(ramp.shares_at(0), [0.0; 2]);
        assert_eq!(ramp.shares_at(3000), [0.25; 2]);
        assert_eq!(ramp.shares_at(6000), [0.5; 2]);
        assert_eq!(ramp.shares_at(60_000), [0.5; 2]);
        assert_eq!([0, 4250, 8500, 10_000].map(|iteration| ramp.noise_at(iteration)), [1.0, 0.5, 0.0, 0.0]);
    }
}
