//! Joins the inputs of a job to runs: one per finest combination of axis values (scene, method, seed and
//! any other axis), with all measurements.

mod anytime;
mod costs;
mod degenerate;
mod influence;
mod measured;
mod run;

use std::path::Path;

use captures::CaptureArtifact;
use engine::{Artifact, Coordinates, Failure, FailureKind, Input, InputRecord, JobContext};
use metric_evaluation::{Metric, Metrics, Score};
use rendering::Renders;
use serde_json::Value;
use training::{Model, ModelHeader};

pub use costs::{Costs, LossShare, MovingShares};
pub use degenerate::DegenerateRun;
pub(crate) use influence::LossInfluence;
pub use run::{CurvePoint, DEGENERATE, FrameScore, Job, Machine, Run, RunFailure, TensorGradient};
pub(crate) use run::{FINISHED, failure_mark};

use crate::column::{Column, Masked};
use degenerate::Circumstances;
use measured::{RenderingMeasurements, TrainingMeasurements, measurements, time_and_machine};

/// The axis whose values are variants of a method. The first value that a recipe lists is the reference of the others.
pub(crate) const VARIANTS: &str = "ablation";
/// The axis whose values are parts that a training leaves out, and the value for none.
const LEFT_OUT: (&str, &str) = ("without", "nothing");
/// The beginning of the name of a variant that leaves something out.
pub(crate) const WITHOUT: &str = "without ";
/// The variant that leaves out nothing.
const WHOLE: &str = "whole";

/// Whether a run or row of this variant is one of the whole method.
pub(crate) fn is_whole(variant: Option<&str>) -> bool {
    variant.is_none_or(|name| name == WHOLE)
}

/// The effect that lets a model show motion; a method without it is static.
const MOTION: &str = "motion";

/// Number of hexadecimal digits of an action key that tables show.
const SHORT_KEY: usize = 12;

/// A model without its tensors: a report over many models does not keep all of them in memory.
pub(crate) struct ModelSummary {
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

/// The inputs of a job, opened and checked; an input whose producer failed keeps the failure.
pub(crate) struct Inputs {
    models: Vec<Input<ModelSummary>>,
    renders: Vec<Input<Renders>>,
    metrics: Vec<Input<Metrics>>,
    captures: Vec<Input<CaptureArtifact>>,
}

impl Inputs {
    /// Opens the producers on the ports `model`, `renders`, `metrics` and `capture`.
    pub(crate) fn open(context: &JobContext) -> anyhow::Result<Self> {
        Ok(Self {
            models: context.inputs("model")?,
            renders: context.inputs("renders")?,
            metrics: context.inputs("metrics")?,
            captures: context.inputs("capture")?,
        })
    }

    /// Joins models, renders and metrics to runs, in the order of the recipe. Seeds that share all of their jobs count
    /// as one run.
    pub(crate) fn runs(&self) -> anyhow::Result<Vec<Run>> {
        let records = || records(&self.models).chain(records(&self.renders)).chain(records(&self.metrics));
        // A run is the finest set of coordinates, or one with metrics of its own; a producer that lacks an axis belongs to all
        // of its runs.
        let mut of_runs: Vec<&Coordinates> = Vec::new();
        for InputRecord { coordinates, .. } in records() {
            let is_finest = !records().any(|other| is_coarser(coordinates, &other.coordinates));
            let is_measured = || self.metrics.iter().any(|input| input.record.coordinates == *coordinates);
            if (is_finest || is_measured()) && !of_runs.contains(&coordinates) {
                of_runs.push(coordinates);
            }
        }
        let mut runs = Vec::<Run>::new();
        for coordinates in of_runs {
            let run = self.run_at(coordinates)?;
            if !runs.iter().any(|other| other.repeats(&run)) {
                runs.push(run);
            }
        }
        Ok(runs)
    }

    fn run_at(&self, coordinates: &Coordinates) -> anyhow::Result<Run> {
        let mut run = Run { scene: axis(coordinates, "scene"), seed: axis(coordinates, "seed"), ..Run::default() };
        for input in distinct_inputs("model", &self.models, coordinates)? {
            run.add_model(input)?;
        }
        for input in distinct_inputs("renders", &self.renders, coordinates)? {
            run.add_renders(input)?;
        }
        for input in distinct_inputs("metrics", &self.metrics, coordinates)? {
            run.add_metrics(input)?;
        }
        run.judge(belonging(&self.models, coordinates), belonging(&self.metrics, coordinates));
        // A run that failed before it had a model takes the protocol of its capture.
        let mut captures = belonging(&self.captures, coordinates).filter_map(|input| input.artifact.as_ref().ok());
        run.protocol = run.protocol.or_else(|| Some(captures.next()?.protocol.clone()));
        run.name_row(coordinates);
        Ok(run)
    }

    /// The renders of a run with their capture; none if either is missing.
    pub(crate) fn images_of(&self, run: &Run) -> Option<(&Renders, &CaptureArtifact)> {
        let job = run.jobs.get("renders")?;
        let rendered = self.renders.iter().find(|input| input.record.producer == job.name)?;
        let capture = self.captures.iter().find(|input| {
            is_part(&input.record.coordinates, &rendered.record.coordinates)
                && input.artifact.as_ref().is_ok_and(|capture| Some(&capture.protocol) == run.protocol.as_ref())
        })?;
        Some((rendered.artifact.as_ref().ok()?, capture.artifact.as_ref().ok()?))
    }
}

fn is_part(part: &Coordinates, whole: &Coordinates) -> bool {
    part.iter().all(|(axis, value)| whole.get(axis) == Some(value))
}

/// Whether `whole` has all axis values of `part`, and more.
fn is_coarser(part: &Coordinates, whole: &Coordinates) -> bool {
    part != whole && is_part(part, whole)
}

/// The inputs of a run; of those on one port, the finest.
fn belonging<'a, A>(inputs: &'a [Input<A>], coordinates: &Coordinates) -> impl Iterator<Item = &'a Input<A>> {
    let parts: Vec<_> = inputs.iter().filter(|input| is_part(&input.record.coordinates, coordinates)).collect();
    let coordinates_of: Vec<_> = parts.iter().map(|input| &input.record.coordinates).collect();
    let is_finest =
        move |input: &&Input<A>| coordinates_of.iter().all(|other| !is_coarser(&input.record.coordinates, other));
    parts.into_iter().filter(is_finest)
}

/// The inputs of a run on one port. Two of them with the same axis values are an error: one would replace values of the
/// other in the run's row.
fn distinct_inputs<'a, A>(
    port: &str,
    inputs: &'a [Input<A>],
    coordinates: &Coordinates,
) -> anyhow::Result<Vec<&'a Input<A>>> {
    let own: Vec<_> = belonging(inputs, coordinates).collect();
    for (at, input) in own.iter().enumerate() {
        let record = &input.record;
        if let Some(first) = own[..at].iter().find(|other| other.record.coordinates == record.coordinates) {
            let (first, second) = (&first.record.producer, &record.producer);
            let message = format!("{first} and {second} on the port `{port}` have the same axis values");
            let hint = "a row of the table has one job per port: add an axis to the node of one of them, or make a second \
                        report of it";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint).into());
        }
    }
    Ok(own)
}

fn records<A>(inputs: &[Input<A>]) -> impl Iterator<Item = &InputRecord> {
    inputs.iter().map(|input| &input.record)
}

/// The value of an axis; a dash if the recipe lacks the axis.
fn axis(coordinates: &Coordinates, name: &str) -> String {
    coordinates.get(name).cloned().unwrap_or_else(|| "–".into())
}

/// The PSNR above that of the best constant image, dB; none if the whole ground truth has one colour.
fn above_constant(metrics: &Metrics) -> Option<f64> {
    (!metrics.trivial.truth_is_constant()).then(|| metrics.full_psnr() - metrics.trivial.constant_psnr)
}

impl Run {
    fn add_model(&mut self, input: &Input<ModelSummary>) -> anyhow::Result<()> {
        let Some(model) = self.add_record("model", input, "training")? else { return Ok(()) };
        self.method.clone_from(&model.header.method);
        self.protocol = Some(model.header.protocol.clone());
        let number = |name: &str| model.header.method_params.get(name).and_then(Value::as_f64);
        self.schedule_scale = number("schedule_scale");
        self.budget_secs = number("budget_secs");
        self.set(Column::Gaussians, Some(model.header.n_gaussians as f64));
        self.set(Column::SizeMb, Some(model.size_bytes as f64 / 1e6));
        let measured: TrainingMeasurements = measurements(&input.record)?;
        self.set(Column::TrainingSecs, measured.training_secs);
        self.set(Column::MsPerIteration, measured.ms_per_iteration);
        self.set(Column::PeakMemoryMb, measured.peak_memory_bytes.map(|bytes| bytes / 1e6));
        self.largest_gradient = measured.largest_gradient();
        self.guards = measured.guards;
        self.notices = measured.notices;
        self.phases = measured.phases;
        self.influence = influence::influence(&measured.influence, &measured.costs.loss_shares);
        let active = model.header.effects.iter().filter(|decision| decision.on);
        self.effects = active.map(|decision| decision.effect.clone()).collect();
        self.kept_effects = measured.kept_effects;
        self.costs = measured.costs;
        self.curve_split = measured.curve_split;
        self.set_curve(measured.curve);
        Ok(())
    }

    fn add_renders(&mut self, input: &Input<Renders>) -> anyhow::Result<()> {
        let Some(renders) = self.add_record("renders", input, "rendering")? else { return Ok(()) };
        self.method.clone_from(&renders.method);
        self.protocol = Some(renders.protocol.clone());
        let measured: RenderingMeasurements = measurements(&input.record)?;
        let rates = [
            (Column::FpsRaster, measured.fps_raster),
            (Column::FpsModel, measured.fps_model),
            (Column::FpsDelivered, measured.fps_delivered),
        ];
        for (column, rate) in rates {
            match renders.n_gaussians {
                0 => drop(self.figures.insert(column, Score::undefined("no Gaussian is left"))),
                _ => self.set(column, rate.map(|rate| rate.median)),
            }
        }
        Ok(())
    }

    fn add_metrics(&mut self, input: &Input<Metrics>) -> anyhow::Result<()> {
        let Some(metrics) = self.add_record("metrics", input, "judging")? else { return Ok(()) };
        self.method.clone_from(&metrics.method);
        self.protocol = Some(metrics.protocol.clone());
        self.judged_by = Some(metrics.judged_by());
        let means = metrics.means.iter().map(|(metric, score)| (Column::Metric(*metric), score.clone()));
        self.figures.extend(means);
        for (&mask, means) in &metrics.masked {
            let column = |&metric: &Metric| Column::Masked(Masked { metric, mask });
            self.figures.extend(means.iter().map(|(metric, score)| (column(metric), score.clone())));
        }
        self.set(Column::PsnrConstant, Some(metrics.trivial.constant_psnr));
        self.set(Column::PsnrMeanImage, metrics.trivial.mean_image.map(|mean| mean.psnr));
        self.set(Column::AboveConstant, above_constant(metrics));
        if let Some(trivial) = metrics.trivial_prompt_iou() {
            self.set(Column::PromptIouConstant, Some(trivial.constant));
            self.set(Column::PromptIouPrior, Some(trivial.spatial_prior));
        }
        self.prompts.clone_from(&metrics.prompts);
        self.trivial_prompts.clone_from(&metrics.trivial_prompts);
        self.trivial = Some(metrics.trivial.clone());
        self.frames = metrics
            .images
            .iter()
            .filter_map(|image| {
                let psnr = image.values.get(&Metric::Psnr)?.value().filter(|psnr| psnr.is_finite())?;
                Some(FrameScore { name: image.name.clone(), time_secs: image.time_secs, psnr })
            })
            .collect();
        Ok(())
    }

    /// Marks the run as degenerate if its renders show no more than an image that needs no model.
    fn judge<'a>(
        &mut self,
        models: impl Iterator<Item = &'a Input<ModelSummary>>,
        metrics: impl Iterator<Item = &'a Input<Metrics>>,
    ) {
        let headers: Vec<&ModelHeader> =
            models.filter_map(|input| input.artifact.as_ref().ok()).map(|model| &model.header).collect();
        let can_move = |header: &&ModelHeader| header.effects.iter().any(|effect| effect.effect == MOTION && effect.on);
        // Without a model, it is unknown whether the method is static.
        let moves = headers.is_empty() || headers.iter().any(can_move);
        let n_steps = headers.last().map(|header| header.iterations.iter().map(|(_, steps)| steps).sum());
        let training = Circumstances {
            n_gaussians: self.figures.get(&Column::Gaussians).and_then(Score::value),
            schedule_scale: self.schedule_scale,
            has_budget: self.budget_secs.is_some(),
            n_steps,
            notices: &self.notices,
        };
        let judged = metrics.filter_map(|input| input.artifact.as_ref().ok());
        self.degenerate = judged
            .filter_map(|metrics| Some((metrics, metrics.degenerate(moves)?)))
            .map(|(metrics, kind)| DegenerateRun::new(kind, metrics.full_psnr(), &metrics.trivial, &training))
            .next();
    }

    /// Records the job, its machine and the first failure; returns the artifact if there is one.
    fn add_record<'a, A>(&mut self, port: &str, input: &'a Input<A>, work: &str) -> anyhow::Result<Option<&'a A>> {
        let record = &input.record;
        let (wall_secs, machine) = time_and_machine(record)?;
        let key = record.action_key.chars().take(SHORT_KEY).collect();
        self.jobs.insert(port.into(), Job { name: record.producer.clone(), key, wall_secs });
        self.machines.extend(machine.map(|machine| (work.to_owned(), machine)));
        if let Err(failure) = &input.artifact {
            let hint = failure.hint.as_ref().map(|hint| format!("; {hint}")).unwrap_or_default();
            self.failure.get_or_insert_with(|| RunFailure {
                producer: record.producer.clone(),
                kind: failure.kind,
                message: format!("{}{hint}", failure.message),
            });
        }
        Ok(input.artifact.as_ref().ok())
    }

    /// Names the row by the method and every axis other than scene and seed.
    fn name_row(&mut self, coordinates: &Coordinates) {
        if let Some(method) = coordinates.get("method") {
            self.method.clone_from(method);
        }
        let (without, nothing) = LEFT_OUT;
        let left_out = coordinates.get(without).map(|part| match part.as_str() {
            whole if whole == nothing => WHOLE.to_owned(),
            part => format!("{WITHOUT}{part}"),
        });
        self.variant = coordinates.get(VARIANTS).cloned().or(left_out);
        let named = |name: &str| matches!(name, "scene" | "seed" | "method");
        self.axes = coordinates.clone();
        self.axes.retain(|name, _| !named(name));
        let others = self.axes.iter().map(|(name, value)| format!("{name}={value}"));
        let method = Some(self.method.clone()).filter(|method| !method.is_empty());
        self.row = method.into_iter().chain(others).collect::<Vec<_>>().join(" ");
        let of_variant = if self.axes.contains_key(VARIANTS) { VARIANTS } else { without };
        self.axes.remove(of_variant);
    }

    /// Stores the curve and the values derived from it: seconds to a quality, quality within a time.
    pub(crate) fn set_curve(&mut self, curve: Vec<CurvePoint>) {
        self.curve = curve;
        if self.curve.iter().all(|point| point.psnr_val.is_none()) {
            return;
        }
        for column in Column::TIME_TO_SHARE.into_iter().chain(Column::TIME_TO_DB).chain(Column::BUDGETS) {
            let score = anytime::of_curve(column, &self.curve).unwrap_or_else(|| Score::undefined("not measured"));
            self.figures.insert(column, score);
        }
    }

    fn set(&mut self, column: Column, value: Option<f64>) {
        if let Some(value) = value {
            self.figures.insert(column, Score::Value(value));
        }
    }
}
