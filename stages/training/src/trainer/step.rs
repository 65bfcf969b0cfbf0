//! One step of a training: watched, so that every figure is looked at before the next step begins; or on a GPU that goes
//! ahead, and is looked at after a while.

use std::collections::BTreeMap;

use shaders::gpu::Gpu;
use shaders::tape::{PendingReadback, Tape, Tensor};

use super::Trainer;
use super::ahead::LaterStep;
use crate::method::{TrainingView, raster_settings};
use crate::schedule::stretch;
use crate::screen::Screen;
use crate::state::Variables;
use crate::step::{SkippedWork, Step, StepOutcome, run_step};

impl Trainer<'_> {
    /// The next step. A GPU goes ahead with it once it is known how much room renders need.
    pub(super) fn step(&mut self) -> anyhow::Result<()> {
        let Some(gpu) = self.device.gpu().filter(|_| self.room > 0) else { return self.watched_step() };
        // What fails ahead may do so because of what nobody has looked at: with open eyes it tells why.
        self.step_ahead(gpu).or_else(|error| if self.ahead.is_some() { self.go_back() } else { Err(error) })
    }

    /// The next step, every figure of which is looked at.
    pub(super) fn watched_step(&mut self) -> anyhow::Result<()> {
        let mut tape = Tape::new(self.device);
        let (mut outcome, model) = self.differentiate(&mut tape)?;
        self.make_room(tape.read_back().intersections);
        let (losses, skipped) = outcome.look();
        self.keep_counts(&tape, &skipped);
        self.check_losses(&losses, &tape)?;
        self.keep_losses(&losses);
        self.observe(&tape, &outcome);
        let gradients = take_gradients(&mut outcome, &model);
        self.check_gradients(&gradients, &tape)?;
        // The tape shares the tensors; without it they are changed in place.
        drop((tape, outcome));
        self.clock.enter("optimizer");
        self.optimizer.step(&gradients, self.iteration)?;
        self.check_tensors()?;
        self.act()
    }

    /// The next step, whose figures stay on the GPU for now.
    fn step_ahead(&mut self, gpu: Gpu) -> anyhow::Result<()> {
        self.remember();
        let mut tape = Tape::new(self.device).with_capacity(self.room);
        let (mut outcome, model) = self.differentiate(&mut tape)?;
        self.keep_counts(&tape, &outcome.skipped);
        self.observe(&tape, &outcome);
        let gradients = take_gradients(&mut outcome, &model);
        let values = outcome.values.iter().map(|(.., value)| value).chain(outcome.kept.iter().map(|(_, kept, _)| kept));
        let mut figures = PendingReadback::of(&mut tape, values.cloned().collect());
        let losses = outcome.values.iter().map(|(name, weight, _)| (*name, *weight)).collect();
        let kept = outcome.kept.iter().map(|(what, _, of)| (*what, *of)).collect();
        drop((tape, outcome));
        self.clock.enter("optimizer");
        figures.push(self.optimizer.step_on(gpu, &gradients, self.iteration)?);
        self.device.submit();
        let gradients = gradients.into_keys().map(str::to_owned).collect();
        if self.look_later(LaterStep { losses, kept, gradients, figures })? { self.act() } else { Ok(()) }
    }

    /// The losses of the next views and their gradients.
    fn differentiate(&mut self, tape: &mut Tape<f32>) -> anyhow::Result<(StepOutcome<f32>, Variables)> {
        self.clock.enter("load");
        self.iteration += 1;
        let harmonics = &self.params.shared.harmonics;
        if self.iteration.is_multiple_of(stretch(harmonics.interval, self.params.shared.schedule_scale)) {
            self.sh_degree = (self.sh_degree + 1).min(harmonics.degree);
        }
        let views: Vec<_> = (0..self.params.shared.batch).map(|_| self.next_view()).collect();
        let model = self.optimizer.bind(tape);
        let step = Step {
            tape,
            model: &model,
            views: &views,
            scene: &self.dataset.scene,
            dataset: self.dataset,
            supplements: self.start.supplements,
            shared: &self.params.shared,
            phase: self.phases[self.phase].name,
            iteration: self.iteration,
            sh_degree: self.sh_degree,
            raster: raster_settings(&self.dataset.scene, self.sh_degree),
            random: &mut self.method_random,
            clock: &mut self.clock,
            constants: &self.constants,
            losses: Vec::new(),
            renders: Vec::new(),
            skipped: SkippedWork::new(),
            kept: Vec::new(),
        };
        let outcome = run_step(&*self.method, step)?;
        Ok((outcome, model))
    }

    /// The view that is drawn next.
    fn next_view(&mut self) -> TrainingView<f32> {
        let index = self.sampler.next_view();
        let view = &self.dataset.train[index];
        view.with_image(self.constants.get(self.device, "image", index, || view.image()))
    }

    /// What the tape did, and what the step left out.
    fn keep_counts(&mut self, tape: &Tape<f32>, skipped: &SkippedWork) {
        for (op, activity) in [("projection", "projection"), ("binning", "sort"), ("blending", "blend")] {
            if let Some(cost) = tape.profile().ops.get(op) {
                self.clock.reassign("render", activity, cost.forward.secs);
            }
        }
        self.profile.merge(tape.profile());
        for (what, [skipped, of]) in skipped {
            let count = self.skipped.entry(what).or_default();
            count[0] += skipped;
            count[1] += of;
        }
    }

    /// Weighted losses by name.
    pub(super) fn keep_losses(&mut self, losses: &BTreeMap<&'static str, f64>) {
        self.loss = losses.values().sum();
        #[cfg(test)]
        self.every_loss.push(self.loss);
        for (&name, value) in losses {
            match self.loss_sums.get_mut(name) {
                Some(sum) => *sum += value,
                None => drop(self.loss_sums.insert(name.into(), *value)),
            }
        }
    }

    /// Shows the step's renders to whoever watches them.
    fn observe(&mut self, tape: &Tape<f32>, outcome: &StepOutcome<f32>) {
        self.clock.enter("density");
        let screens = Screen::all(&outcome.renders, tape, &outcome.gradients);
        for control in self.controls.iter_mut().filter(|control| control.watches(self.iteration)) {
            screens.iter().for_each(|screen| control.observe(screen));
        }
    }

    /// Lets the population controls act.
    fn act(&mut self) -> anyhow::Result<()> {
        self.clock.enter("density");
        for control in &mut self.controls {
            control.act(self.iteration, &mut self.optimizer, &self.dataset.scene, &mut self.density_random)?;
        }
        self.check_not_empty()
    }
}

/// The gradients of the model's tensors.
fn take_gradients<'n>(outcome: &mut StepOutcome<f32>, model: &'n Variables) -> BTreeMap<&'n str, Tensor<f32>> {
    model.iter().filter_map(|(name, var)| Some((name, outcome.gradients.take(var)?))).collect()
}
