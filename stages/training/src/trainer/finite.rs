//! Checks that end a training at the step where a value stops being finite, with the name of the value.

use std::collections::BTreeMap;

use engine::{Failure, FailureKind};
use shaders::rasteriser;
use shaders::tape::{Tape, Tensor};

use super::Trainer;
use crate::artifact::{LargestGradient, NamedTensor};
use crate::model::Optimizer;

impl Trainer<'_> {
    /// Every loss must be finite, and so must every rendered splat: the rasteriser would silently leave out the others.
    pub(super) fn check_losses(&self, losses: &BTreeMap<&str, f64>, tape: &Tape<f32>) -> anyhow::Result<()> {
        if let Some(name) = losses.iter().find(|(_, value)| !value.is_finite()).map(|(name, _)| name) {
            return Err(self.not_finite(&format!("loss {name}"), Some(tape)));
        }
        match tape.profile().events.get(rasteriser::NOT_FINITE) {
            Some(count) => Err(self.not_finite(&format!("a value of {count} splats"), Some(tape))),
            None => Ok(()),
        }
    }

    /// Every gradient must be finite; records the largest magnitudes.
    pub(super) fn check_gradients(
        &mut self,
        gradients: &BTreeMap<&str, Tensor<f32>>,
        tape: &Tape<f32>,
    ) -> anyhow::Result<()> {
        let largest = Optimizer::largest_magnitudes(gradients);
        if let Some(name) = largest.iter().find(|(_, magnitude)| !magnitude.is_finite()).map(|(name, _)| name) {
            return Err(self.not_finite(&format!("gradient of {name}"), Some(tape)));
        }
        self.telemetry.record_gradients(self.phase_name(), self.state.iteration, largest);
        Ok(())
    }

    /// Every tensor must be finite.
    pub(super) fn check_tensors(&self) -> anyhow::Result<()> {
        match self.state.optimizer.first_bad_tensor() {
            Some(name) => Err(self.not_finite(name, None)),
            None => Ok(()),
        }
    }

    /// Every value and moment of a checkpoint must be finite.
    pub(super) fn check_checkpoint(&self, tensors: &BTreeMap<String, NamedTensor>) -> anyhow::Result<()> {
        let is_bad = |tensor: &NamedTensor| !tensor.values.iter().all(|value| value.is_finite());
        match tensors.iter().find(|(_, tensor)| is_bad(tensor)) {
            Some((name, _)) => Err(self.not_finite(&format!("{name} in the checkpoint"), None)),
            None => Ok(()),
        }
    }

    /// The error for a value that is not finite. It names the value, the step, and the origin: a tensor of the model,
    /// the first operation with such an output, or the backward pass.
    fn not_finite(&self, what: &str, tape: Option<&Tape<f32>>) -> anyhow::Error {
        let origin = match (self.state.optimizer.first_bad_tensor(), tape.map(Tape::first_non_finite_op)) {
            (Some(tensor), Some(_)) => format!("because {tensor} was not finite before the step"),
            (_, Some(Some(op))) => format!("first in the output of {op}"),
            (_, Some(None)) => "first in the backward pass".into(),
            (_, None) => "after a finite gradient".into(),
        };
        let largest = self
            .telemetry
            .history
            .largest_gradients
            .iter()
            .max_by(|(_, a), (_, b)| a.magnitude.total_cmp(&b.magnitude));
        let before = largest.map(|(name, largest)| {
            let LargestGradient { magnitude, phase, iteration } = largest;
            format!("; the largest gradient before was {magnitude:.1e}, of {name} at iteration {iteration} of {phase}")
        });
        let (phase, iteration) = (self.phase_name(), self.state.iteration);
        let message = format!(
            "{what} is not finite at iteration {iteration} of phase {phase} ({origin}{})",
            before.unwrap_or_default()
        );
        let hint = "lower the learning rates, or the weights of losses that differ from the defaults; the training is not \
                    restarted because that would hide the cause";
        Failure::new(FailureKind::Diverged, message).hint(hint).into()
    }

    /// A model must keep at least one Gaussian.
    pub(super) fn check_not_empty(&self) -> anyhow::Result<()> {
        if self.state.optimizer.has_rows() {
            return Ok(());
        }
        let (phase, iteration) = (self.phase_name(), self.state.iteration);
        let message = format!("no Gaussians left after iteration {iteration} of phase {phase}");
        let hint = "lower density.min_opacity, or give more initial points inside the cameras' view";
        Err(Failure::new(FailureKind::Diverged, message).hint(hint).into())
    }
}
