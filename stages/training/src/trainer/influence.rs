//! Samples the gradient of every loss separately, a few times per phase.
//!
//! A phase is divided into slots. In each, the first step with a given loss is sampled, so losses that act only every
//! n-th step are sampled as often as others. A later step of a slot samples only the losses that the slot still lacks. Nothing
//! that a later step reads changes, and nothing waits for a GPU.

use shaders::tape::{Tape, Tensor, first_elements};

use super::Trainer;
use crate::method::{NamedLoss, NormKeys, gradient_norms};
use crate::model::Variables;

/// The clock's activity of sampling, which training seconds exclude, as they exclude the evaluation.
pub(crate) const SAMPLING: &str = "influence";

/// Steps of a phase per sample: a sample costs one more backward pass per loss, i.e. up to five steps in all.
const STEPS_PER_SAMPLE: u64 = 500;
/// Minimum and maximum number of samples of a loss in a phase. One sample could miss a loss that acts in half of a phase.
const SAMPLES: [u64; 2] = [2, 16];

/// The squared gradient norms of one step.
pub(super) struct InfluenceSample {
    /// The losses and tensors of the norms.
    pub keys: NormKeys,
    /// One value per key.
    pub norms: Vec<Tensor<f32>>,
}

/// The slot of a step, from 0 (before the first sample) to the number of samples. Slots begin at odd multiples of half
/// a slot's length: the first step of a phase is not typical.
fn slot(iteration: u64, iterations: u64) -> u64 {
    let samples = (iterations / STEPS_PER_SAMPLE).clamp(SAMPLES[0], SAMPLES[1]);
    (2 * iteration * samples + iterations) / (2 * iterations)
}

impl Trainer<'_> {
    /// The norms of this step, if one of its losses is due. A single loss has nothing to be compared with.
    pub(super) fn sample_influence(
        &mut self,
        tape: &mut Tape<f32>,
        losses: &[NamedLoss],
        model: &Variables,
    ) -> Option<InfluenceSample> {
        let slot = slot(self.state.iteration, self.setup.phases[self.state.phase].iterations);
        let sampled = &mut self.telemetry.history.sampled_slots;
        let is_due = |loss: &&NamedLoss| sampled.get(loss.name).is_none_or(|&last| last < slot);
        let compares = losses.iter().any(|loss| loss.name != losses[0].name);
        let due: Vec<NamedLoss> = losses.iter().filter(is_due).cloned().collect();
        if !self.setup.samples_influence || slot == 0 || !compares || due.is_empty() {
            return None;
        }
        sampled.extend(due.iter().map(|loss| (loss.name.to_owned(), slot)));
        self.clock.enter(SAMPLING);
        let device = tape.device();
        let (keys, norms) = gradient_norms(tape, &due, model, |loss, elapsed| {
            if device.gpu().is_none() {
                let cost = self.telemetry.backward.entry(loss).or_default();
                cost.calls += 1;
                cost.secs += elapsed.as_secs_f64();
            }
        });
        Some(InfluenceSample { keys, norms })
    }

    /// Reads back and records the norms of a checked step.
    pub(super) fn record_sample(&mut self, sample: &InfluenceSample) {
        let norms: Vec<&Tensor<f32>> = sample.norms.iter().collect();
        let scaled = first_elements(&norms).into_iter().map(f64::from);
        let (phase, iteration) = (self.phase_name(), self.state.iteration);
        self.telemetry.record_influence(phase, iteration, &sample.keys.squared_by_loss(scaled));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_cover_a_phase_evenly() {
        let starts = |iterations: u64| -> Vec<u64> {
            (1..=iterations).filter(|&at| slot(at, iterations) > slot(at - 1, iterations)).collect()
        };
        assert_eq!(starts(80), [20, 60]);
        assert_eq!([1000, 1500, 14_000].map(|steps| starts(steps).len()), [2, 3, 16]);
        assert_eq!(starts(1), [1], "a phase may have fewer steps than samples");
    }
}
