//! `run --sweep`: searches over parameters of a recipe. A trial is the recipe with other values; its trainings are
//! ordinary cached jobs, which pause at the rungs of the search. Several processes may work on one search: each takes
//! the next unclaimed trial.

mod batch;
mod claims;
mod forecast;
mod measure;
mod parallel;
mod probe;
mod recipe;
mod report;
mod settings;
mod trial;
mod workers;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use anyhow::Context;
use engine::job::StopRequests;
use engine::recipe::RecipeErrors;
use engine::{Digest, Failure, FailureKind, Store, exit, names_hint};
use sweep::{AxisValues, Entry, Halving, History, Next, Sampler, Space, Trials};

use crate::args::{Conditions, Goal, RecipeArgs, RunArgs, SweepSettings};
use crate::device::ChosenDevice;
use crate::error::CliError;
use crate::output::{duration, note};
use crate::session::Session;
use crate::stages::stages;
use crate::verbs::once::once;
use crate::verbs::worker::end_with;
use claims::{Claims, Held};
use trial::Trial;

pub(crate) use batch::attach;
pub(crate) use settings::{note_search, settings};

/// Number of consecutive trials that fail with the same message before the search stops: their values are then not the cause.
const EQUAL_FAILURES: usize = 3;
/// The name of the best recipe in the folder of a search.
const BEST: &str = "best.toml";
/// The interval at which a process polls for trials while other processes work on the last ones.
const WAIT: Duration = Duration::from_secs(1);

/// The outcome of an attempt to start the next trial.
enum Started {
    /// This process has given it a point.
    Here,
    /// Another process has.
    Elsewhere,
    /// The grid has no more points.
    Nothing,
}

/// A search over parameters of a recipe.
struct Search<'a> {
    store: &'a Path,
    args: &'a RunArgs,
    /// The recipe, on the device of this process.
    recipe: RecipeArgs,
    settings: &'a SweepSettings,
    space: Space,
    /// The maximum number of trials.
    trials: usize,
    halving: Halving,
    sampler: Sampler,
    /// The folder of the history and of the report.
    folder: PathBuf,
    history: History,
    claims: Claims,
    stop: StopRequests,
    /// No trial starts after this time, in seconds since 1970.
    end_secs: f64,
}

/// Searches until no trial can continue, the time has run out, or the user stops the search. Returns the exit code.
pub(crate) fn search(store: &Path, args: &RunArgs, settings: &SweepSettings) -> Result<u8, CliError> {
    end_with(args.sweep.search_parent)?;
    let mut search = Search::open(store, args, settings)?;
    if args.sweep.search_run.is_some() {
        return batch::batch_job(&mut search);
    }
    if args.sweep.search_part.is_none() {
        probe::check(&search)?;
        search.print_forecast()?;
    }
    if args.on.is_some() {
        return batch::submit_and_follow(&mut search);
    }
    // A trial with an objective has had validation views.
    let is_known = search.history.entries.iter().any(|entry| entry.objective.is_some());
    if args.sweep.search_part.is_none() && !is_known {
        probe::refuse_without_validation(&search)?;
    }
    let worked = if args.workers.is_some() || !args.devices.is_empty() { workers::run(&search) } else { search.work() };
    search.history.refresh()?;
    let written = if args.sweep.search_part.is_none() { report::write(&search) } else { Ok(()) };
    worked.and(written)?;
    match search.exit_code() {
        exit::OK if args.sweep.evaluate && args.sweep.search_part.is_none() => evaluate(&search),
        code => Ok(code),
    }
}

/// Trains the best values with new seeds and evaluates them on test views. Returns the exit code.
fn evaluate(search: &Search<'_>) -> Result<u8, CliError> {
    Ok(once(search.store, &search.best(), search.args)?.code)
}

impl<'a> Search<'a> {
    fn open(store: &'a Path, args: &'a RunArgs, settings: &'a SweepSettings) -> Result<Self, CliError> {
        let mut recipe = args.recipe.clone();
        if args.sweep.search_run.is_some() {
            recipe.with.device = ChosenDevice::choose_granted(&recipe.with.device)?.id();
        }
        let base = Session::open(store, &recipe)?;
        let space = settled(&base, &recipe, &settings.space)?;
        refuse_several_methods(&base, &space)?;
        measure::refuse_unmeasurable(&base, &settings.goal)?;
        let (strategy, trials) = settings.plan(&space)?;
        let sampler = Sampler { strategy, space: space.clone(), seed: settings.seed };
        let folder = folder(&base, &sampler, settings)?;
        let history = History::open(&folder)?;
        if !history.points.is_empty() && args.sweep.search_part.is_none() {
            note(&format!("continues the search in {}", folder.display()));
        }
        let stop = match args.sweep.search_run {
            Some(_) => StopRequests::listen_in_batch(),
            None => StopRequests::listen(),
        };
        let end_secs = settings.within.map_or(f64::INFINITY, |within| now_secs() + within.as_secs_f64());
        Ok(Self {
            store,
            args,
            recipe,
            settings,
            halving: Halving { reduction: settings.reduction, rungs: settings.rungs },
            sampler,
            space,
            trials,
            claims: Claims::new(base.store, &folder, args.lease),
            folder,
            history,
            stop: stop.context("cannot listen to signals")?,
            end_secs: args.sweep.search_end.unwrap_or(end_secs),
        })
    }

    /// Runs trials until none is left, the time has run out, or the user stops the search.
    fn work(&mut self) -> Result<(), CliError> {
        while self.stop.count() == 0 && self.is_in_time() {
            self.history.refresh()?;
            let (next, held) = self.next()?;
            let trial = match next {
                Next::Done => break,
                Next::Wait => {
                    std::thread::sleep(WAIT);
                    continue;
                }
                Next::Start => match self.start()? {
                    Started::Here => continue,
                    // The point of another process appears at the next poll, on some file servers not at once.
                    Started::Elsewhere => {
                        std::thread::sleep(WAIT);
                        continue;
                    }
                    Started::Nothing => break,
                },
                Next::Continue { trial, rung } => self.trial(trial, rung),
            };
            let Some(entry) = trial.map(|trial| self.run(&trial)).transpose()?.flatten() else { break };
            note(&self.line(&entry));
            self.history.add(entry)?;
            drop(held);
            self.refuse_equal_failures()?;
        }
        Ok(())
    }

    /// The next step of the search, with the claim on it.
    fn next(&mut self) -> Result<(Next, Option<Held>), CliError> {
        let reached = self.history.reached();
        let started = self.history.points.len();
        let trials = Trials { reached: &reached, started, most: self.trials.max(started) };
        let mut held = Ok(None);
        let claims = &mut self.claims;
        let next = self.halving.next(&trials, |trial, rung| {
            held = claims.take(trial, rung);
            !matches!(held, Ok(None))
        });
        Ok((next, held.context("cannot claim a trial")?))
    }

    /// Gives the next trial a point, unless another process has done so.
    fn start(&mut self) -> Result<Started, CliError> {
        let number = self.history.points.len();
        let compared = self.history.compared(self.settings.reduction.saturating_pow(2));
        let Some(point) = self.sampler.point(number, &compared) else { return Ok(Started::Nothing) };
        let is_new = self.history.start(number, &point)?;
        Ok(if is_new { Started::Here } else { Started::Elsewhere })
    }

    fn trial(&self, number: usize, rung: usize) -> Option<Trial> {
        let point = self.history.points.get(&number)?.clone();
        Some(Trial { number, rung, share: self.halving.share(rung), point })
    }

    fn is_in_time(&self) -> bool {
        now_secs() < self.end_secs
    }

    /// The recipe with the best values, which contains what the command line sets.
    fn best(&self) -> RecipeArgs {
        let with = Conditions { set: Vec::new(), replicates: None, ..self.args.recipe.with.clone() };
        RecipeArgs { recipe: self.folder.join(BEST), with }
    }

    /// Whether the search is over: no trial can continue, or the time has run out.
    fn is_over(&mut self) -> Result<bool, CliError> {
        self.history.refresh()?;
        Ok(!self.is_in_time() || self.next()?.0 == Next::Done)
    }

    /// The error if the latest trials all failed with one message.
    fn refuse_equal_failures(&self) -> Result<(), CliError> {
        match self.history.equal_failures() {
            Some((count, first)) if count >= EQUAL_FAILURES => {
                let message = format!("the last {EQUAL_FAILURES} trials failed with the same message: {first}");
                let failure = Failure::new(FailureKind::BadInput, message);
                let hint = "remove the cause and run the command again: the search continues";
                Err(CliError::Input(failure.hint(hint).into()))
            }
            _ => Ok(()),
        }
    }

    fn exit_code(&self) -> u8 {
        match (self.stop.count(), self.history.best(self.halving.rungs - 1)) {
            (0, Some(_)) => exit::OK,
            (0, None) if self.history.entries.iter().all(|entry| entry.objective.is_some()) => exit::NOTHING,
            (0, None) => exit::FAILED,
            _ if self.stop.last_signal() == "TERM" => exit::TERMINATED,
            _ => exit::INTERRUPTED,
        }
    }

    /// `trial 7 of 40, rung 1: 24.31 dB in 12 s (schedule_scale=0.1)`
    fn line(&self, entry: &Entry) -> String {
        let result = match (self.text(entry), &entry.failure) {
            (Some(text), _) => format!("{text} in {}", duration(entry.secs)),
            (None, failure) => format!("no result ({})", failure.as_deref().unwrap_or("failed")),
        };
        let (trial, rung) = (entry.trial + 1, entry.rung + 1);
        format!("trial {trial} of {}, rung {rung}: {result} ({})", self.trials, short(&entry.assignments))
    }

    /// The value by which an entry is compared, with its unit; `None` if it has no objective.
    fn text(&self, entry: &Entry) -> Option<String> {
        let column = self.settings.goal.compared_by(entry.rung + 1 == self.halving.rungs);
        entry.objective.map(|score| Goal::text(column, Goal::score(column, score)))
    }
}

/// Seconds since 1970, which all processes of a search share.
fn now_secs() -> f64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_secs_f64()
}

/// The search space after all conditions on axes that are not searched have been evaluated.
fn settled(base: &Session, recipe: &RecipeArgs, space: &Space) -> Result<Space, CliError> {
    let of_recipe = engine::recipe::axis_values(&recipe.recipe, &stages());
    let axis = |name: &str| {
        let values = base.plan.nodes.iter().filter_map(|node| node.coordinates.get(name).cloned());
        let chosen: BTreeSet<String> = values.collect();
        let known = chosen.iter().chain(of_recipe.get(name).into_iter().flatten()).cloned().collect();
        (!chosen.is_empty()).then_some(AxisValues { chosen, known })
    };
    space.clone().settled(axis).map_err(|error| {
        let failure = Failure::new(FailureKind::BadInput, error.message);
        let hint = error.unknown.map(|(value, allowed)| names_hint(&value, allowed.iter().map(String::as_str)));
        CliError::Input(hint.into_iter().fold(failure, |failure, hint| failure.hint(hint)).into())
    })
}

/// The folder of a search. Searches of a recipe share one if their parameters, trainings, rungs, objective, limits
/// and sequence of points are equal; the number of trials may differ.
fn folder(base: &Session, sampler: &Sampler, settings: &SweepSettings) -> Result<PathBuf, CliError> {
    let parameters: Vec<String> = sampler.space.0.iter().map(ToString::to_string).collect();
    let trained: Vec<&str> =
        trial::trainings(&base.plan).map(|index| base.plan.nodes[index].plan_id.as_str()).collect();
    let limits: Vec<String> = settings.goal.limits.iter().map(ToString::to_string).collect();
    let objective = settings.goal.objective.key();
    let halving = [settings.rungs, settings.reduction];
    let identity = serde_json::json!([parameters, trained, halving, objective, limits, sampler.sequence()]);
    let digest = Digest::of(identity.to_string().as_bytes());
    Ok(store_folder(&base.store).join(format!("{}-{}", base.plan.recipe, digest.short())))
}

fn store_folder(store: &Store) -> PathBuf {
    store.root().join("sweeps")
}

/// Refuses a recipe with several methods, because a mean over methods is meaningless. A search over the axis `method`
/// is accepted, because each of its trials has one method.
fn refuse_several_methods(base: &Session, space: &Space) -> Result<(), CliError> {
    let methods: BTreeSet<&String> =
        trial::trainings(&base.plan).filter_map(|index| base.plan.nodes[index].coordinates.get("method")).collect();
    if methods.len() < 2 || space.0.iter().any(|parameter| parameter.key == "axes.method") {
        return Ok(());
    }
    let names: Vec<&str> = methods.into_iter().map(String::as_str).collect();
    let failure =
        Failure::new(FailureKind::BadInput, "a search compares trials of one method, but the recipe has several");
    let hint = format!(
        "choose one with -s 'axes.method=[\"{0}\"]', or search over it with --sweep 'axes.method=[\"{0}\"],[\"{1}\"]'",
        names[0], names[1]
    );
    Err(CliError::Input(failure.hint(hint).into()))
}

/// The first error of a recipe on one line, with the assignment or the key that it is about.
fn first(errors: &RecipeErrors) -> String {
    let Some(first) = errors.0.first() else { return "the recipe is invalid".into() };
    let is_assignment = first.file == Path::new("-s");
    let place = if is_assignment { first.source_line.trim() } else { first.key.as_str() };
    if place.is_empty() { first.message.clone() } else { format!("{place}: {}", first.message) }
}

/// Assignments by the last part of their keys.
fn short(assignments: &[String]) -> String {
    let last = |text: &String| {
        let (key, value) = text.split_once('=').unwrap_or((text, ""));
        format!("{}={value}", short_key(key))
    };
    assignments.iter().map(last).collect::<Vec<_>>().join(" ")
}

/// The last part of a key; for learning rates, the last two parts, because their last parts are all equal.
fn short_key(key: &str) -> &str {
    let last = key.rfind('.').map_or(0, |at| at + 1);
    let is_common = ["start", "end", "steps", "count", "rate"].contains(&&key[last..]);
    let before = if is_common { key[..last.saturating_sub(1)].rfind('.').map_or(0, |at| at + 1) } else { last };
    &key[before..]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_keys_distinguish_rates() {
        let assignments = ["nodes.train.params.loss.lambda_dssim=0.2", "a.plane_rate.start=0.1", "seed=1"];
        let text = short(&assignments.map(str::to_owned));
        assert_eq!(text, "lambda_dssim=0.2 plane_rate.start=0.1 seed=1");
    }
}
