//! One step of a training, checked or speculative.

use std::collections::BTreeMap;

use shaders::tape::{Tape, Tensor};

use super::Trainer;
use super::speculation::{Mode, PendingStep};
use crate::data::{TrainingView, reduced_camera};
use crate::method::{AfterStep, Recorded, ScreenStats, Step, StepOutcome, raster_settings, run_step};
use crate::model::Variables;
use crate::schedule::stretch;
use crate::shared::MAX_REDUCTION;

/// Names of cached images, by reduction factor.
const IMAGE: [&str; MAX_REDUCTION + 1] =
    ["", "image", "image/2", "image/3", "image/4", "image/5", "image/6", "image/7", "image/8"];

impl Trainer<'_> {
    /// Runs the next step: speculatively on a GPU, once the size of the intersection buffers is known.
    pub(super) fn next_step(&mut self) -> anyhow::Result<()> {
        let Some(gpu) = self.device.gpu().filter(|_| self.capacity > 0) else { return self.step(Mode::Checked) };
        // A speculative step may fail because an earlier, unchecked one produced bad values. The replay checks every
        // step, so the error names its cause.
        self.step(Mode::Speculative(gpu)).or_else(|error| match self.speculation.take() {
            Some(speculation) => self.roll_back(speculation),
            None => Err(error),
        })
    }

    /// Runs one step and its hooks.
    pub(super) fn step(&mut self, mode: Mode) -> anyhow::Result<()> {
        let mut tape = Tape::new(self.device);
        if let Mode::Speculative(_) = mode {
            self.start_speculation();
            tape = tape.with_capacity(self.capacity);
        }
        let (mut outcome, model) = self.differentiate(&mut tape)?;
        let pending = match mode {
            Mode::Checked => self.check_outcome(&mut tape, &outcome).map(|()| None)?,
            Mode::Speculative(_) => Some(self.defer_outcome(&mut tape, &outcome)),
        };
        self.observe(&tape, &outcome);
        let gradients = take_gradients(&mut outcome, &model);
        if pending.is_none() {
            self.check_gradients(&gradients, &tape)?;
        }
        // The gradients of intermediate values are no longer needed, and the sample computes its own.
        let StepOutcome { losses, unmeasured, .. } = outcome;
        let sample = self.sample_influence(&mut tape, &losses, &model);
        if let (None, Some(sample)) = (&pending, &sample) {
            self.record_sample(sample);
        }
        if !unmeasured.is_empty() {
            self.clock.enter("loss units");
            self.state.units.measure(&mut tape, &losses, &unmeasured, &model)?;
            self.telemetry.record_units(self.setup.phases[self.state.phase].name, self.state.units.known());
        }
        // The tape shares the tensors; once it is gone, the optimizer changes them in place.
        drop(tape);
        self.clock.enter("optimizer");
        if let (Mode::Speculative(gpu), Some(mut pending)) = (mode, pending) {
            let magnitudes = self.state.optimizer.step_on(gpu, &gradients, self.state.iteration)?;
            pending.add_update(gradients, magnitudes);
            sample.into_iter().for_each(|sample| pending.add_sample(sample));
            self.device.submit();
            return if self.add_pending(pending)? { self.run_hooks() } else { Ok(()) };
        }
        self.state.optimizer.step(&gradients, self.state.iteration)?;
        self.check_tensors()?;
        self.run_hooks()
    }

    /// Computes the losses of the next views and their gradients.
    pub(super) fn differentiate(&mut self, tape: &mut Tape<f32>) -> anyhow::Result<(StepOutcome<f32>, Variables)> {
        self.clock.enter("load");
        self.state.iteration += 1;
        let shared = &self.setup.params.shared;
        let harmonics_interval = stretch(shared.harmonics.interval, shared.schedule_scale);
        if self.state.iteration.is_multiple_of(harmonics_interval) {
            self.state.sh_degree = (self.state.sh_degree + 1).min(shared.harmonics.degree);
        }
        let views: Vec<_> = (0..shared.batch).map(|_| self.next_view()).collect();
        let model = self.state.optimizer.bind(tape);
        let dataset = self.setup.start.dataset;
        let step = Step {
            tape,
            model: &model,
            views: &views,
            scene: &dataset.scene,
            dataset,
            supplements: self.setup.start.supplements,
            shared,
            phase: self.setup.phases[self.state.phase].name,
            iteration: self.state.iteration,
            sh_degree: self.state.sh_degree,
            harmonics_intervals: self.state.iteration / harmonics_interval,
            raster: raster_settings(&dataset.scene, self.state.sh_degree),
            random: self.setup.streams().step(self.phase_name(), self.state.iteration),
            clock: &mut self.clock,
            constants: &self.constants,
            units: &self.state.units,
            recorded: Recorded::default(),
        };
        Ok((run_step(&*self.setup.method, step)?, model))
    }

    /// Draws the next training view.
    fn next_view(&mut self) -> TrainingView<f32> {
        let index = self.state.sampler.next_view();
        let view = &self.setup.start.dataset.train[index];
        let reduction = self.reduction();
        let image = || view.image_reduced_by(reduction);
        let image = self.constants.get(self.device, IMAGE[reduction], index, image);
        TrainingView { camera: reduced_camera(&view.camera, reduction), reduction, ..view.with_image(image) }
    }

    /// The factor by which the images of the running step are reduced.
    pub(super) fn reduction(&self) -> usize {
        self.setup.detail(self.steps().0).map_or(1, |detail| detail.reduction)
    }

    /// Reads back the values of a step, checks and records them.
    fn check_outcome(&mut self, tape: &mut Tape<f32>, outcome: &StepOutcome<f32>) -> anyhow::Result<()> {
        self.grow_capacity(tape.read_back().intersections);
        let (losses, skipped) = outcome.read_back();
        self.split_render_time(tape);
        self.telemetry.record_work(tape.profile(), &skipped);
        self.check_losses(&losses, tape)?;
        self.telemetry.record_losses(self.phase_name(), &losses);
        Ok(())
    }

    /// Records the values of a step that are on the host, and defers the rest.
    fn defer_outcome(&mut self, tape: &mut Tape<f32>, outcome: &StepOutcome<f32>) -> PendingStep {
        self.split_render_time(tape);
        self.telemetry.record_work(tape.profile(), &outcome.skipped);
        PendingStep::new(tape, outcome)
    }

    /// Splits the seconds of `render` among the stages of the rasteriser.
    fn split_render_time(&mut self, tape: &Tape<f32>) {
        for (op, activity) in [("projection", "projection"), ("binning", "sort"), ("blending", "blend")] {
            if let Some(cost) = tape.profile().ops.get(op) {
                self.clock.reassign("render", activity, cost.forward.secs);
            }
        }
    }

    /// Passes the renders of the step to the hooks that observe it.
    fn observe(&mut self, tape: &Tape<f32>, outcome: &StepOutcome<f32>) {
        self.clock.enter("density");
        let iteration = self.state.iteration;
        let populations = ScreenStats::by_population(&outcome.renders, tape, &outcome.gradients);
        for hook in self.state.hooks.iter_mut().filter(|hook| hook.observes_at(iteration)) {
            populations.iter().for_each(|stats| hook.observe(stats));
            outcome.measured.iter().for_each(|&(name, value)| hook.observe_value(name, tape.value(value)));
        }
    }

    /// Runs the hooks after the optimizer's step.
    fn run_hooks(&mut self) -> anyhow::Result<()> {
        self.clock.enter("density");
        let (phase, iteration) = (self.phase_name(), self.state.iteration);
        let detail = self.setup.detail(self.steps().0);
        let mut random = self.setup.streams().step(phase, iteration);
        for at in 0..self.state.hooks.len() {
            let wanted = self.state.hooks[at].surveys_at(iteration);
            let measured = |survey| anyhow::Ok((survey, self.survey(survey)?));
            let surveys = wanted.into_iter().map(measured).collect::<Result<_, _>>()?;
            self.state.hooks[at].after_step(AfterStep {
                iteration,
                optimizer: &mut self.state.optimizer,
                detail,
                surveys,
                scene: self.setup.start.scene(),
                random: &mut random,
                notices: &mut self.telemetry.history.notices,
            })?;
        }
        self.check_not_empty()
    }
}

/// The gradients of the model's tensors.
fn take_gradients<'n>(outcome: &mut StepOutcome<f32>, model: &'n Variables) -> BTreeMap<&'n str, Tensor<f32>> {
    model.iter().filter_map(|(name, var)| Some((name, outcome.gradients.take(var)?))).collect()
}
