//! Checks a search before any training: whether its values are valid, whether they change what is compared, and whether
//! its captures have the views that decide.

use std::collections::{BTreeMap, BTreeSet};

use engine::recipe::RecipeErrors;
use engine::scheduler::{self, RunOptions};
use engine::{Failure, FailureKind, Plan};
use scene::{Capture, Split};

use super::{Search, first, measure, trial};
use crate::error::CliError;
use crate::output::note;
use crate::session::{REPORT, Session, planned};
use crate::verbs::once;

/// The port of a training for its capture.
const CAPTURE: &str = "capture";

/// The jobs of a trial by their plan ids.
struct Jobs {
    /// The captures of the trainings.
    captures: BTreeSet<String>,
    /// The jobs that determine the objective and the limits.
    measured: BTreeSet<String>,
}

/// The values of one parameter.
#[derive(Default)]
struct Values {
    valid: BTreeSet<String>,
    /// Value → the errors of a recipe that has it.
    invalid: BTreeMap<String, RecipeErrors>,
    /// Whether the jobs depend on the value; `None` without two valid values.
    matter: Option<bool>,
}

/// Refuses a parameter without a valid value, one that changes the captures, and one without any effect on the objective.
/// Warns about single invalid values: trials that have them end without a result.
pub(super) fn check(search: &Search<'_>) -> Result<(), CliError> {
    for (at, parameter) in search.space.0.iter().enumerate() {
        let Values { valid, mut invalid, matter } = values(search, at)?;
        invalid.retain(|value, _| !valid.contains(value));
        if valid.is_empty()
            && let Some((_, errors)) = invalid.pop_first()
        {
            return Err(errors.into());
        }
        for errors in invalid.values() {
            note(&format!("warning: {}; a trial with this value has no result", first(errors)));
        }
        if matter == Some(false) {
            let hint = "search over a parameter of the trainings, or only where it has an effect: KEY=VALUES when \
                        method=NAME";
            return Err(refused(&parameter.key, "nothing that the search compares depends on it", hint));
        }
    }
    Ok(())
}

/// Tries the values of a parameter until all of them are valid and matter, or there is nothing else to try.
fn values(search: &Search<'_>, at: usize) -> Result<Values, CliError> {
    let parameter = &search.space.0[at];
    let mut values = Values::default();
    for points in search.space.contrasts(at) {
        let mut found = Vec::new();
        for point in &points {
            let value = parameter.at(point[at]);
            match jobs(search, point) {
                Ok(jobs) => {
                    values.valid.insert(value);
                    found.push(jobs);
                }
                Err(CliError::Recipe(errors)) => _ = values.invalid.entry(value).or_insert(errors),
                Err(error) => return Err(error),
            }
        }
        let differ = |of: fn(&Jobs) -> &BTreeSet<String>| found.windows(2).any(|pair| of(&pair[0]) != of(&pair[1]));
        if differ(|jobs| &jobs.captures) {
            let problem = "its values change the capture, so trials would be compared on different images";
            return Err(refused(&parameter.key, problem, "choose one value with -s, and search once per value"));
        }
        if found.len() > 1 {
            values.matter = Some(values.matter == Some(true) || differ(|jobs| &jobs.measured));
        }
        if found.len() == points.len() && values.matter != Some(false) {
            break;
        }
    }
    Ok(values)
}

/// Makes the captures, which all trials share, and refuses one without validation views. A capture that cannot be made
/// is left to the first trial, which reports the failure.
pub(super) fn refuse_without_validation(search: &Search<'_>) -> Result<(), CliError> {
    let mut session = Session::open(search.store, &search.recipe)?;
    session.targets = captures(&session.plan);
    let options: RunOptions = once::options(&session, search.args, search.stop.clone())?;
    scheduler::run(&session.plan, &session.store, &options, &mut |_| ())?;
    for index in &session.targets {
        let Ok(record) = session.record(*index) else { continue };
        let capture = Capture::open(&session.store.view(&record.content)?).map_err(anyhow::Error::from)?;
        if capture.views_of(Split::Val).next().is_none() {
            let failure = measure::without_validation(&session.plan.nodes[*index].name);
            return Err(CliError::Input(failure.into()));
        }
    }
    Ok(())
}

/// The nodes of a plan whose captures its trainings read.
fn captures(plan: &Plan) -> BTreeSet<usize> {
    let inputs = trial::trainings(plan).flat_map(|node| &plan.nodes[node].inputs);
    inputs.filter(|input| input.port == CAPTURE).flat_map(|input| input.producers.iter().copied()).collect()
}

fn jobs(search: &Search<'_>, point: &[f64]) -> Result<Jobs, CliError> {
    let plan = planned(&search.recipe_at(point))?;
    let ids = |nodes: &BTreeSet<usize>| nodes.iter().map(|node| plan.nodes[*node].plan_id.clone()).collect();
    let captures = ids(&captures(&plan));
    let mut measured: BTreeSet<usize> = trial::trainings(&plan).collect();
    if search.settings.goal.needs_table() {
        let is_report = |node: &usize| plan.nodes[*node].stage == REPORT;
        let reports = (0..plan.nodes.len()).filter(is_report).collect();
        // The parameters of a report change how it presents the numbers.
        measured.extend(plan.with_ancestors(&reports).into_iter().filter(|node| !is_report(node)));
    }
    Ok(Jobs { captures, measured: ids(&measured) })
}

fn refused(key: &str, problem: &str, hint: &str) -> CliError {
    CliError::Input(Failure::new(FailureKind::BadInput, format!("{key}: {problem}")).hint(hint).into())
}
