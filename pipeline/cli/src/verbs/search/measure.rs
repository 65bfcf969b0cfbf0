//! The values that the trainings of a trial reached, from the trainings or from tables: means over all trainings.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use engine::event::{NodeResult, Outcome};
use engine::scheduler::RunSummary;
use engine::{Failure, FailureKind, Stage};
use metric_evaluation::{LPIPS_FOLDER, Metric, MetricEvaluation, MetricEvaluationParams, missing_weights};
use serde::Deserialize;
use table_generation::Column;
use training::Rung;

use crate::args::Goal;
use crate::error::CliError;
use crate::measured;
use crate::session::{Session, TRAINING};

/// What one training has reached.
pub(super) struct Reached {
    psnr: f64,
    pub(super) secs: f64,
    pub(super) steps: u64,
    /// Whether this search computed nothing for it.
    pub(super) is_cached: bool,
    /// The steps of the cached training that it continues from, e.g. of a phase that its parameters do not affect.
    pub(super) shared_steps: u64,
}

/// The measurements of a completed training that a search reads.
#[derive(Deserialize)]
struct Measured {
    training_secs: f64,
    curve: Vec<Point>,
    curve_split: String,
}

#[derive(Deserialize)]
struct Point {
    seconds: f64,
    iteration: u64,
    psnr_val: f64,
}

/// The part of a model's header that a search reads.
#[derive(Deserialize)]
struct Header {
    /// Name and steps of every phase.
    iterations: Vec<(String, u64)>,
}

/// Refuses a goal with a metric that no trial would have: one that the recipe does not compute, or whose weights are missing.
pub(super) fn refuse_unmeasurable(session: &Session, goal: &Goal) -> Result<(), CliError> {
    if !goal.needs_table() {
        return Ok(());
    }
    let needed = session.plan.with_ancestors(&session.required_reports()?.into_iter().collect());
    let nodes = needed.iter().map(|index| &session.plan.nodes[*index]);
    for node in nodes.filter(|node| node.stage == MetricEvaluation::ID) {
        let params = MetricEvaluationParams::deserialize(&node.params)?;
        for metric in goal.columns().filter_map(Column::metric) {
            if let Some(failure) = unmeasurable(session, &node.template, &params, metric) {
                return Err(CliError::Input(failure.into()));
            }
        }
    }
    Ok(())
}

/// Why the jobs of the node called `name` cannot compute a metric, if they cannot.
fn unmeasurable(session: &Session, name: &str, params: &MetricEvaluationParams, metric: Metric) -> Option<Failure> {
    let (key, folder) = (metric.key(), &params.lpips_weights);
    let refused = |reason: String| Failure::new(FailureKind::BadInput, format!("{key} cannot be measured: {reason}"));
    if !params.metrics.contains(&metric) {
        let reason = format!("nodes.{name}.params.metrics does not list it");
        return Some(refused(reason).hint(format!("add {key:?} to the list, or choose another column")));
    }
    let path = session.data_root.join(folder);
    let missing = missing_weights(metric, &path)?;
    if folder.as_os_str().is_empty() {
        let hint = format!("remove this parameter, so that the folder is {LPIPS_FOLDER}, or choose another column");
        return Some(refused(format!("nodes.{name}.params.lpips_weights is empty")).hint(hint));
    }
    let get = match folder == Path::new(LPIPS_FOLDER) {
        true => format!("get it with `pipeline data fetch lpips --data-root {}`", session.data_root.display()),
        false => format!("put it into this folder, which nodes.{name}.params.lpips_weights names"),
    };
    Some(refused(missing).hint(format!("{get}, or choose another column")).at(path))
}

/// What each of these trainings has reached.
pub(super) fn reached(
    session: &Session,
    summary: &RunSummary,
    trained: &BTreeSet<usize>,
    share: f64,
) -> Result<Vec<Reached>, Failure> {
    let of = |&index: &usize| {
        let name = &session.plan.nodes[index].name;
        let result = summary.results.get(name).ok_or_else(|| lost(name))?;
        let (reached, split) = match result.outcome {
            Outcome::Interrupted => paused(session, result, name)?,
            Outcome::Executed | Outcome::Cached => completed(session, index, share)?,
            _ => return Err(result.failure.clone().unwrap_or_else(|| lost(name))),
        };
        if split != "val" {
            return Err(without_validation(name));
        }
        let is_cached = result.outcome == Outcome::Cached;
        Ok(Reached { is_cached, shared_steps: shared_steps(session, summary, index), ..reached })
    };
    trained.iter().map(of).collect()
}

/// The failure of a search whose job `name` has no validation views.
pub(super) fn without_validation(name: &str) -> Failure {
    let message = format!("{name} has no validation views, and test views must not choose anything");
    let hint = "give the capture validation views, e.g. by val_count of its import";
    Failure::new(FailureKind::BadInput, message).hint(hint)
}

/// The values that trainings measure themselves.
pub(super) fn of_trainings(reached: &[Reached]) -> BTreeMap<Column, f64> {
    let mean = |value: fn(&Reached) -> f64| reached.iter().map(value).sum::<f64>() / reached.len().max(1) as f64;
    BTreeMap::from([(Column::PsnrAtEnd, mean(|one| one.psnr)), (Column::TrainingSecs, mean(|one| one.secs))])
}

/// The values of these columns in the tables of a run, in addition to those that trainings measure themselves.
pub(super) fn of_tables(
    session: &Session,
    summary: &RunSummary,
    columns: impl Iterator<Item = Column>,
) -> Result<BTreeMap<Column, f64>, Failure> {
    let failed = |error: CliError| Failure::new(FailureKind::World, error.to_string());
    let runs = measured::of_run(session, summary).map_err(failed)?.runs;
    if runs.is_empty() {
        return Err(lost("the table"));
    }
    let of = |column: Column| {
        let value = |run| {
            let undefined = |reason| {
                let message = format!("{} of {}: {reason}", column.key(), measured::name(run));
                Failure::new(FailureKind::Crashed, message)
            };
            measured::value(run, column).map_err(undefined)
        };
        let values = runs.iter().map(value).collect::<Result<Vec<f64>, _>>()?;
        Ok((column, values.iter().sum::<f64>() / values.len() as f64))
    };
    columns.filter(|column| ![Column::PsnrAtEnd, Column::TrainingSecs].contains(column)).map(of).collect()
}

/// The steps of the training that a training continues, if its result was cached.
fn shared_steps(session: &Session, summary: &RunSummary, index: usize) -> u64 {
    let nodes = &session.plan.nodes;
    let start = nodes[index].producers().into_iter().find(|producer| nodes[*producer].stage == TRAINING);
    let is_cached =
        |at: &usize| summary.results.get(&nodes[*at].name).is_some_and(|result| result.outcome == Outcome::Cached);
    // A result that cannot be read saved no step.
    let header = start.filter(is_cached).and_then(|at| measured(session, &session.record(at).ok()?).ok());
    header.map_or(0, |(_, header)| steps_at(1.0, &header.iterations))
}

fn lost(name: &str) -> Failure {
    Failure::new(FailureKind::Crashed, format!("{name} ended without a result"))
}

/// What a paused training has reached, and the split of its curve.
fn paused(session: &Session, result: &NodeResult, name: &str) -> Result<(Reached, String), Failure> {
    let key = result.key.as_deref().unwrap_or_default();
    let rung = Rung::load(&session.store.checkpoint_dir(key)).ok_or_else(|| lost(name))?;
    let psnr = rung.psnr_val.ok_or_else(|| no_curve(name))?;
    let split = serde_json::to_value(rung.curve_split).ok().and_then(|value| value.as_str().map(str::to_owned));
    let reached = Reached { psnr, secs: rung.training_secs, steps: rung.steps, is_cached: false, shared_steps: 0 };
    Ok((reached, split.unwrap_or_default()))
}

/// What a completed training had reached after a share of its last phase, and the split of its curve.
fn completed(session: &Session, index: usize, share: f64) -> Result<(Reached, String), Failure> {
    let name = &session.plan.nodes[index].name;
    let world = |error: String| Failure::new(FailureKind::World, format!("cannot read what {name} reached: {error}"));
    let record = session.record(index).map_err(|error| world(error.to_string()))?;
    let (Measured { training_secs, curve, curve_split }, Header { iterations }) =
        measured(session, &record).map_err(|error| world(format!("{error:#}")))?;
    let steps = steps_at(share, &iterations);
    let point = curve.iter().rev().find(|point| point.iteration <= steps).ok_or_else(|| no_curve(name))?;
    let secs = if share < 1.0 { point.seconds } else { training_secs };
    Ok((Reached { psnr: point.psnr_val, secs, steps, is_cached: false, shared_steps: 0 }, curve_split))
}

/// The steps of a training that pauses after a share of its last phase.
fn steps_at(share: f64, phases: &[(String, u64)]) -> u64 {
    let Some(((_, last), before)) = phases.split_last() else { return 0 };
    before.iter().map(|(_, steps)| steps).sum::<u64>() + (share * *last as f64).ceil() as u64
}

fn no_curve(name: &str) -> Failure {
    let message = format!("{name} has no point of its quality curve at this rung");
    Failure::new(FailureKind::BadInput, message).hint("set nodes.train.params.curve.points=9, or fewer --rungs")
}

fn measured(session: &Session, record: &engine::store::ActionRecord) -> anyhow::Result<(Measured, Header)> {
    let measured = serde_json::from_value(session.store.read_measurements(&record.measurements)?)?;
    let header = std::fs::read(session.store.view(&record.content)?.join("model.json"))?;
    Ok((measured, serde_json::from_slice(&header)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rungs_divide_the_last_phase() {
        let phases = [("coarse".into(), 60), ("fine".into(), 400)];
        assert_eq!([1.0 / 9.0, 1.0 / 3.0, 1.0].map(|share| steps_at(share, &phases)), [105, 194, 460]);
        assert_eq!(steps_at(0.5, &[]), 0);
    }
}
