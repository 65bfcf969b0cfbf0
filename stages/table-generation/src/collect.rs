//! From the inputs of a job to runs: one per scene, method and seed, with everything that was measured about it.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context as _;
use engine::{Artifact, Coordinates, FailureKind, Input, InputRecord, JobContext};
use metric_evaluation::{Metrics, Score};
use rendering::Renders;
use scene::{Protocol, Split};
use serde::{Deserialize, Serialize};
use training::{Model, ModelHeader};

use crate::costs::Costs;
use crate::{Column, ablation};

/// Hexadecimal digits of an action key that tables show.
const SHORT_KEY: usize = 12;

/// One method on one scene with one seed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Run {
    /// The scene's name.
    pub scene: String,
    /// The table row: the method, and the values of any axis besides scene and seed.
    pub row: String,
    /// The method's id, which published values are found by.
    pub method: String,
    /// The value of the axis [`ablation::AXIS`], where the recipe has it.
    pub variant: Option<String>,
    /// The seed's axis value.
    pub seed: String,
    /// How the images came to be, as far as the run came to have any.
    pub protocol: Option<Protocol>,
    /// Who judged what (see [`Metrics::judged_by`]).
    pub judged_by: Option<String>,
    /// The figures; an undefined one says why.
    pub figures: BTreeMap<Column, Score>,
    /// Quality over training time.
    pub curve: Vec<CurvePoint>,
    /// The split whose views the curve was measured on.
    pub curve_split: Option<Split>,
    /// Seconds per phase of training.
    pub phases: BTreeMap<String, f64>,
    /// The same by phase, loss and what was left out.
    pub costs: Costs,
    /// `training on cpu, 2 threads`, `rendering on cpu, 2 threads`.
    pub machines: Vec<String>,
    /// What went wrong first, if anything did.
    pub failure: Option<RunFailure>,
    /// Short action keys of the jobs by port, for tracing a number to its job.
    pub action_keys: BTreeMap<String, String>,
}

/// Quality at one moment of training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CurvePoint {
    /// Seconds of training, evaluation excluded.
    pub seconds: f64,
    /// Optimiser steps so far.
    pub iteration: u64,
    /// Gaussians at that moment.
    #[serde(default)]
    pub n_gaussians: u64,
    /// PSNR in dB on a few views of the run's `curve_split`.
    pub psnr_val: Option<f64>,
}

/// Why a run has no numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunFailure {
    /// The job that failed, as `train/lego/mcgs/0`.
    pub producer: String,
    /// The kind of thing that went wrong.
    pub kind: FailureKind,
    /// What went wrong, and what to do about it; without paths, which differ between machines.
    pub message: String,
}

/// What training measures beside its model.
#[derive(Default, Deserialize)]
#[serde(default)]
struct TrainingMeasurements {
    training_secs: Option<f64>,
    ms_per_iteration: Option<f64>,
    peak_memory_bytes: Option<f64>,
    curve: Vec<CurvePoint>,
    curve_split: Option<Split>,
    phases: BTreeMap<String, f64>,
    #[serde(flatten)]
    costs: Costs,
    device: Option<String>,
    threads: Option<u64>,
}

/// What rendering measures beside its images.
#[derive(Default, Deserialize)]
#[serde(default)]
struct RenderingMeasurements {
    fps_raster: Option<FrameRate>,
    fps_model: Option<FrameRate>,
    fps_delivered: Option<FrameRate>,
    device: Option<String>,
    threads: Option<u64>,
}

#[derive(Deserialize)]
struct FrameRate {
    median: f64,
}

/// A model without its tensors, so that a report over many models does not hold them all in memory.
pub struct ModelSummary {
    header: ModelHeader,
    size_bytes: u64,
}

impl Artifact for ModelSummary {
    const NAME: &'static str = Model::NAME;
    const SCHEMA: u32 = Model::SCHEMA;

    fn open(dir: &Path) -> anyhow::Result<Self> {
        let model = Model::open(dir)?;
        model.check()?;
        Ok(Self { size_bytes: model.size_bytes(), header: model.header })
    }

    fn check(&self) -> anyhow::Result<()> {
        Ok(())
    }
}

/// Joins the producers on the ports `model`, `renders` and `metrics` to runs, in the order of the recipe.
pub fn collect(context: &JobContext) -> anyhow::Result<Vec<Run>> {
    let models = context.inputs::<ModelSummary>("model")?;
    let renders = context.inputs::<Renders>("renders")?;
    let metrics = context.inputs::<Metrics>("metrics")?;
    let records = || records(&models).chain(records(&renders)).chain(records(&metrics));
    let is_part = |part: &Coordinates, whole: &Coordinates| part.iter().all(|(axis, v)| whole.get(axis) == Some(v));

    // A run is the finest set of coordinates; a producer that lacks an axis belongs to all of its runs.
    let mut finest: Vec<&Coordinates> = Vec::new();
    for InputRecord { coordinates, .. } in records() {
        let coarser =
            records().any(|other| other.coordinates != *coordinates && is_part(coordinates, &other.coordinates));
        if !coarser && !finest.contains(&coordinates) {
            finest.push(coordinates);
        }
    }
    let run_at = |coordinates: &Coordinates| {
        let mut run = Run { scene: axis(coordinates, "scene"), seed: axis(coordinates, "seed"), ..Run::default() };
        for input in models.iter().filter(|input| is_part(&input.record.coordinates, coordinates)) {
            run.add_model(input)?;
        }
        for input in renders.iter().filter(|input| is_part(&input.record.coordinates, coordinates)) {
            run.add_renders(input)?;
        }
        for input in metrics.iter().filter(|input| is_part(&input.record.coordinates, coordinates)) {
            run.add_metrics(input);
        }
        run.name_row(coordinates);
        Ok(run)
    };
    finest.into_iter().map(run_at).collect()
}

fn records<A>(inputs: &[Input<A>]) -> impl Iterator<Item = &InputRecord> {
    inputs.iter().map(|input| &input.record)
}

/// The value of an axis; a recipe without the axis has one nameless value.
fn axis(coordinates: &Coordinates, name: &str) -> String {
    coordinates.get(name).cloned().unwrap_or_else(|| "–".into())
}

impl Run {
    fn add_model(&mut self, input: &Input<ModelSummary>) -> anyhow::Result<()> {
        let Some(model) = self.add_record("model", input) else { return Ok(()) };
        self.method.clone_from(&model.header.method);
        self.protocol = Some(model.header.protocol.clone());
        self.set(Column::Gaussians, Some(model.header.n_gaussians as f64));
        self.set(Column::SizeMb, Some(model.size_bytes as f64 / 1e6));
        let measured: TrainingMeasurements = measurements(&input.record)?;
        self.set(Column::TrainingSecs, measured.training_secs);
        self.set(Column::MsPerIteration, measured.ms_per_iteration);
        self.set(Column::PeakMemoryMb, measured.peak_memory_bytes.map(|bytes| bytes / 1e6));
        self.machines.extend(machine("training", measured.device, measured.threads));
        self.phases = measured.phases;
        self.costs = measured.costs;
        self.curve_split = measured.curve_split;
        self.set_curve(measured.curve);
        Ok(())
    }

    fn add_renders(&mut self, input: &Input<Renders>) -> anyhow::Result<()> {
        let Some(renders) = self.add_record("renders", input) else { return Ok(()) };
        self.method.clone_from(&renders.method);
        self.protocol = Some(renders.protocol.clone());
        let measured: RenderingMeasurements = measurements(&input.record)?;
        self.set(Column::FpsRaster, measured.fps_raster.map(|rate| rate.median));
        self.set(Column::FpsModel, measured.fps_model.map(|rate| rate.median));
        self.set(Column::FpsDelivered, measured.fps_delivered.map(|rate| rate.median));
        self.machines.extend(machine("rendering", measured.device, measured.threads));
        Ok(())
    }

    fn add_metrics(&mut self, input: &Input<Metrics>) {
        let Some(metrics) = self.add_record("metrics", input) else { return };
        self.method.clone_from(&metrics.method);
        self.protocol = Some(metrics.protocol.clone());
        self.judged_by = Some(metrics.judged_by());
        let figures = metrics.means.iter().map(|(metric, score)| (Column::Metric(*metric), score.clone()));
        self.figures.extend(figures);
    }

    /// Keeps the action key and the first failure; returns the artifact if there is one.
    fn add_record<'a, A>(&mut self, port: &str, input: &'a Input<A>) -> Option<&'a A> {
        let key: String = input.record.action_key.chars().take(SHORT_KEY).collect();
        self.action_keys.insert(port.into(), key);
        if let Err(failure) = &input.artifact {
            let hint = failure.hint.as_ref().map(|hint| format!("; {hint}")).unwrap_or_default();
            self.failure.get_or_insert_with(|| RunFailure {
                producer: input.record.producer.clone(),
                kind: failure.kind,
                message: format!("{}{hint}", failure.message),
            });
        }
        input.artifact.as_ref().ok()
    }

    /// The row is named by the method and every axis that is neither scene nor seed.
    fn name_row(&mut self, coordinates: &Coordinates) {
        if let Some(method) = coordinates.get("method") {
            self.method.clone_from(method);
        }
        self.variant = coordinates.get(ablation::AXIS).cloned();
        let named = |name: &str| matches!(name, "scene" | "seed" | "method");
        let others = coordinates.iter().filter(|(name, _)| !named(name));
        self.row = others.fold(self.method.clone(), |row, (name, value)| format!("{row} {name}={value}"));
    }

    /// Keeps the curve and derives the seconds to 90, 95 and 99 % of its last PSNR.
    pub(crate) fn set_curve(&mut self, curve: Vec<CurvePoint>) {
        self.curve = curve;
        let seconds = [(Column::SecsTo90, 0.90), (Column::SecsTo95, 0.95), (Column::SecsTo99, 0.99)];
        seconds.into_iter().for_each(|(column, share)| self.set(column, seconds_to(&self.curve, share)));
    }

    fn set(&mut self, column: Column, value: Option<f64>) {
        if let Some(value) = value {
            self.figures.insert(column, Score::Value(value));
        }
    }
}

/// Seconds until the PSNR (in dB) first reached `share` of its last value.
fn seconds_to(curve: &[CurvePoint], share: f64) -> Option<f64> {
    let last = curve.last()?.psnr_val?;
    curve.iter().find(|point| point.psnr_val.is_some_and(|psnr| psnr >= share * last)).map(|point| point.seconds)
}

fn machine(what: &str, device: Option<String>, threads: Option<u64>) -> Option<String> {
    let threads = threads.map(|threads| format!(", {threads} threads")).unwrap_or_default();
    Some(format!("{what} on {}{threads}", device?))
}

/// The producer's measurements; a producer that measured nothing has none.
fn measurements<T: Default + for<'a> Deserialize<'a>>(record: &InputRecord) -> anyhow::Result<T> {
    if record.measurements.is_null() {
        return Ok(T::default());
    }
    T::deserialize(&record.measurements).with_context(|| format!("cannot read the measurements of {}", record.producer))
}
