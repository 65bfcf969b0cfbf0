//! One trial: runs its trainings up to a rung, and reads what they reached.

use std::collections::{BTreeMap, BTreeSet};

use engine::event::{NodeResult, Outcome};
use engine::scheduler::{self, RunOptions, RunSummary};
use engine::{Failure, FailureKind, Plan};
use serde::Deserialize;
use sweep::Entry;
use training::Rung;

use super::Search;
use crate::error::CliError;
use crate::session::{Session, TRAINING};
use crate::verbs::once;

/// A trial and how far it is to go.
pub(super) struct Trial {
    /// The number, from 0.
    pub(super) number: usize,
    /// The rung to reach.
    pub(super) rung: usize,
    /// The share of the steps that the rung stands for; 1 completes the training.
    pub(super) share: f64,
    /// One coordinate per parameter.
    pub(super) point: Vec<f64>,
}

/// What one training has reached.
struct Reached {
    psnr: f64,
    secs: f64,
    steps: u64,
    /// Whether this search computed nothing for it.
    is_cached: bool,
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

/// The trainings of a plan that no other training continues.
pub(super) fn trainings(plan: &Plan) -> impl Iterator<Item = usize> + '_ {
    let is_training = |index: &usize| plan.nodes[*index].stage == TRAINING;
    let all = (0..plan.nodes.len()).filter(is_training);
    let continued: BTreeSet<usize> = all.clone().flat_map(|index| plan.nodes[index].producers()).collect();
    all.filter(move |index| !continued.contains(index))
}

impl Search<'_> {
    /// Runs a trial up to its rung; `None` if the user stopped it.
    pub(super) fn run(&self, trial: &Trial) -> Result<Option<Entry>, CliError> {
        let assignments = self.settings.space.assignments(&trial.point);
        let mut recipe = self.args.recipe.clone();
        recipe.with.set.extend(assignments.iter().cloned());
        let mut session = Session::open(self.store, &recipe)?;
        session.targets = trainings(&session.plan).collect();
        let pauses = session.targets.iter().map(|index| (*index, trial.share)).filter(|(_, share)| *share < 1.0);
        let options =
            RunOptions { pause_at: pauses.collect(), ..once::options(&session, self.args, self.stop.clone())? };
        let summary = scheduler::run(&session.plan, &session.store, &options, &mut |_| ())?;
        if summary.stopped_by.is_some() {
            return Ok(None);
        }
        let mut entry = Entry {
            trial: trial.number,
            point: trial.point.clone(),
            assignments,
            rung: trial.rung,
            objective: None,
            values: BTreeMap::new(),
            secs: 0.0,
            steps: 0,
            computed_steps: 0,
            failure: None,
        };
        match reached(&session, &summary, trial.share) {
            Ok(reached) => self.fill(&mut entry, &session.plan, &reached),
            // The recipe or the machine is at fault, not the values of the trial.
            Err(failure) if [FailureKind::World, FailureKind::BadInput].contains(&failure.kind) => {
                return Err(anyhow::Error::from(failure).into());
            }
            Err(failure) => entry.failure = Some(failure.to_string()),
        }
        Ok(Some(entry))
    }

    fn fill(&self, entry: &mut Entry, plan: &Plan, reached: &BTreeMap<usize, Reached>) {
        let count = reached.len().max(1) as f64;
        let mean = reached.values().map(|one| one.psnr).sum::<f64>() / count;
        let mean_secs = reached.values().map(|one| one.secs).sum::<f64>() / count;
        entry.values = reached.iter().map(|(index, one)| (plan.nodes[*index].name.clone(), one.psnr)).collect();
        entry.secs = reached.values().map(|one| one.secs).sum();
        entry.steps = reached.values().map(|one| one.steps).sum();
        let lower_rung = self.history.trial(entry.trial).map_or(0, |entry| entry.steps);
        let computed: u64 = reached.values().filter(|one| !one.is_cached).map(|one| one.steps).sum();
        entry.computed_steps = computed.saturating_sub(lower_rung);
        match self.settings.max_training.filter(|limit| mean_secs > limit.as_secs_f64()) {
            Some(limit) => entry.failure = Some(format!("trains {mean_secs:.1} s, longer than {limit:?}")),
            None => entry.objective = Some(mean).filter(|mean| mean.is_finite()),
        }
    }
}

/// What each training has reached.
fn reached(session: &Session, summary: &RunSummary, share: f64) -> Result<BTreeMap<usize, Reached>, Failure> {
    let of = |&index: &usize| {
        let name = &session.plan.nodes[index].name;
        let result = summary.results.get(name).ok_or_else(|| lost(name))?;
        let (rung, split) = match result.outcome {
            Outcome::Interrupted => paused(session, result, name)?,
            Outcome::Executed | Outcome::Cached => completed(session, index, share)?,
            _ => return Err(result.failure.clone().unwrap_or_else(|| lost(name))),
        };
        if split != "val" {
            let message = format!("{name} has no validation views, and test views never choose anything");
            let hint = "give the capture validation views, e.g. with its parameter for them";
            return Err(Failure::new(FailureKind::BadInput, message).hint(hint));
        }
        Ok((index, Reached { is_cached: result.outcome == Outcome::Cached, ..rung }))
    };
    session.targets.iter().map(of).collect()
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
    let reached = Reached { psnr, secs: rung.training_secs, steps: rung.steps, is_cached: false };
    Ok((reached, split.unwrap_or_default()))
}

/// What a completed training had reached after a share of its steps, and the split of its curve.
fn completed(session: &Session, index: usize, share: f64) -> Result<(Reached, String), Failure> {
    let name = &session.plan.nodes[index].name;
    let world = |error: String| Failure::new(FailureKind::World, format!("cannot read what {name} reached: {error}"));
    let record = session.record(index).map_err(|error| world(error.to_string()))?;
    let Measured { training_secs, curve, curve_split } =
        measured(session, &record).map_err(|error| world(format!("{error:#}")))?;
    let last = curve.last().ok_or_else(|| no_curve(name))?.iteration;
    let limit = share * last as f64;
    let point = curve.iter().rev().find(|point| point.iteration as f64 <= limit).ok_or_else(|| no_curve(name))?;
    let secs = if share < 1.0 { point.seconds } else { training_secs };
    Ok((Reached { psnr: point.psnr_val, secs, steps: limit.ceil() as u64, is_cached: false }, curve_split))
}

fn no_curve(name: &str) -> Failure {
    let message = format!("{name} has no point of its quality curve at this rung");
    Failure::new(FailureKind::BadInput, message).hint("set nodes.train.params.curve.points=9, or fewer --rungs")
}

fn measured(session: &Session, record: &engine::store::ActionRecord) -> anyhow::Result<Measured> {
    Ok(serde_json::from_value(session.store.read_measurements(&record.measurements)?)?)
}
