//! One trial: runs its trainings up to a rung, and evaluates them.

use std::collections::{BTreeMap, BTreeSet};

use engine::scheduler::{self, RunOptions, RunSummary};
use engine::{Failure, FailureKind, Plan};
use sweep::Entry;
use table_generation::Column;

use super::measure::{self, Reached};
use super::{Search, first, short};
use crate::args::{Goal, RecipeArgs};
use crate::error::CliError;
use crate::session::{Session, TRAINING};
use crate::verbs::once;

/// A trial and the rung to which it is to train.
pub(super) struct Trial {
    /// The number, from 0.
    pub(super) number: usize,
    /// The rung to reach.
    pub(super) rung: usize,
    /// The share of the training's last phase at which the rung lies; 1 completes the training.
    pub(super) share: f64,
    /// One coordinate per parameter.
    pub(super) point: Vec<f64>,
}

/// The trainings of a plan that no other training continues.
pub(super) fn trainings(plan: &Plan) -> impl Iterator<Item = usize> + '_ {
    let is_training = |index: &usize| plan.nodes[*index].stage == TRAINING;
    let all = (0..plan.nodes.len()).filter(is_training);
    let continued: BTreeSet<usize> = all.clone().flat_map(|index| plan.nodes[index].producers()).collect();
    all.filter(move |index| !continued.contains(index))
}

/// Whether every trial would fail like this one: the machine failed, or all jobs are done but cannot be measured.
fn is_of_all_trials(failure: &Failure, summary: &RunSummary) -> bool {
    let is_of_recipe = failure.kind == FailureKind::BadInput && summary.failures().next().is_none();
    failure.kind == FailureKind::World || is_of_recipe
}

impl Search<'_> {
    /// Runs a trial up to its rung; `None` if the user stopped it. With invalid values, it ends without a result.
    pub(super) fn run(&self, trial: &Trial) -> Result<Option<Entry>, CliError> {
        let is_completed = trial.share >= 1.0;
        let mut entry = self.empty_entry(trial);
        let mut recipe = self.recipe_at(&trial.point);
        // A search must never use test views.
        recipe.with.render_split = Some("val");
        let mut session = match Session::open(self.store, &recipe) {
            Err(CliError::Recipe(errors)) => {
                entry.failure = Some(first(&errors));
                return Ok(Some(entry));
            }
            session => session?,
        };
        let trained: BTreeSet<usize> = trainings(&session.plan).collect();
        session.targets = trained.clone();
        let has_table = is_completed && self.settings.goal.needs_table();
        if has_table {
            session.targets.extend(session.required_reports()?);
        }
        let pauses = trained.iter().map(|index| (*index, trial.share)).filter(|_| !is_completed);
        let options =
            RunOptions { pause_at: pauses.collect(), ..once::options(&session, self.args, self.stop.clone())? };
        let summary = scheduler::run(&session.plan, &session.store, &options, &mut |_| ())?;
        if summary.stopped_by.is_some() {
            return Ok(None);
        }
        let measured = measure::reached(&session, &summary, &trained, trial.share).and_then(|reached| {
            self.count_steps(&mut entry, &reached);
            let mut values = measure::of_trainings(&reached);
            if has_table {
                values.extend(measure::of_tables(&session, &summary, self.settings.goal.columns())?);
            }
            Ok(values)
        });
        match measured {
            Ok(values) => self.judge(&mut entry, &values, is_completed),
            Err(failure) if is_of_all_trials(&failure, &summary) => {
                let (number, values) = (trial.number + 1, short(&entry.assignments));
                let message = format!("trial {number} ({values}): {}", failure.message);
                return Err(anyhow::Error::from(Failure { message, ..failure }).into());
            }
            Err(failure) => entry.failure = Some(failure.to_string()),
        }
        Ok(Some(entry))
    }

    /// The recipe with the values at a point.
    pub(super) fn recipe_at(&self, point: &[f64]) -> RecipeArgs {
        let mut recipe = self.recipe.clone();
        recipe.with.set.extend(self.space.assignments(point));
        recipe
    }

    fn empty_entry(&self, trial: &Trial) -> Entry {
        Entry {
            trial: trial.number,
            point: trial.point.clone(),
            assignments: self.space.assignments(&trial.point),
            rung: trial.rung,
            objective: None,
            values: BTreeMap::new(),
            secs: 0.0,
            steps: 0,
            computed_steps: 0,
            failure: None,
            ended_at_secs: 0.0,
        }
    }

    fn count_steps(&self, entry: &mut Entry, reached: &[Reached]) {
        entry.secs = reached.iter().map(|one| one.secs).sum();
        entry.steps = reached.iter().map(|one| one.steps).sum();
        let computed: u64 = reached.iter().filter(|one| !one.is_cached).map(|one| one.steps).sum();
        let shared = || reached.iter().filter(|one| !one.is_cached).map(|one| one.shared_steps).sum();
        // Steps shared with other trials were counted at the lower rung.
        let known = self.history.trial(entry.trial).map_or_else(shared, |entry| entry.steps);
        entry.computed_steps = computed.saturating_sub(known);
    }

    /// Sets the objective of an entry, or the reason if it violates a limit.
    fn judge(&self, entry: &mut Entry, values: &BTreeMap<Column, f64>, is_completed: bool) {
        let goal = &self.settings.goal;
        let judged = goal.limits.iter().filter(|limit| is_completed || limit.only_gets_worse());
        let value = |column: Column| values.get(&column).copied().unwrap_or(f64::NAN);
        let broken = judged.into_iter().find(|limit| limit.is_broken_by(value(limit.column)));
        let compared = goal.compared_by(is_completed);
        entry.values = values.iter().map(|(column, value)| (column.key().to_owned(), *value)).collect();
        match broken {
            Some(limit) => entry.failure = Some(format!("breaks the limit {limit}")),
            None => entry.objective = Some(Goal::score(compared, value(compared))).filter(|score| score.is_finite()),
        }
    }
}

#[cfg(test)]
mod tests {
    use engine::event::{Counts, NodeResult, Outcome};

    use super::*;

    #[test]
    fn a_job_that_refuses_its_input_fails_only_its_trial() {
        let failure = |kind| Failure::new(kind, "");
        let summary = |result: NodeResult| RunSummary {
            run: "r".into(),
            recipe: "tiny".into(),
            counts: Counts::default(),
            wall_secs: 1.0,
            stopped_by: None,
            sinks: Vec::new(),
            not_kept: None,
            results: BTreeMap::from([("train/a".into(), result)]),
        };
        let refused = failure(FailureKind::BadInput);
        let refusing = NodeResult { failure: Some(refused.clone()), ..NodeResult::new(Outcome::Failed) };
        assert!(!is_of_all_trials(&refused, &summary(refusing.clone())));
        assert!(is_of_all_trials(&refused, &summary(NodeResult::new(Outcome::Executed))), "no curve to measure");
        assert!(is_of_all_trials(&failure(FailureKind::World), &summary(refusing.clone())));
        assert!(!is_of_all_trials(&failure(FailureKind::Diverged), &summary(refusing)));
    }
}
