//! The three ways to begin a training: from scratch, from the model of another training, or from a checkpoint.

use anyhow::ensure;
use shaders::tape::Device;

use super::Trainer;
use super::checkpoint::{Checkpoint, Progress};
use super::report::Earlier;
use super::setup::Setup;
use super::telemetry::{History, Telemetry};
use super::train_state::TrainState;
use crate::artifact::Model;
use crate::clock::{ClockReading, PhaseClock};
use crate::data::{Dataset, Supplements, ViewConstants};
use crate::device::Meter;
use crate::model::ModelState;
use crate::params::TrainingParams;
use crate::sharing::check_start;

/// The activity of the clock between steps.
const LOAD: &str = "load";

impl<'a> Trainer<'a> {
    /// A training before its first step.
    pub fn new(dataset: &'a Dataset, supplements: &'a Supplements, params: &'a TrainingParams) -> anyhow::Result<Self> {
        let setup = Setup::new(dataset, supplements, params)?;
        let clock = PhaseClock::start(LOAD, ClockReading::default());
        let points = dataset.initial_points(&params.shared.initial_points, params.shared.seed)?;
        let model = setup.method.initialize(&setup.start, &points, setup.streams())?;
        Self::begin(setup, 0, model, 0, History::default(), clock)
    }

    /// A training that continues on the model of another one, which must have run the first phases exactly as this one
    /// would. `earlier` holds the measurements of that training, so time and curve count from the very beginning.
    pub(crate) fn continue_from(
        dataset: &'a Dataset,
        supplements: &'a Supplements,
        params: &'a TrainingParams,
        from: &Model,
        earlier: Earlier,
    ) -> anyhow::Result<Self> {
        check_start(from, params, dataset)?;
        let setup = Setup::new(dataset, supplements, params)?;
        let done = from.header.iterations.len();
        let own = setup.phases.iter().take(done).map(|phase| (phase.name.to_string(), phase.iterations));
        ensure!(
            own.eq(from.header.iterations.iter().cloned()) && done < setup.phases.len(),
            "the model on `start` ends after {:?}, but this training begins with other phases",
            from.header.iterations
        );
        let Earlier { clock, curve, loss_sums, influence, skipped, largest_gradients, guards, notices } = earlier;
        let history =
            History { curve, loss_sums, influence, skipped, largest_gradients, guards, notices, ..History::default() };
        let model = ModelState::from_named(&from.tensors);
        Self::begin(setup, done, model, from.header.sh_degree, history, PhaseClock::start(LOAD, clock))
    }

    /// The training of a checkpoint, with the same data and parameters.
    pub(crate) fn resume(
        dataset: &'a Dataset,
        supplements: &'a Supplements,
        params: &'a TrainingParams,
        checkpoint: Checkpoint,
    ) -> anyhow::Result<Self> {
        let Checkpoint { progress: Progress { params: _, state, history, clock }, tensors } = checkpoint;
        let setup = Setup::new(dataset, supplements, params)?;
        let state = TrainState::restore(&setup, state, &tensors)?;
        let mut clock = PhaseClock::start(LOAD, clock);
        clock.enter_phase(setup.phases[state.phase].name);
        let trainer = Self::at(setup, state, history, clock);
        trainer.check_checkpoint(&tensors)?;
        Ok(trainer)
    }

    /// Enters a phase with a model.
    fn begin(
        setup: Setup<'a>,
        phase: usize,
        model: ModelState<f32>,
        sh_degree: usize,
        history: History,
        mut clock: PhaseClock,
    ) -> anyhow::Result<Self> {
        clock.enter_phase(setup.phases[phase].name);
        let state = TrainState::enter_phase(&setup, phase, model, sh_degree)?;
        let mut trainer = Self::at(setup, state, history, clock);
        trainer.check_tensors()?;
        trainer.skip_finished_phases()?;
        Ok(trainer)
    }

    /// A training in a state, on the CPU.
    fn at(setup: Setup<'a>, state: TrainState, history: History, clock: PhaseClock) -> Self {
        Self {
            setup,
            state,
            telemetry: Telemetry { history, ..Telemetry::default() },
            clock,
            device: Device::Cpu,
            meter: None,
            speculation: None,
            capacity: 0,
            constants: ViewConstants::default(),
        }
    }

    /// Moves the computation of all further steps to a device.
    pub(crate) fn on(self, device: Device) -> Self {
        let steps_before = self.steps().0;
        Self { device, meter: device.gpu().map(|gpu| Meter::start(gpu, steps_before)), ..self }
    }

    /// Drains the device and saves everything that the next step depends on.
    pub(crate) fn checkpoint(&mut self) -> anyhow::Result<Checkpoint> {
        self.drain()?;
        let (state, tensors) = self.state.save();
        let progress = Progress {
            params: serde_json::to_value(self.setup.params)?,
            state,
            history: self.telemetry.history.clone(),
            clock: self.clock.reading(),
        };
        Ok(Checkpoint { progress, tensors })
    }
}
