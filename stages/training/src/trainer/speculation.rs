//! Speculative steps: a GPU runs up to [`MAX_PENDING`] steps before the host checks any of them.
//!
//! The trainer takes a snapshot before the first speculative step. No value of a pending step is read back until
//! [`MAX_PENDING`] steps are pending or until the host needs exact values: for a step hook that reads values per
//! Gaussian (density control, pruning), a point of the quality curve, a checkpoint or the end of a phase. Only the few steps
//! that measure the unit of a loss wait for a value. If a value
//! is then not finite, or a render overflowed its intersection buffer, the trainer rolls back to the snapshot and
//! replays the steps in checked mode. An error is therefore reported at the step that causes it, and an overflow never
//! changes a result.

use std::collections::BTreeMap;

use shaders::gpu::Gpu;
use shaders::rasteriser::{MAX_INTERSECTIONS, NOT_FINITE};
use shaders::tape::{PendingReadback, Readback, Tape, Tensor};

use super::Trainer;
use super::influence::InfluenceSample;
use super::telemetry::Telemetry;
use super::train_state::TrainState;
use crate::method::{NormKeys, SkippedWork, StepOutcome, add_processed, sum_by_name};

/// Maximum number of unchecked steps. One readback per 32 steps is negligible, and a rollback wastes little work.
const MAX_PENDING: usize = 32;
/// Intersection buffers hold this multiple of the largest count seen so far …
const CAPACITY_FACTOR: f64 = 1.25;
/// … plus this many intersections, because a few Gaussians can multiply fast.
const EXTRA_CAPACITY: usize = 1 << 14;

/// When the host checks the values of a step.
#[derive(Clone, Copy)]
pub(super) enum Mode {
    /// Before the next step starts.
    Checked,
    /// After several steps; until then the values stay on this GPU.
    Speculative(Gpu),
}

/// The pending steps and the snapshot to roll back to.
pub(super) struct Speculation {
    snapshot: Snapshot,
    pending: Vec<PendingStep>,
}

/// The training before the first pending step.
struct Snapshot {
    state: TrainState,
    telemetry: Telemetry,
}

/// A speculative step whose values the host has not read back yet.
pub(super) struct PendingStep {
    /// Name and weight of every loss.
    losses: Vec<(&'static str, f64)>,
    /// Name and total of each item of work that may be skipped (e.g. rows); the GPU counts how many are processed.
    counts: Vec<(&'static str, usize)>,
    /// Names of the updated tensors.
    gradients: Vec<String>,
    /// The losses and tensors of a sample, if the step was sampled.
    sample: Option<NormKeys>,
    /// The value of every loss, then the processed part of every count, then [gradients, 2]: the largest magnitude of
    /// each gradient and of the updated tensor, then the norms of the sample.
    values: PendingReadback,
}

impl PendingStep {
    /// Takes the deferred counts of the tape and the losses of the step.
    pub(crate) fn new(tape: &mut Tape<f32>, outcome: &StepOutcome<f32>) -> Self {
        let losses = outcome.values.iter().map(|(.., value)| value);
        let processed = outcome.deferred.iter().map(|(_, processed, _)| processed);
        Self {
            losses: outcome.values.iter().map(|(name, weight, _)| (*name, *weight)).collect(),
            counts: outcome.deferred.iter().map(|(what, _, of)| (*what, *of)).collect(),
            gradients: Vec::new(),
            sample: None,
            values: PendingReadback::of(tape, losses.chain(processed).cloned().collect()),
        }
    }

    /// Adds the optimizer's update: the names of its gradients and their magnitudes [gradients, 2].
    pub(crate) fn add_update(&mut self, gradients: BTreeMap<&str, Tensor<f32>>, magnitudes: Tensor<f32>) {
        self.gradients = gradients.into_keys().map(str::to_owned).collect();
        self.values.push(magnitudes);
    }

    /// Adds the gradient norms of a sample, after the update.
    pub(crate) fn add_sample(&mut self, sample: InfluenceSample) {
        sample.norms.into_iter().for_each(|norm| self.values.push(norm));
        self.sample = Some(sample.keys);
    }

    /// Whether the step succeeded: every value that it depends on is finite and no buffer overflowed.
    fn succeeded(&self, found: &Readback) -> bool {
        let sampled = self.sample.as_ref().map_or(0, NormKeys::len);
        let mut own = found.values[..found.values.len() - sampled].iter().flatten();
        own.all(|value| value.is_finite()) && !found.overflowed && !found.events.contains_key(NOT_FINITE)
    }
}

/// Size of the intersection buffers after a render with this many intersections; never more than a GPU can bin.
fn capacity_for(intersections: usize) -> usize {
    ((CAPACITY_FACTOR * intersections as f64) as usize + EXTRA_CAPACITY).min(MAX_INTERSECTIONS as usize)
}

impl Trainer<'_> {
    /// Enlarges the intersection buffers of later speculative renders to suit a render with this many intersections.
    pub(super) fn grow_capacity(&mut self, intersections: usize) {
        if self.device.gpu().is_some() {
            self.capacity = self.capacity.max(capacity_for(intersections));
        }
    }

    /// Takes a snapshot before the first of a series of speculative steps.
    pub(super) fn start_speculation(&mut self) {
        self.speculation.get_or_insert_with(|| {
            let snapshot = Snapshot { state: self.state.clone(), telemetry: self.telemetry.clone() };
            Speculation { snapshot, pending: Vec::new() }
        });
    }

    /// Adds a pending step, and drains where its hooks or the number of pending steps require it. Returns false if it
    /// rolled back, because the replay already ran the hooks of the step.
    pub(super) fn add_pending(&mut self, step: PendingStep) -> anyhow::Result<bool> {
        let speculation = self.speculation.as_mut().expect("a speculative step starts with a snapshot");
        speculation.pending.push(step);
        let is_full = speculation.pending.len() >= MAX_PENDING;
        let iteration = self.state.iteration;
        if is_full || self.state.hooks.iter().any(|hook| hook.reads_rows_at(iteration)) {
            return self.check_pending();
        }
        Ok(true)
    }

    /// Waits for all pending steps and checks them, so that the state is exact.
    pub(super) fn drain(&mut self) -> anyhow::Result<()> {
        self.check_pending().map(drop)
    }

    /// Reads back all pending steps and records them; if one failed, rolls back and replays instead. Returns whether
    /// all of them succeeded.
    fn check_pending(&mut self) -> anyhow::Result<bool> {
        let Some(speculation) = self.speculation.take() else { return Ok(true) };
        self.clock.enter("waiting for the device");
        let found = PendingReadback::read(speculation.pending.iter().map(|step| &step.values));
        if !speculation.pending.iter().zip(&found).all(|(step, found)| step.succeeded(found)) {
            self.roll_back(speculation)?;
            return Ok(false);
        }
        let first = speculation.snapshot.state.iteration + 1;
        for (iteration, (step, found)) in (first..).zip(speculation.pending.iter().zip(found)) {
            self.record_pending(iteration, step, &found);
        }
        Ok(true)
    }

    /// Records the values of a pending step that succeeded.
    fn record_pending(&mut self, iteration: u64, step: &PendingStep, found: &Readback) {
        self.grow_capacity(found.intersections);
        self.telemetry.record_events(found.events.iter().map(|(what, count)| (*what, *count)));
        let (losses, rest) = found.values.split_at(step.losses.len());
        let values = losses.iter().map(|value| f64::from(value[0]));
        let phase = self.phase_name();
        self.telemetry.record_losses(phase, &sum_by_name(step.losses.iter().copied().zip(values)));
        let (processed, magnitudes) = rest.split_at(step.counts.len());
        let mut skipped = SkippedWork::new();
        for ((what, of), processed) in step.counts.iter().zip(processed) {
            add_processed(&mut skipped, what, f64::from(processed[0]), *of);
        }
        self.telemetry.record_skipped(&skipped);
        let of_gradients = magnitudes[0].chunks_exact(2).map(|pair| pair[0]);
        let gradients = step.gradients.iter().map(String::as_str).zip(of_gradients);
        self.telemetry.record_gradients(phase, iteration, gradients);
        if let Some(keys) = &step.sample {
            let norms = magnitudes[1..].iter().map(|norm| f64::from(norm[0]));
            self.telemetry.record_influence(phase, iteration, &keys.squared_by_loss(norms));
        }
    }

    /// Restores the snapshot and replays the steps since then in checked mode, including one that failed half-way.
    pub(super) fn roll_back(&mut self, speculation: Speculation) -> anyhow::Result<()> {
        let last = self.state.iteration;
        Snapshot { state: self.state, telemetry: self.telemetry } = speculation.snapshot;
        while self.state.iteration < last {
            self.step(Mode::Checked)?;
        }
        Ok(())
    }

    /// Number of pending steps.
    #[cfg(test)]
    pub(super) fn pending_steps(&self) -> usize {
        self.speculation.as_ref().map_or(0, |speculation| speculation.pending.len())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buffers_hold_more_than_the_last_render_and_no_more_than_a_gpu_can_bin() {
        assert_eq!(capacity_for(1000), 1250 + EXTRA_CAPACITY);
        let limit = MAX_INTERSECTIONS as usize;
        for legal in [215_000_000, limit] {
            assert!((legal..=limit).contains(&capacity_for(legal)), "{legal}");
        }
    }
}
