//! The stage: a capture in, a model out.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::Context as _;
use captures::CaptureArtifact;
use engine::{Facts, JobContext, ParamProblem, PlanContext, Port, Progress, Resolution, Resources, Stage};
use scene::Capture;
use serde::Deserialize as _;
use shaders::gpu::Gpu;
use shaders::tape::Device;

use crate::artifact::Model;
use crate::budget;
use crate::checkpoint::Checkpoint;
use crate::dataset::Dataset;
use crate::device::compute_on;
use crate::effects::CAPTURE;
use crate::inputs::{self, OptionalInputs, START};
use crate::methods;
use crate::params::TrainingParams;
use crate::planning;
use crate::supplements::Supplements;
use crate::trainer::{Earlier, Report, Trainer};

/// A minute of lost work at most; a checkpoint of 100k Gaussians takes a fraction of a second. Not a parameter: it
/// cannot change the model.
const CHECKPOINT_INTERVAL: Duration = Duration::from_secs(60);
/// How often whoever watches is told.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(500);

/// The stage that trains.
pub struct Training;

impl Stage for Training {
    type Params = TrainingParams;
    type Output = Model;

    const ID: &'static str = "training";
    const ON_DEVICE: bool = true;
    const ABOUT: &'static str = "trains a dynamic (or static) Gaussian model on a capture";

    fn ports() -> Vec<Port> {
        [Port::one::<CaptureArtifact>(CAPTURE)].into_iter().chain(inputs::optional_ports()).collect()
    }

    fn check_params(params: &TrainingParams) -> Vec<ParamProblem> {
        params.problems()
    }

    fn facts(params: &TrainingParams, _context: &PlanContext<'_>) -> Facts {
        planning::facts(params)
    }

    fn resolve(
        params: TrainingParams,
        context: &PlanContext<'_>,
    ) -> Result<Resolution<TrainingParams>, Vec<ParamProblem>> {
        planning::resolve(params, context)
    }

    fn resources(_params: &TrainingParams) -> Resources {
        Resources { threads: 0 }
    }

    fn unused_sources(params: &TrainingParams) -> Vec<String> {
        methods::unused_sources(&params.method)
    }

    fn run(context: &JobContext, params: &TrainingParams) -> anyhow::Result<Model> {
        let capture = context.input::<CaptureArtifact>(CAPTURE)?.0;
        let start = match context.optional_input::<Model>(START)? {
            Some(model) => Some((model, earlier(context)?)),
            None => None,
        };
        let given = OptionalInputs::open(context)?;
        let pool = rayon::ThreadPoolBuilder::new().num_threads(context.threads).build()?;
        let train_on = |device: Device| {
            if context.profile && !device.gpu().is_none_or(Gpu::time_kernels) {
                tracing::warn!("{} has no timestamps: kernels are counted, not timed", device.name());
            }
            let (stop, on_progress) = (&*context.stop, &*context.on_progress);
            let watch = Watch { stop, on_progress, checkpoint_dir: context.checkpoint_dir(), device };
            pool.install(|| {
                let supplements = given.load(&capture)?;
                train(capture, &supplements, params, start, &watch)
            })
        };
        let trained = compute_on(&context.device, train_on);
        let Some((model, report)) = trained? else {
            return Err(context.interrupted());
        };
        measure(context, &report)?;
        context.measure("device", Device::open(&context.device)?.name())?;
        context.measure("threads", pool.current_num_threads())?;
        if given.has_particles() {
            // How well they were drawn belongs to what this training began with, and reports read trainings.
            context.measure(
                "particles_moving",
                &context.input_record(crate::effects::PARTICLES)?.measurements["moving"],
            )?;
        }
        model.save(context.output_dir())?;
        Ok(model)
    }
}

/// Where a training computes, and whom it asks and tells meanwhile.
pub struct Watch<'a> {
    /// Set when the training should save a checkpoint and stop.
    pub stop: &'a AtomicBool,
    /// Receives progress.
    pub on_progress: &'a (dyn Fn(Progress) + Send + Sync),
    /// Where checkpoints lie.
    pub checkpoint_dir: &'a Path,
    /// What its steps compute on.
    pub device: Device,
}

/// What the training measured whose model lies on the port `start`.
fn earlier(context: &JobContext) -> anyhow::Result<Earlier> {
    let record = context.input_record(START)?;
    let earlier = Earlier::deserialize(&record.measurements);
    earlier.with_context(|| format!("cannot use the measurements of {}", record.producer))
}

/// Trains to the end, from the newest checkpoint if there is one, else from `start` (a model that another training left
/// after a shared phase, and what it measured); `None` if it was asked to stop (a checkpoint is saved).
pub fn train(
    capture: Capture,
    supplements: &Supplements,
    params: &TrainingParams,
    start: Option<(Model, Earlier)>,
    watch: &Watch<'_>,
) -> anyhow::Result<Option<(Model, Report)>> {
    let dataset = Dataset::load(capture, params.shared.curve.views)?;
    let Some((params, choice)) = budget::fit(&dataset, supplements, params, watch)? else { return Ok(None) };
    let params = &params;
    let checkpoint = Checkpoint::load(watch.checkpoint_dir, &serde_json::to_value(params)?);
    let trainer = match (checkpoint, start) {
        (Some(checkpoint), _) => Trainer::resume(&dataset, supplements, params, checkpoint)?,
        (None, Some((model, earlier))) => Trainer::go_on(&dataset, supplements, params, &model, earlier)?,
        (None, None) => Trainer::new(&dataset, supplements, params)?,
    };
    let mut trainer = trainer.on(watch.device);
    let (mut saved, mut told) = (Instant::now(), Instant::now());
    while !trainer.is_done() {
        trainer.advance()?;
        let stopping = watch.stop.load(Ordering::Relaxed);
        if stopping || saved.elapsed() >= CHECKPOINT_INTERVAL {
            trainer.checkpoint()?.save(watch.checkpoint_dir)?;
            saved = Instant::now();
        }
        if stopping {
            return Ok(None);
        }
        if trainer.is_done() || told.elapsed() >= PROGRESS_INTERVAL {
            let (done, total) = trainer.steps();
            (watch.on_progress)(Progress { done, total, message: trainer.status_line() });
            told = Instant::now();
        }
    }
    let report = Report { budget: choice, ..trainer.report() };
    Ok(Some((trainer.finish()?, report)))
}

/// Everything that must not be in the artifact.
fn measure(context: &JobContext, report: &Report) -> anyhow::Result<()> {
    context.measure("training_secs", report.training_secs)?;
    if let Some(choice) = &report.budget {
        context.measure("budget", choice)?;
    }
    context.measure("total_secs", report.total_secs)?;
    context.measure("ms_per_iteration", report.ms_per_iteration)?;
    context.measure("ms_per_iteration_by_phase", &report.ms_per_iteration_by_phase)?;
    context.measure("loss_shares", &report.loss_shares)?;
    context.measure("loss_sums", &report.loss_sums)?;
    context.measure("phases", &report.phases)?;
    context.measure("seconds_by_phase", &report.seconds_by_phase)?;
    context.measure("kernels_ms", &report.kernels)?;
    context.measure("gpu", &report.gpu)?;
    context.measure("skipped_work", &report.skipped)?;
    context.measure("largest_gradients", &report.largest_gradients)?;
    context.measure("guards", &report.guards)?;
    context.measure("curve", &report.curve)?;
    context.measure("curve_split", report.curve_split)?;
    context.measure("peak_memory_bytes", peak_memory_bytes())
}

/// The largest resident set of this process so far; `None` where the system does not tell.
pub fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(1024 * kibibytes)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use engine::{Artifact as _, Coordinates, Failure, FailureKind, InputRecord};
    use serde_json::json;

    use super::*;
    use crate::test_scene::TestScene;

    fn context(root: &Path, capture: &Path) -> JobContext {
        let mut context = JobContext::detached(root).unwrap();
        let record = InputRecord {
            producer: "capture".into(),
            coordinates: Coordinates::new(),
            artifact: Ok::<PathBuf, _>(capture.into()),
            measurements: serde_json::Value::Null,
            action_key: String::new(),
        };
        context.inputs.insert("capture".into(), vec![record]);
        for port in inputs::optional_ports() {
            context.inputs.insert(port.name.into(), Vec::new());
        }
        context
    }

    #[test]
    fn an_interrupted_job_resumes_from_its_checkpoint_to_the_same_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let capture = dir.path().join("capture");
        TestScene::default().write(&capture);
        let params: TrainingParams =
            serde_json::from_value(json!({ "iterations": { "train": 12 }, "initial_points": { "random_count": 40 } }))
                .unwrap();
        let undisturbed = context(&dir.path().join("undisturbed"), &capture);
        Training::run(&undisturbed, &params).unwrap();
        assert!(undisturbed.measurements.borrow()["training_secs"].as_f64().unwrap() > 0.0);

        // Asked to stop, every run makes one step, saves it, and says that it was interrupted.
        let disturbed = context(&dir.path().join("disturbed"), &capture);
        for _ in 0..5 {
            disturbed.stop.store(true, Ordering::Relaxed);
            let failure = Training::run(&disturbed, &params).unwrap_err().downcast::<Failure>().unwrap();
            assert_eq!(failure.kind, FailureKind::Interrupted);
        }
        disturbed.stop.store(false, Ordering::Relaxed);
        Training::run(&disturbed, &params).unwrap();
        for file in ["model.json", "model.safetensors"] {
            let read = |context: &JobContext| std::fs::read(context.output_dir().join(file)).unwrap();
            assert_eq!(read(&undisturbed), read(&disturbed), "{file}");
        }
        Model::open(disturbed.output_dir()).unwrap().check().unwrap();
    }
}
