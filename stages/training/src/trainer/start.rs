//! Where a training begins: before its first step, where another one ended, or at a checkpoint of its own.

use std::collections::BTreeMap;

use anyhow::{Context as _, ensure};
use shaders::tape::{Device, Profile};

use super::{Earlier, Trainer};
use crate::artifact::Model;
use crate::checkpoint::{Checkpoint, Progress};
use crate::clock::{ClockReading, PhaseClock};
use crate::coarse::check_start;
use crate::curve;
use crate::dataset::Dataset;
use crate::device::Meter;
use crate::method::Start;
use crate::methods;
use crate::optimizer::Optimizer;
use crate::params::TrainingParams;
use crate::sampler::{Stream, ViewSampler, generator};
use crate::state::ModelState;
use crate::step::SkippedWork;
use crate::supplements::Supplements;
use crate::view_constants::ViewConstants;

impl<'a> Trainer<'a> {
    /// A training before its first step.
    pub fn new(dataset: &'a Dataset, supplements: &'a Supplements, params: &'a TrainingParams) -> anyhow::Result<Self> {
        let mut trainer = Self::prepare(dataset, supplements, params)?;
        let seed = params.shared.seed;
        let points = dataset.initial_points(&params.shared.initial_points, seed)?;
        let state = trainer.method.initialize(&trainer.start, &points, &mut generator(seed, Stream::Initial))?;
        trainer.enter_phase(0, state)?;
        trainer.skip_finished_phases()?;
        Ok(trainer)
    }

    /// A training that goes on where another one stopped, which must have been what this one would have done up to there.
    /// `earlier` is what that one measured, so that time and curve count from the very beginning.
    pub fn go_on(
        dataset: &'a Dataset,
        supplements: &'a Supplements,
        params: &'a TrainingParams,
        from: &Model,
        earlier: Earlier,
    ) -> anyhow::Result<Self> {
        check_start(from, params, dataset)?;
        let mut trainer = Self::prepare(dataset, supplements, params)?;
        let done = from.header.iterations.len();
        let own = trainer.phases.iter().take(done).map(|phase| (phase.name.to_string(), phase.iterations));
        ensure!(
            own.eq(from.header.iterations.iter().cloned()) && done < trainer.phases.len(),
            "the model on `start` ends after {:?}, which is not how this training begins",
            from.header.iterations
        );
        trainer.sh_degree = from.header.sh_degree;
        (trainer.curve, trainer.loss_sums) = (earlier.curve, earlier.losses);
        trainer.clock = PhaseClock::start("load", earlier.clock);
        trainer.enter_phase(done, ModelState::from_named(&from.tensors))?;
        trainer.skip_finished_phases()?;
        Ok(trainer)
    }

    /// Everything but a state: no phase is entered yet.
    fn prepare(dataset: &'a Dataset, supplements: &'a Supplements, params: &'a TrainingParams) -> anyhow::Result<Self> {
        let start = Start { dataset, supplements };
        let method = methods::find(&params.method).map_err(anyhow::Error::msg)?.build_f32(params)?;
        let seed = params.shared.seed;
        let mut phases = method.phases();
        // The curve is that of the whole training, wherever it stops.
        let total = phases.iter().map(|phase| phase.iterations).sum();
        if let Some(last) = &params.shared.stop_after {
            let at = phases.iter().position(|phase| phase.name == last);
            phases.truncate(at.with_context(|| format!("{} has no phase {last}", params.method))? + 1);
        }
        Ok(Self {
            start,
            dataset,
            params,
            device: Device::Cpu,
            meter: None,
            method,
            phases,
            phase: 0,
            iteration: 0,
            sh_degree: 0,
            optimizer: Optimizer::default(),
            controls: Vec::new(),
            sampler: ViewSampler::new(dataset.train.len(), generator(seed, Stream::Views)),
            density_random: generator(seed, Stream::Density),
            method_random: generator(seed, Stream::Method),
            curve_at: curve::schedule(&params.shared.curve, total),
            curve: Vec::new(),
            loss: f64::NAN,
            #[cfg(test)]
            every_loss: Vec::new(),
            clock: PhaseClock::start("load", ClockReading::default()),
            profile: Profile::default(),
            skipped: SkippedWork::new(),
            loss_sums: BTreeMap::new(),
            largest_gradients: BTreeMap::new(),
            ahead: None,
            room: 0,
            constants: ViewConstants::default(),
        })
    }

    /// The training that a checkpoint was taken of, with the same data and parameters.
    pub fn resume(
        dataset: &'a Dataset,
        supplements: &'a Supplements,
        params: &'a TrainingParams,
        checkpoint: Checkpoint,
    ) -> anyhow::Result<Self> {
        let mut trainer = Self::prepare(dataset, supplements, params)?;
        let Checkpoint { progress, tensors } = checkpoint;
        ensure!(progress.phase < trainer.phases.len(), "the checkpoint has more phases than the method");
        let rates = trainer.learning_rates(progress.phase);
        trainer.optimizer = Optimizer::restore(&tensors, &progress.optimizer_steps, rates)?;
        trainer.controls = trainer.method.population_controls(trainer.phases[progress.phase].name, &dataset.scene);
        ensure!(progress.controls.len() == trainer.controls.len(), "the checkpoint has other population controls");
        for (control, saved) in trainer.controls.iter_mut().zip(progress.controls) {
            control.restore(saved)?;
        }
        (trainer.phase, trainer.iteration, trainer.sh_degree) =
            (progress.phase, progress.iteration, progress.sh_degree);
        (trainer.sampler, trainer.curve, trainer.loss) = (progress.sampler, progress.curve, progress.loss);
        (trainer.density_random, trainer.method_random) = (progress.density_random, progress.method_random);
        trainer.loss_sums = progress.loss_sums;
        trainer.clock = PhaseClock::start("load", progress.clock);
        trainer.clock.enter_phase(trainer.phases[trainer.phase].name);
        trainer.check_values(&tensors)?;
        Ok(trainer)
    }

    /// The same training, whose steps compute on a device.
    pub fn on(self, device: Device) -> Self {
        let steps_before = self.steps().0;
        Self { device, meter: device.gpu().map(|gpu| Meter::start(gpu, steps_before)), ..self }
    }

    /// Everything that the next step depends on.
    pub fn checkpoint(&mut self) -> anyhow::Result<Checkpoint> {
        self.settle()?;
        let (tensors, optimizer_steps) = self.optimizer.save();
        let progress = Progress {
            params: serde_json::to_value(self.params)?,
            phase: self.phase,
            iteration: self.iteration,
            sh_degree: self.sh_degree,
            sampler: self.sampler.clone(),
            density_random: self.density_random.clone(),
            method_random: self.method_random.clone(),
            controls: self.controls.iter().map(|control| control.save()).collect(),
            optimizer_steps,
            clock: self.clock.reading(),
            curve: self.curve.clone(),
            loss: self.loss,
            loss_sums: self.loss_sums.clone(),
        };
        Ok(Checkpoint { progress, tensors })
    }
}
