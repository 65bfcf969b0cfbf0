//! The state of a training: the one value that a training step changes.
//!
//! A checkpoint saves it, a rollback assigns an earlier clone of it. Saving destructures the state and restoring
//! builds it from all fields, so a new field does not compile until both handle it.

use std::collections::BTreeMap;

use anyhow::ensure;
use serde::{Deserialize, Serialize};

use super::setup::Setup;
use crate::artifact::NamedTensor;
use crate::data::ViewSampler;
use crate::method::{LossUnits, StepHook};
use crate::model::{ModelState, Optimizer};

/// Everything that the next step depends on besides the [`Setup`].
#[derive(Clone)]
pub(super) struct TrainState {
    /// Index of the running phase.
    pub phase: usize,
    /// Steps completed in that phase.
    pub iteration: u64,
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
    /// The model's tensors with their moments.
    pub optimizer: Optimizer,
    /// The step hooks of the phase with their statistics.
    pub hooks: Vec<Box<dyn StepHook>>,
    /// The order of the training views.
    pub sampler: ViewSampler,
    /// The units of losses in the phase.
    pub units: LossUnits,
}

/// A [`TrainState`] as a checkpoint stores it, without the tensors of the optimizer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct SavedState {
    /// Index of the running phase.
    pub phase: usize,
    /// Steps completed in that phase.
    pub iteration: u64,
    /// Spherical-harmonics degree in use.
    pub sh_degree: usize,
    /// Optimizer steps taken per tensor.
    pub optimizer_steps: BTreeMap<String, u64>,
    /// Saved statistics, one value per step hook.
    pub hooks: Vec<serde_json::Value>,
    /// The order of the training views.
    pub sampler: ViewSampler,
    /// The units of losses in the phase.
    pub units: LossUnits,
}

impl TrainState {
    /// The start of a phase on the model that the previous phase ended with. Phases share nothing else but the degree
    /// of the harmonics: every random stream restarts, so a phase does not depend on which job ran the earlier ones.
    pub(crate) fn enter_phase(
        setup: &Setup<'_>,
        phase: usize,
        model: ModelState<f32>,
        sh_degree: usize,
    ) -> anyhow::Result<Self> {
        let name = setup.phases[phase].name;
        let streams = setup.streams();
        let model = setup.method.enter_phase(name, model, &setup.start, streams)?;
        Ok(Self {
            phase,
            iteration: 0,
            sh_degree,
            optimizer: Optimizer::new(model, setup.learning_rates(phase)),
            hooks: setup.method.hooks(name, setup.start.scene()),
            sampler: ViewSampler::new(setup.start.dataset.train.len(), streams.views(name)),
            units: LossUnits::default(),
        })
    }

    /// The saved state, and the optimizer's values and moments by name.
    pub(crate) fn save(&self) -> (SavedState, BTreeMap<String, NamedTensor>) {
        let Self { phase, iteration, sh_degree, optimizer, hooks, sampler, units } = self;
        let (tensors, optimizer_steps) = optimizer.save();
        let saved = SavedState {
            phase: *phase,
            iteration: *iteration,
            sh_degree: *sh_degree,
            optimizer_steps,
            hooks: hooks.iter().map(|hook| hook.save()).collect(),
            sampler: sampler.clone(),
            units: units.clone(),
        };
        (saved, tensors)
    }

    /// Inverse of [`TrainState::save`] for the same setup.
    pub(crate) fn restore(
        setup: &Setup<'_>,
        saved: SavedState,
        tensors: &BTreeMap<String, NamedTensor>,
    ) -> anyhow::Result<Self> {
        let SavedState { phase, iteration, sh_degree, optimizer_steps, hooks: saved_hooks, sampler, units } = saved;
        ensure!(phase < setup.phases.len(), "the checkpoint has more phases than the method");
        let optimizer = Optimizer::restore(tensors, &optimizer_steps, setup.learning_rates(phase))?;
        let mut hooks = setup.method.hooks(setup.phases[phase].name, setup.start.scene());
        ensure!(hooks.len() == saved_hooks.len(), "the checkpoint has other step hooks than the method");
        for (hook, saved) in hooks.iter_mut().zip(saved_hooks) {
            hook.restore(saved)?;
        }
        Ok(Self { phase, iteration, sh_degree, optimizer, hooks, sampler, units })
    }
}
