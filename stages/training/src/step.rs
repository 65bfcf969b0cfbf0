//! One forward and backward pass, in any precision.

use std::collections::BTreeMap;

use shaders::tape::{Gradients, Real, Tensor, first_elements};

use crate::method::{Method, NamedLoss, SkippedWork, Step, WatchedRender};

/// What a step computed: its losses, its gradients and what its renders saw.
pub struct StepOutcome<T: Real> {
    /// Name, weight and value of every loss.
    pub values: Vec<(&'static str, f64, Tensor<T>)>,
    /// Gradients of the sum of the weighted losses by everything on the tape.
    pub gradients: Gradients<T>,
    /// What the step left out.
    pub skipped: SkippedWork,
    /// What drives populations.
    pub(crate) renders: Vec<WatchedRender>,
}

/// Evaluates a method's losses on a step and differentiates their sum.
pub fn run_step<T: Real>(method: &dyn Method<T>, mut step: Step<'_, T>) -> anyhow::Result<StepOutcome<T>> {
    method.losses(&mut step)?;
    step.clock.enter("backward");
    let seed = |loss: &NamedLoss| {
        let shape = step.tape.value(loss.value).shape().to_vec();
        (loss.value, Tensor::full(shape, T::from_f64(loss.weight)))
    };
    let seeds: Vec<_> = step.losses.iter().map(seed).collect();
    let gradients = step.tape.backward(&seeds);
    let value = |loss: &NamedLoss| (loss.name, loss.weight, step.tape.value(loss.value).clone());
    let values = step.losses.iter().map(value).collect();
    Ok(StepOutcome { values, gradients, skipped: step.skipped, renders: step.renders })
}

impl<T: Real> StepOutcome<T> {
    /// Weighted losses by name, summed over views; a GPU is waited for.
    pub fn losses(&self) -> BTreeMap<&'static str, f64> {
        let tensors: Vec<&Tensor<T>> = self.values.iter().map(|(.., value)| value).collect();
        let values = first_elements(&tensors).into_iter().map(T::to_f64);
        sum_by_name(self.values.iter().map(|(name, weight, _)| (*name, *weight)).zip(values))
    }

    /// The sum of the weighted losses; a GPU is waited for.
    pub fn total(&self) -> f64 {
        self.losses().values().sum()
    }
}

/// Weighted values by name.
pub fn sum_by_name(losses: impl Iterator<Item = ((&'static str, f64), f64)>) -> BTreeMap<&'static str, f64> {
    let mut sums = BTreeMap::new();
    losses.for_each(|((name, weight), value)| *sums.entry(name).or_default() += weight * value);
    sums
}
