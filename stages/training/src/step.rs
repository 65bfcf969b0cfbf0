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
    /// What the step left out, as far as it is known.
    pub skipped: SkippedWork,
    /// How much of what it did not leave out, of how much.
    pub kept: Vec<(&'static str, Tensor<T>, usize)>,
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
    let kept = step.kept.iter().map(|&(what, kept, of)| (what, step.tape.value(kept).clone(), of)).collect();
    Ok(StepOutcome { values, gradients, skipped: step.skipped, kept, renders: step.renders })
}

impl<T: Real> StepOutcome<T> {
    /// Weighted losses by name, summed over views, and all that was left out; a GPU is waited for.
    pub fn look(&self) -> (BTreeMap<&'static str, f64>, SkippedWork) {
        let losses = self.values.iter().map(|(.., value)| value);
        let tensors: Vec<&Tensor<T>> = losses.chain(self.kept.iter().map(|(_, kept, _)| kept)).collect();
        let mut values = first_elements(&tensors).into_iter().map(T::to_f64);
        let weights = self.values.iter().map(|(name, weight, _)| (*name, *weight));
        let losses = sum_by_name(weights.zip(values.by_ref()));
        let mut skipped = self.skipped.clone();
        for ((what, _, of), kept) in self.kept.iter().zip(values) {
            add_kept(&mut skipped, what, kept, *of);
        }
        (losses, skipped)
    }

    /// Weighted losses by name, summed over views; a GPU is waited for.
    pub fn losses(&self) -> BTreeMap<&'static str, f64> {
        self.look().0
    }

    /// The sum of the weighted losses; a GPU is waited for.
    pub fn total(&self) -> f64 {
        self.losses().values().sum()
    }
}

/// Counts what was left out where `kept` of so much was not: a whole number, but for rounding.
pub fn add_kept(skipped: &mut SkippedWork, what: &'static str, kept: f64, of: usize) {
    let [left_out, all] = skipped.entry(what).or_default();
    *left_out += of as u64 - kept.round() as u64;
    *all += of as u64;
}

/// Weighted values by name.
pub fn sum_by_name(losses: impl Iterator<Item = ((&'static str, f64), f64)>) -> BTreeMap<&'static str, f64> {
    let mut sums = BTreeMap::new();
    losses.for_each(|((name, weight), value)| *sums.entry(name).or_default() += weight * value);
    sums
}
