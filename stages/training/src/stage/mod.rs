//! The training stage: reads a capture and writes a model.

mod budget;
mod inputs;
mod rung;
mod watch;

use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use captures::CaptureArtifact;
use engine::{
    Facts, JobContext, ParamProblem, PlanContext, Port, Progress, Resolution, Resources, Stage, UnusedSources, Work,
};
use scene::Capture;
use serde::Deserialize as _;
use serde_json::Value;
use shaders::gpu::Gpu;
use shaders::tape::Device;

use crate::artifact::Model;
use crate::data::{Dataset, Supplements};
use crate::device::compute_on;
use crate::effects::CAPTURE;
use crate::methods;
use crate::params::TrainingParams;
use crate::planning::{self, START};
use crate::trainer::{Checkpoint, Earlier, Report, Trainer};

pub use rung::Rung;
pub use watch::Watch;

use budget::Choice;
use inputs::OptionalInputs;

/// An interruption loses at most a minute of work; a checkpoint of 100k Gaussians takes a fraction of a second. Not a
/// parameter, because it cannot change the model.
const CHECKPOINT_INTERVAL: Duration = Duration::from_secs(60);
/// Interval between two progress reports.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(500);

/// The training stage.
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

    fn work(params: &TrainingParams, context: &PlanContext<'_>) -> Option<Work> {
        planning::training_work(params, context)
    }

    fn resources(_params: &TrainingParams) -> Resources {
        Resources { threads: 0 }
    }

    fn unused_sources(params: &TrainingParams) -> UnusedSources {
        methods::unused_sources(&params.method)
    }

    fn values(key: &str) -> Option<Vec<String>> {
        match key {
            "method" => Some(methods::names().iter().map(|name| name.to_string()).collect()),
            "without" => Some(methods::parts()),
            _ => None,
        }
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
            let (pause_at, checkpoint_dir) = (context.pause_at, context.checkpoint_dir());
            let watch = Watch { stop, pause_at, on_progress, checkpoint_dir, device };
            pool.install(|| {
                let supplements = given.load(&capture)?;
                train(capture, &supplements, params, start, &watch)
            })
        };
        let trained = compute_on(&context.device, train_on);
        let Some(Trained { model, report, budget, checkpoint_secs }) = trained? else {
            return Err(context.interrupted());
        };
        checkpoint_secs.into_iter().for_each(|secs| context.measure_checkpoint(secs));
        measure(context, &report)?;
        if let Some(choice) = budget {
            choice.warn_if_exceeded(report.training_secs);
            context.measure("budget", choice)?;
        }
        context.measure("device", Device::open(&context.device)?.name())?;
        context.measure("threads", pool.current_num_threads())?;
        if given.has_particles() {
            // The shares of moving particles describe the start of this training, and reports read only trainings.
            context.measure(
                "particles_moving",
                &context.input_record(crate::effects::PARTICLES)?.measurements["moving"],
            )?;
        }
        model.save(context.output_dir())?;
        Ok(model)
    }
}

/// The measurements of the training whose model is on the port `start`.
fn earlier(context: &JobContext) -> anyhow::Result<Earlier> {
    let record = context.input_record(START)?;
    let earlier = Earlier::deserialize(&record.measurements);
    earlier.with_context(|| format!("cannot use the measurements of {}", record.producer))
}

/// A finished training.
pub struct Trained {
    /// The model.
    pub model: Model,
    /// The measurements.
    pub report: Report,
    /// How the schedule was chosen, for a training with a budget.
    budget: Option<Choice>,
    /// The longest time of saving a checkpoint, seconds; none if none was saved.
    checkpoint_secs: Option<f64>,
}

/// The checkpoints of this attempt.
struct Saves {
    last: Instant,
    longest_secs: Option<f64>,
}

impl Saves {
    fn save(&mut self, trainer: &mut Trainer<'_>, dir: &Path) -> anyhow::Result<()> {
        let clock = Instant::now();
        trainer.checkpoint()?.save(dir)?;
        let secs = clock.elapsed().as_secs_f64();
        self.longest_secs = Some(self.longest_secs.map_or(secs, |longest| longest.max(secs)));
        self.last = Instant::now();
        Ok(())
    }
}

/// Trains to the end: from the newest checkpoint if there is one, otherwise from `start` (the model of another training
/// after a shared phase, with its measurements) or from the initial points. `None` if it was stopped; a checkpoint is
/// then saved.
pub fn train(
    capture: Capture,
    supplements: &Supplements,
    params: &TrainingParams,
    start: Option<(Model, Earlier)>,
    watch: &Watch<'_>,
) -> anyhow::Result<Option<Trained>> {
    let dataset = Dataset::load(capture, params.shared.curve.views)?;
    let Some((params, budget)) = budget::fit(&dataset, supplements, params, watch)? else { return Ok(None) };
    let params = &params;
    let checkpoint = Checkpoint::load(watch.checkpoint_dir, &serde_json::to_value(params)?);
    let trainer = match (checkpoint, start) {
        (Some(checkpoint), _) => Trainer::resume(&dataset, supplements, params, checkpoint)?,
        (None, Some((model, earlier))) => Trainer::continue_from(&dataset, supplements, params, &model, earlier)?,
        (None, None) => Trainer::new(&dataset, supplements, params)?,
    };
    let mut trainer = trainer.on(watch.device);
    let mut saves = Saves { last: Instant::now(), longest_secs: None };
    let mut reported = Instant::now();
    while !trainer.is_done() {
        trainer.advance()?;
        let is_paused = !trainer.is_done() && watch.is_due(trainer.steps(), trainer.last_phase_steps());
        let stopping = is_paused || watch.stop.load(Ordering::Relaxed);
        if stopping || saves.last.elapsed() >= CHECKPOINT_INTERVAL {
            saves.save(&mut trainer, watch.checkpoint_dir)?;
        }
        if is_paused {
            Rung::of(&trainer.report(), trainer.steps()).save(watch.checkpoint_dir)?;
        }
        if stopping {
            return Ok(None);
        }
        if trainer.is_done() || reported.elapsed() >= PROGRESS_INTERVAL {
            let (done, total) = trainer.steps();
            (watch.on_progress)(Progress { done, total, message: trainer.status_line() });
            reported = Instant::now();
        }
    }
    let report = trainer.report();
    Ok(Some(Trained { model: trainer.finish()?, report, budget, checkpoint_secs: saves.longest_secs }))
}

/// Records the measurements, i.e. every field of the report, next to the artifact. They are not part of it.
fn measure(context: &JobContext, report: &Report) -> anyhow::Result<()> {
    let Value::Object(fields) = serde_json::to_value(report)? else { bail!("a report is an object") };
    for (name, value) in fields {
        context.measure(&name, value)?;
    }
    context.measure("peak_memory_bytes", peak_memory_bytes())
}

/// Peak resident memory of this process in bytes; `None` where the system does not report it.
fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.split_whitespace().next()?.parse().ok()?;
    Some(1024 * kibibytes)
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use engine::{Artifact as _, Coordinates, Failure, FailureKind, InputRecord};
    use layer_split::Layers;
    use safetensors::tensor::{Dtype, TensorView};
    use scene::{LabelMap, Split, index_file};
    use serde_json::json;
    use shaders::check::noise;

    use super::*;
    use crate::effects::{FEATURES, LAYERS};
    use crate::methods::registry;
    use crate::scene_tests::{SIZE, TestScene};

    fn record(artifact: &Path) -> InputRecord {
        InputRecord {
            producer: "an import".into(),
            coordinates: Coordinates::new(),
            artifact: Ok::<PathBuf, _>(artifact.into()),
            measurements: serde_json::Value::Null,
            action_key: String::new(),
        }
    }

    fn context(root: &Path, capture: &Path) -> JobContext {
        let mut context = JobContext::detached(root).unwrap();
        context.inputs.insert("capture".into(), vec![record(capture)]);
        for port in inputs::optional_ports() {
            context.inputs.insert(port.name.into(), Vec::new());
        }
        context
    }

    #[test]
    fn a_paused_job_says_how_far_it_came_and_continues_to_the_same_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let capture = dir.path().join("capture");
        TestScene::default().write(&capture);
        let params = json!({
            "iterations": { "train": 40 }, "initial_points": { "random_count": 40 }, "curve": { "points": 4, "views": 1 },
        });
        let params: TrainingParams = serde_json::from_value(params).unwrap();
        let undisturbed = context(&dir.path().join("undisturbed"), &capture);
        Training::run(&undisturbed, &params).unwrap();
        let mut paused = context(&dir.path().join("paused"), &capture);
        let curve = undisturbed.measurements.borrow()["curve"].clone();
        for (share, steps, points) in [(0.25, 10, 2), (0.6, 24, 3)] {
            paused.pause_at = Some(share);
            let failure = Training::run(&paused, &params).unwrap_err().downcast::<Failure>().unwrap();
            assert_eq!(failure.kind, FailureKind::Interrupted);
            let rung = Rung::load(paused.checkpoint_dir()).unwrap();
            assert_eq!((rung.steps, rung.total_steps), (steps, 40));
            assert_eq!(rung.psnr_val, curve[points - 1]["psnr_val"].as_f64());
        }
        paused.pause_at = None;
        Training::run(&paused, &params).unwrap();
        let read = |context: &JobContext| std::fs::read(context.output_dir().join("model.safetensors")).unwrap();
        assert_eq!(read(&undisturbed), read(&paused));
    }

    #[test]
    fn an_interrupted_job_resumes_to_the_same_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let capture = dir.path().join("capture");
        TestScene::default().write(&capture);
        let params: TrainingParams =
            serde_json::from_value(json!({ "iterations": { "train": 12 }, "initial_points": { "random_count": 40 } }))
                .unwrap();
        let undisturbed = context(&dir.path().join("undisturbed"), &capture);
        Training::run(&undisturbed, &params).unwrap();
        assert!(undisturbed.measurements.borrow()["training_secs"].as_f64().unwrap() > 0.0);

        // With the stop flag set, every run makes one step, saves it and fails as interrupted.
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

    /// Writes masks of all views, which depend on `seed` and the index of the view.
    fn write_layers(dir: &Path, capture: &Capture, seed: impl Fn(Split) -> u64) {
        let write = |(at, view): (u64, &scene::View)| {
            let values = noise((SIZE * SIZE) as usize, seed(view.split) + at);
            let labels = values.into_iter().map(|value| u8::from(value > 0.0)).collect();
            let mask = LabelMap { width: SIZE, height: SIZE, labels };
            Layers::write_view(dir, &view.name, (SIZE, SIZE), Some(&mask)).unwrap()
        };
        Layers::save(dir, "files", (0..).zip(&capture.views).map(write).collect()).unwrap();
    }

    /// Writes 4 × 4 tokens of all views, which depend on `seed` and the index of the view.
    fn write_features(dir: &Path, capture: &Capture, seed: impl Fn(Split) -> u64) {
        std::fs::create_dir_all(dir.join("visual")).unwrap();
        let write = |name: &str, shape: &[usize], seed: u64| {
            let values = noise(shape.iter().product(), seed).iter().map(|value| *value as f32).collect::<Vec<_>>();
            let tensor = TensorView::new(Dtype::F32, shape.to_vec(), bytemuck::cast_slice(&values)).unwrap();
            let bytes = safetensors::serialize([("values", tensor)], None).unwrap();
            std::fs::write(dir.join(format!("{name}.safetensors")), bytes).unwrap();
        };
        write("text", &[2, 8], 1000);
        for (at, view) in (0..).zip(&capture.views) {
            write(&format!("visual/{}", view.name), &[4, 4, 8], seed(view.split) + at);
        }
        let views: Vec<_> = capture.views.iter().map(|view| json!({ "name": view.name, "grid": [4, 4] })).collect();
        let index = json!({ "source": "files", "dimension": 8, "prompts": ["left", "right"], "views": views });
        index_file::write(&dir.join("features.json"), "features", &index).unwrap();
    }

    #[test]
    fn masks_and_tokens_of_held_out_views_train_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let capture_dir = dir.path().join("capture");
        let capture = TestScene::default().write(&capture_dir);
        let settings = registry().iter().find(|entry| entry.name == "l4dgs").unwrap().tiny();
        let params = json!({
            "method": "l4dgs", "effects": ["motion", "skip-still", "static-semantics", "language"],
            "iterations": { "coarse": 3, "fine": 4 }, "curve": { "points": 0 }, "l4dgs": settings,
        });
        let params: TrainingParams = serde_json::from_value(params).unwrap();
        let trained = |name: &str, [of_training, of_others]: [u64; 2]| {
            let root = dir.path().join(name);
            let [layers, features] = ["layers", "features"].map(|folder| root.join(folder));
            let seed = |split: Split| if split == Split::Train { of_training } else { of_others };
            write_layers(&layers, &capture, seed);
            write_features(&features, &capture, seed);
            let mut context = context(&root.join("job"), &capture_dir);
            context.inputs.insert(LAYERS.into(), vec![record(&layers)]);
            context.inputs.insert(FEATURES.into(), vec![record(&features)]);
            let loaded = OptionalInputs::open(&context).unwrap().load(&capture).unwrap();
            let tokens = loaded.features.unwrap().visual;
            for (view, (mask, tokens)) in capture.views.iter().zip(loaded.moving.iter().zip(&tokens)) {
                let is_training = view.split == Split::Train;
                assert_eq!([mask.is_some(), tokens.is_some()], [is_training; 2], "{}", view.name);
            }
            Training::run(&context, &params).unwrap();
            std::fs::read(context.output_dir().join("model.safetensors")).unwrap()
        };
        let first = trained("first", [0, 0]);
        assert!(first == trained("held-out", [0, 500]), "held-out views change the training");
        assert!(first != trained("training", [500, 0]), "training views change nothing: the test would be blind");
    }
}
