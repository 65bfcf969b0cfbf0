//! The training loop, which knows no method.
//!
//! One step: draw views, bind the tensors to a tape, let the method say its losses, differentiate, step the optimiser,
//! let the population controls act. Phases follow each other with fresh optimisers. Nothing depends on the thread count
//! or the clock, so a training resumed from a checkpoint ends in the same bytes as an undisturbed one.

mod ahead;
mod finite;
#[cfg(test)]
mod gpu_tests;
#[cfg(test)]
mod poison;
mod report;
mod step;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod waits;

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context as _, ensure};
use engine::{Decision, Facts};
use rand_chacha::ChaCha8Rng;
use shaders::splat::{self, PinholeCamera, SplatVars};
use shaders::tape::{Device, Profile, Tape};

use crate::artifact::{Model, ModelHeader};
use crate::bases::gaussians::present;
use crate::checkpoint::{Checkpoint, Progress};
use crate::clock::{ClockReading, PhaseClock};
use crate::coarse::check_start;
use crate::curve::{self, CurvePoint};
use crate::dataset::{self, Dataset};
use crate::device::Meter;
use crate::effects::{CAPTURE, PRIORS, outcomes};
use crate::method::{Method, Moment, Phase, PopulationControl, SkippedWork, Start, raster_settings, too_large};
use crate::methods;
use crate::optimizer::Optimizer;
use crate::params::TrainingParams;
use crate::sampler::{Stream, ViewSampler, generator, phase_generator};
use crate::schedule::LogLinear;
use crate::state::ModelState;
use crate::supplements::Supplements;
use crate::view_constants::ViewConstants;

pub use finite::LargestGradient;
pub use report::{Earlier, LossShare, Report};

use ahead::Ahead;
use report::{kernel_milliseconds, loss_shares, milliseconds_by_phase};

/// The activity that the training clock leaves out.
pub const EVALUATION: &str = "evaluation";

/// A training between two steps.
pub struct Trainer<'a> {
    start: Start<'a>,
    dataset: &'a Dataset,
    params: &'a TrainingParams,
    device: Device,
    meter: Option<Meter>,
    method: Box<dyn Method<f32>>,
    phases: Vec<Phase>,
    phase: usize,
    iteration: u64,
    sh_degree: usize,
    optimizer: Optimizer,
    controls: Vec<Box<dyn PopulationControl>>,
    sampler: ViewSampler,
    density_random: ChaCha8Rng,
    method_random: ChaCha8Rng,
    curve_at: BTreeSet<u64>,
    curve: Vec<CurvePoint>,
    loss: f64,
    #[cfg(test)]
    every_loss: Vec<f64>,
    clock: PhaseClock,
    profile: Profile,
    skipped: SkippedWork,
    /// Weighted values summed over steps, by loss.
    loss_sums: BTreeMap<String, f64>,
    /// By tensor, since the last resumption.
    largest_gradients: BTreeMap<String, LargestGradient>,
    /// Steps that a GPU was asked for and nobody has looked at.
    ahead: Option<Ahead>,
    /// For how many intersections such steps make room; 0 until a render was counted.
    room: usize,
    /// Training images, by index within the training views.
    images: ViewConstants<f32>,
}

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
            images: ViewConstants::default(),
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

    /// Whether all phases are done.
    pub fn is_done(&self) -> bool {
        self.iteration >= self.phases[self.phase].iterations
    }

    /// Steps done and steps in all, over all phases.
    pub fn steps(&self) -> (u64, u64) {
        let before: u64 = self.phases[..self.phase].iter().map(|phase| phase.iterations).sum();
        (before + self.iteration, self.phases.iter().map(|phase| phase.iterations).sum())
    }

    /// One optimiser step and what follows it: density control, the curve, the next phase.
    pub fn advance(&mut self) -> anyhow::Result<()> {
        self.step()?;
        if self.is_done() || self.curve_at.contains(&self.steps().0) {
            self.settle()?;
        }
        if self.curve_at.contains(&self.steps().0) {
            self.clock.enter(EVALUATION);
            let mut meter = self.meter.take();
            Meter::pause(&mut meter, || self.add_curve_point())?;
            self.meter = meter;
        }
        self.clock.enter("load");
        self.skip_finished_phases()
    }

    /// Starts a phase on the state that the one before ended with. Nothing else is handed over from phase to phase but the
    /// degree of the harmonics: random numbers begin anew, so that it does not matter who ran the phases before.
    fn enter_phase(&mut self, phase: usize, state: ModelState<f32>) -> anyhow::Result<()> {
        let name = self.phases[phase].name;
        self.clock.enter_phase(name);
        let random = |stream| phase_generator(self.params.shared.seed, stream, phase);
        self.sampler = ViewSampler::new(self.dataset.train.len(), random(Stream::Views));
        (self.density_random, self.method_random) = (random(Stream::Density), random(Stream::Method));
        let state = self.method.enter_phase(name, state, &self.start, &mut self.method_random)?;
        self.optimizer = Optimizer::new(state, self.learning_rates(phase));
        self.controls = self.method.population_controls(name, &self.dataset.scene);
        (self.phase, self.iteration) = (phase, 0);
        self.check_tensors()
    }

    /// Goes on to the next phase that has steps to do.
    fn skip_finished_phases(&mut self) -> anyhow::Result<()> {
        while self.is_done() && self.phase + 1 < self.phases.len() {
            let finished = std::mem::take(&mut self.optimizer);
            self.enter_phase(self.phase + 1, finished.into_state())?;
        }
        Ok(())
    }

    /// The step size of every tensor that a phase learns.
    fn learning_rates(&self, phase: usize) -> impl Fn(&str) -> Option<LogLinear> {
        let scale = self.params.shared.schedule_scale;
        let name = self.phases[phase].name;
        move |tensor| Some(self.method.learning_rate(name, tensor, &self.dataset.scene)?.stretched(scale))
    }

    /// Measures the curve's views.
    fn add_curve_point(&mut self) -> anyhow::Result<()> {
        let mut psnr_sum = 0.0;
        let mut n_gaussians = 0;
        for view in &self.dataset.curve {
            let mut tape = Tape::new(self.device);
            let moment = self.moment(view.time, &view.camera);
            let splats = self.splats(&mut tape, &moment)?;
            n_gaussians = present(&tape, &splats).len() as u64;
            let settings = raster_settings(&self.dataset.scene, self.sh_degree);
            let rendered = splat::render(&mut tape, &splats, None, &view.camera, &settings).map_err(too_large)?;
            psnr_sum += curve::psnr(&curve::to_bytes(tape.value(rendered.color)), view);
        }
        self.curve.push(CurvePoint {
            seconds: self.clock.reading().total_except(&[EVALUATION]),
            iteration: self.steps().0,
            n_gaussians,
            psnr_val: psnr_sum / self.dataset.curve.len() as f64,
            loss: self.loss,
        });
        Ok(())
    }

    fn moment<'m>(&'m self, time: f64, camera: &'m PinholeCamera) -> Moment<'m> {
        let phase = self.phases[self.phase].name;
        Moment { scene: &self.dataset.scene, phase, time, camera, sh_degree: self.sh_degree }
    }

    /// The Gaussians at a moment, without gradients.
    fn splats(&self, tape: &mut Tape<f32>, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        let model = self.optimizer.bind_constant(tape);
        self.method.splats(tape, &model, moment)
    }

    /// A few figures for whoever watches.
    pub fn status_line(&self) -> String {
        let phase = self.phases[self.phase].name;
        match self.curve.last() {
            Some(point) => format!("{phase} {} Gaussians {:.2} dB", point.n_gaussians, point.psnr_val),
            None => format!("{phase} loss {:.4}", self.loss),
        }
    }

    /// What was measured besides the model.
    pub fn report(&mut self) -> Report {
        let clock = self.clock.reading();
        let (steps, _) = self.steps();
        let training_secs = clock.total_except(&[EVALUATION]);
        Report {
            training_secs,
            budget: None,
            total_secs: clock.total_except(&[]),
            ms_per_iteration: 1e3 * training_secs / steps.max(1) as f64,
            ms_per_iteration_by_phase: milliseconds_by_phase(&clock, &self.phases[..=self.phase], self.iteration),
            loss_shares: loss_shares(&self.loss_sums, &clock),
            loss_sums: self.loss_sums.clone(),
            phases: clock.by_activity(),
            seconds_by_phase: clock,
            curve: self.curve.clone(),
            curve_split: self.dataset.curve_split,
            kernels: kernel_milliseconds(&self.profile),
            gpu: self.meter.as_ref().map(|meter| meter.per_iteration(steps)),
            skipped: self.skipped.clone(),
            largest_gradients: self.largest_gradients.clone(),
            guards: self.profile.events.clone(),
        }
    }

    /// What became of each effect, as the model tells it.
    fn effect_outcomes(&self) -> Vec<Decision> {
        let effects = methods::find(&self.params.method).expect("the method was found before").effects();
        let (capture, priors) = (dataset::facts_of(&self.dataset.capture), self.start.supplements.prior_facts());
        let none = Facts::default();
        let given = self.start.supplements.given().into_iter().map(|port| (port, &none));
        let known = given.chain([(CAPTURE, &capture)]).chain(priors.as_ref().map(|facts| (PRIORS, facts))).collect();
        outcomes(&self.params.shared.effects, &effects, &known)
    }

    /// The prompts that the method reads, in the order of their embeddings.
    fn prompt_names(&self) -> Vec<String> {
        self.method.language().map_or_else(Vec::new, |language| language.prompt_names(self.start.supplements))
    }

    /// The trained model.
    pub fn finish(self) -> anyhow::Result<Model> {
        let phases = self.phases.iter().map(|phase| (phase.name.to_string(), phase.iterations)).collect();
        let capture = &self.dataset.capture;
        let camera = PinholeCamera::from(&capture.views[self.dataset.train[0].index].camera);
        let moment = self.moment(0.0, &camera);
        let mut tape = Tape::new(self.device);
        let splats = self.splats(&mut tape, &moment)?;
        let n_gaussians = present(&tape, &splats).len() as u64;
        drop(tape);
        let header = ModelHeader {
            method: self.params.method.clone(),
            method_params: serde_json::to_value(self.params)?,
            protocol: capture.protocol.clone(),
            background: capture.background,
            time_map: capture.time_map,
            scene_extent: self.dataset.scene.extent,
            time_count: self.dataset.scene.time_count,
            sh_degree: self.sh_degree,
            n_gaussians,
            iterations: phases,
            seed: self.params.shared.seed,
            effects: self.effect_outcomes(),
            prompts: self.prompt_names(),
        };
        Ok(Model { header, tensors: self.optimizer.into_state().to_named() })
    }
}
