//! Hooks that a method runs between steps.

use dyn_clone::DynClone;
use shaders::tape::Tensor;

use super::screen::ScreenStats;
use crate::data::{SceneFacts, StepRandom};
use crate::model::Optimizer;

/// Runs between the steps of a phase: e.g. density control or annealing. Every method has an empty default, so a
/// hook implements only what it needs. Its state is part of every checkpoint.
pub(crate) trait StepHook: DynClone + Send {
    /// Whether [`StepHook::observe`] and [`StepHook::observe_value`] must be called in step `iteration` (counted from 1
    /// within the phase).
    fn observes_at(&self, _iteration: u64) -> bool {
        false
    }

    /// Observes the renders of a step and their gradients, once per population, before the optimizer's step.
    fn observe(&mut self, _stats: &ScreenStats<'_>) {}

    /// Observes a value that the method measured in the step ([`Step::measure`](super::Step::measure)).
    fn observe_value(&mut self, _name: &str, _value: &Tensor<f32>) {}

    /// Whether [`StepHook::after_step`] reads values of rows on the host after step `iteration`, so that all pending
    /// steps must be checked first.
    fn reads_rows_at(&self, _iteration: u64) -> bool {
        false
    }

    /// The surveys that [`StepHook::after_step`] needs after step `iteration`. [`StepHook::reads_rows_at`] must be
    /// true in such a step.
    fn surveys_at(&self, _iteration: u64) -> Vec<Survey> {
        Vec::new()
    }

    /// Runs after the optimizer's step.
    fn after_step(&mut self, _step: AfterStep<'_>) -> anyhow::Result<()> {
        Ok(())
    }

    /// The state of the hook, for a checkpoint; null for a hook without state.
    fn save(&self) -> serde_json::Value {
        serde_json::Value::Null
    }

    /// Restores the state from a checkpoint.
    fn restore(&mut self, _saved: serde_json::Value) -> anyhow::Result<()> {
        Ok(())
    }
}

dyn_clone::clone_trait_object!(StepHook);

/// A measurement of every Gaussian over renders of several training views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Survey {
    /// The squared gradient of the render with respect to a factor on the Gaussian's opacity, summed over pixels and
    /// views.
    Sensitivity {
        /// Number of training views, evenly over time.
        views: usize,
    },
    /// The sum of the Gaussian's weights in the pixels with a high error, px; mean over the views in which it is not hidden.
    HighError {
        /// Number of training views, evenly over time.
        views: usize,
        /// The error of a pixel, mean over the channels of |render − image|, is high above this share of the way from the
        /// smallest to the largest of its view.
        above: f64,
        /// Whether each view is weighted by its photometric loss.
        by_loss: bool,
    },
}

/// The detail of the images that a step trains on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Detail {
    /// The factor by which width and height are reduced; 1 for the full size.
    pub reduction: usize,
    /// The share of all steps that have passed, in [0, 1].
    pub progress: f64,
    /// Whether a budget that grows with the size of the images limits the number of Gaussians.
    pub limits_growth: bool,
}

/// The values that a [`StepHook`] may read and change after the optimizer's step.
pub(crate) struct AfterStep<'a> {
    /// The completed step, counted from 1 within the phase.
    pub iteration: u64,
    /// The model's tensors and their moments.
    pub optimizer: &'a mut Optimizer,
    /// The detail of the step's images, with the effect `coarse-to-fine`.
    pub detail: Option<Detail>,
    /// The surveys that the hook requested, in order, with a value per splat each.
    pub surveys: Vec<(Survey, Vec<f32>)>,
    /// The scene.
    pub scene: &'a SceneFacts,
    /// Random numbers, by purpose.
    pub random: &'a mut StepRandom,
    /// Notices about the training for the report; one entry per event.
    pub notices: &'a mut Vec<String>,
}
