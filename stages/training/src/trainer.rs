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
mod start;
mod step;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod waits;

use std::collections::{BTreeMap, BTreeSet};

use engine::{Decision, Facts};
use rand_chacha::ChaCha8Rng;
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::{self, SplatVars};
use shaders::tape::{Device, Profile, Tape};

use crate::artifact::LargestGradient;
use crate::artifact::{Model, ModelHeader};
use crate::bases::gaussians::present;
use crate::clock::PhaseClock;
use crate::curve::{self, CurvePoint};
use crate::dataset::{self, Dataset};
use crate::device::Meter;
use crate::effects::{CAPTURE, PRIORS, outcomes};
use crate::method::{Method, Moment, Phase, PopulationControl, Start, raster_settings, too_large};
use crate::methods;
use crate::optimizer::Optimizer;
use crate::params::TrainingParams;
use crate::sampler::{Stream, ViewSampler, phase_generator};
use crate::schedule::LogLinear;
use crate::state::ModelState;
use crate::step::SkippedWork;
use crate::view_constants::ViewConstants;

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
    /// Training images, and what methods know of views.
    constants: ViewConstants<f32>,
}

impl Trainer<'_> {
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
            let rendered = rasteriser::render(&mut tape, &splats, None, &view.camera, &settings).map_err(too_large)?;
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
