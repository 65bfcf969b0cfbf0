//! The training loop, independent of the method.
//!
//! One step draws views, binds the tensors to a tape, lets the method compute its losses, differentiates them, steps
//! the optimizer and runs the step hooks. Each phase begins with a fresh optimizer. Nothing depends on the number of
//! threads or on the clock, so a training resumed from a checkpoint ends in the same bytes as an undisturbed one.
//!
//! A [`Trainer`] is a `Setup`, which steps only read, a `TrainState`, which each step maps to the next, and
//! `Telemetry`, which no step reads.

mod checkpoint;
mod curve;
mod finite;
#[cfg(test)]
mod gpu_tests;
mod influence;
mod iteration;
#[cfg(test)]
mod poison_tests;
#[cfg(test)]
mod readback_tests;
mod report;
mod setup;
mod speculation;
#[cfg(test)]
mod speed_tests;
mod start;
mod survey;
mod telemetry;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod trace_tests;
mod train_state;

use std::collections::BTreeMap;

use engine::{Decision, Facts};
use shaders::arrays::bytes::to_bytes;
use shaders::geometry::camera::PinholeCamera;
use shaders::rasteriser::{self, SplatVars};
use shaders::tape::{Device, Tape};

use crate::artifact::{Model, ModelHeader};
use crate::clock::PhaseClock;
use crate::data::{ViewConstants, facts_of};
use crate::device::Meter;
use crate::effects::{CAPTURE, PRIORS, outcomes};
use crate::method::{Moment, raster_settings, too_large};
use crate::schedule::Phase;

pub(crate) use checkpoint::Checkpoint;
pub(crate) use curve::CurvePoint;
pub use curve::psnr;
pub(crate) use report::Earlier;
pub use report::Report;

use setup::Setup;
use speculation::Speculation;
use telemetry::Telemetry;
use train_state::TrainState;

/// The activity of measuring the quality curve.
const EVALUATION: &str = "evaluation";
/// The activities that the training clock leaves out.
pub(crate) const UNCLOCKED: [&str; 2] = [EVALUATION, influence::SAMPLING];

/// A training between two steps.
pub struct Trainer<'a> {
    setup: Setup<'a>,
    state: TrainState,
    telemetry: Telemetry,
    clock: PhaseClock,
    device: Device,
    meter: Option<Meter>,
    /// Steps whose results have not been checked yet, with the snapshot to roll back to.
    speculation: Option<Speculation>,
    /// Capacity of the intersection buffers of speculative renders; 0 until a render has been counted.
    capacity: usize,
    /// Images and other tensors of views, kept on the device.
    constants: ViewConstants<f32>,
}

impl Trainer<'_> {
    /// Whether all phases are complete.
    pub(crate) fn is_done(&self) -> bool {
        self.state.iteration >= self.setup.phases[self.state.phase].iterations
    }

    /// Completed steps and total steps, over all phases.
    pub fn steps(&self) -> (u64, u64) {
        let sum = |phases: &[Phase]| phases.iter().map(|phase| phase.iterations).sum::<u64>();
        (sum(&self.setup.phases[..self.state.phase]) + self.state.iteration, sum(&self.setup.phases))
    }

    /// The steps of the last phase.
    pub(crate) fn last_phase_steps(&self) -> u64 {
        self.setup.phases.last().map_or(0, |phase| phase.iterations)
    }

    /// Runs one step with its hooks, then measures the curve and enters the next phase where these are due.
    pub fn advance(&mut self) -> anyhow::Result<()> {
        self.next_step()?;
        let is_curve_point = self.setup.curve_at.contains(&self.steps().0);
        if self.is_done() || is_curve_point {
            self.drain()?;
        }
        if is_curve_point {
            self.clock.enter(EVALUATION);
            let mut meter = self.meter.take();
            Meter::pause(&mut meter, || self.add_curve_point())?;
            self.meter = meter;
        }
        self.clock.enter("load");
        self.skip_finished_phases()
    }

    /// Enters the next phase that has steps, if the current one is complete.
    fn skip_finished_phases(&mut self) -> anyhow::Result<()> {
        while self.is_done() && self.state.phase + 1 < self.setup.phases.len() {
            let next = self.state.phase + 1;
            self.clock.enter_phase(self.setup.phases[next].name);
            self.telemetry.history.sampled_slots.clear();
            let model = std::mem::take(&mut self.state.optimizer).into_state();
            self.state = TrainState::enter_phase(&self.setup, next, model, self.state.sh_degree)?;
            self.check_tensors()?;
        }
        Ok(())
    }

    /// Renders the curve's views and adds a point to the curve.
    fn add_curve_point(&mut self) -> anyhow::Result<()> {
        let mut psnr_sum = 0.0;
        let mut n_gaussians = 0;
        let dataset = self.setup.start.dataset;
        for view in &dataset.curve {
            let mut tape = Tape::new(self.device);
            let moment = self.moment(view.time, &view.camera);
            let splats = self.splats(&mut tape, &moment)?;
            n_gaussians = tape.value(splats.positions).rows() as u64;
            let settings = raster_settings(&dataset.scene, self.state.sh_degree);
            let rendered = rasteriser::render(&mut tape, &splats, None, &view.camera, &settings).map_err(too_large)?;
            psnr_sum += curve::psnr(&to_bytes(tape.value(rendered.color)).values, &view.pixels);
        }
        self.telemetry.history.curve.push(CurvePoint {
            seconds: self.clock.reading().total_except(&UNCLOCKED),
            iteration: self.steps().0,
            n_gaussians,
            psnr_val: psnr_sum / dataset.curve.len() as f64,
            loss: self.telemetry.history.loss,
        });
        Ok(())
    }

    /// The name of the running phase.
    fn phase_name(&self) -> &'static str {
        self.setup.phases[self.state.phase].name
    }

    fn moment<'m>(&'m self, time: f64, camera: &'m PinholeCamera) -> Moment<'m> {
        let phase = self.phase_name();
        Moment { scene: self.setup.start.scene(), phase, time, camera, sh_degree: self.state.sh_degree, left_out: None }
    }

    /// The Gaussians at a moment, without gradients.
    fn splats(&self, tape: &mut Tape<f32>, moment: &Moment<'_>) -> anyhow::Result<SplatVars> {
        let model = self.state.optimizer.bind_constant(tape);
        self.setup.method.splats(tape, &model, moment)
    }

    /// The values that the method reports about the model, if it is in its last phase; the parts of a method need not
    /// exist earlier.
    fn figures(&self) -> BTreeMap<String, f64> {
        if self.state.phase + 1 < self.setup.phases.len() {
            return BTreeMap::new();
        }
        let mut tape = Tape::new(self.device);
        let model = self.state.optimizer.bind_constant(&mut tape);
        self.setup.method.figures(&mut tape, &model, self.setup.start.scene())
    }

    /// One line on the state of the training, for progress displays.
    pub(crate) fn status_line(&self) -> String {
        let phase = self.phase_name();
        match self.telemetry.history.curve.last() {
            Some(point) => format!("{phase} {} Gaussians {:.2} dB", point.n_gaussians, point.psnr_val),
            None => format!("{phase} loss {:.4}", self.telemetry.history.loss),
        }
    }

    /// The outcome of each effect of the method, with its reason.
    fn effect_outcomes(&self) -> Vec<Decision> {
        let Setup { start, params, .. } = &self.setup;
        let effects = params.registration().effects();
        let (capture, priors) = (facts_of(&start.dataset.capture), start.supplements.prior_facts());
        let none = Facts::default();
        let given = start.supplements.given().into_iter().map(|port| (port, &none));
        let known = given.chain([(CAPTURE, &capture)]).chain(priors.as_ref().map(|facts| (PRIORS, facts))).collect();
        outcomes(&params.shared.effects, &effects, &known)
    }

    /// The prompts that the method reads, in the order of their embeddings.
    fn prompt_names(&self) -> Vec<String> {
        let language = self.setup.method.language();
        language.map_or_else(Vec::new, |language| language.prompt_names(self.setup.start.supplements))
    }

    /// The trained model.
    pub(crate) fn finish(self) -> anyhow::Result<Model> {
        let Setup { start, params, phases, .. } = &self.setup;
        let (capture, scene) = (&start.dataset.capture, start.scene());
        let camera = PinholeCamera::from(&capture.views[start.dataset.train[0].index].camera);
        let mut tape = Tape::new(self.device);
        let splats = self.splats(&mut tape, &self.moment(0.0, &camera))?;
        let n_gaussians = tape.value(splats.positions).rows() as u64;
        drop(tape);
        let header = ModelHeader {
            method: params.method.clone(),
            method_params: serde_json::to_value(params)?,
            protocol: capture.protocol.clone(),
            background: capture.background,
            time_map: capture.time_map,
            scene_extent: scene.extent,
            unit_world: scene.unit_world,
            time_count: scene.time_count,
            sh_degree: self.state.sh_degree,
            n_gaussians,
            iterations: phases.iter().map(|phase| (phase.name.to_string(), phase.iterations)).collect(),
            seed: params.shared.seed,
            effects: self.effect_outcomes(),
            prompts: self.prompt_names(),
        };
        Ok(Model { header, tensors: self.state.optimizer.into_state().to_named() })
    }
}
