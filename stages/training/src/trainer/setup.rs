//! The fixed part of a training.

use std::collections::BTreeSet;

use super::curve;
use crate::data::{Dataset, Streams, Supplements};
use crate::method::{Detail, Method, Start};
use crate::params::TrainingParams;
use crate::schedule::{LogLinear, Phase};

/// The data, the parameters and the method of a training. No step changes them.
pub(super) struct Setup<'a> {
    /// The training views and the optional inputs.
    pub start: Start<'a>,
    /// The parameters.
    pub params: &'a TrainingParams,
    /// The method, configured by the parameters.
    pub method: Box<dyn Method<f32>>,
    /// The phases to run, in order.
    pub phases: Vec<Phase>,
    /// The steps of all phases, including those that this job does not run.
    pub total_steps: u64,
    /// Steps (over all phases) after which the quality curve is measured.
    pub curve_at: BTreeSet<u64>,
    /// Whether the influence of losses is sampled; tests compare with trainings that do not.
    pub samples_influence: bool,
}

impl<'a> Setup<'a> {
    /// Builds the method and its schedule.
    pub(crate) fn new(
        dataset: &'a Dataset,
        supplements: &'a Supplements,
        params: &'a TrainingParams,
    ) -> anyhow::Result<Self> {
        let method = params.build()?;
        // The curve is scheduled over the whole training, even if this job stops after an earlier phase.
        let total_steps = method.phases().iter().map(|phase| phase.iterations).sum();
        let phases = params.phases_to_run(&*method)?;
        let curve_at = curve::schedule(&params.shared.curve, total_steps);
        let start = Start { dataset, supplements };
        Ok(Self { start, params, method, phases, total_steps, curve_at, samples_influence: true })
    }

    /// The detail of the images of a step, counted from 1 over all phases; none without the effect `coarse-to-fine`.
    pub(crate) fn detail(&self, step: u64) -> Option<Detail> {
        let schedule = self.params.shared.resolution_schedule()?;
        Some(Detail {
            reduction: schedule.reduction_at(step, self.total_steps),
            progress: step as f64 / self.total_steps as f64,
            limits_growth: schedule.limits_growth,
        })
    }

    /// The random streams.
    pub(crate) const fn streams(&self) -> Streams {
        Streams::new(self.params.shared.seed)
    }

    /// The learning rate of every tensor that a phase trains.
    pub(crate) fn learning_rates(&self, phase: usize) -> impl Fn(&str) -> Option<LogLinear> {
        let scale = self.params.shared.schedule_scale;
        let name = self.phases[phase].name;
        move |tensor| Some(self.method.learning_rate(name, tensor, self.start.scene())?.stretched(scale))
    }
}
