//! `run --sweep`: searches over parameters of a recipe. A trial is the recipe with other values; its trainings are ordinary
//! cached jobs, which pause at the rungs of the search.

mod parallel;
mod report;
mod trial;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::Context;
use engine::job::StopRequests;
use engine::{Digest, Failure, FailureKind, Store, exit};
use sweep::{Entry, Halving, History, Next, Sampler};

use crate::args::{RunArgs, SweepSettings};
use crate::error::CliError;
use crate::output::{duration, note};
use crate::session::Session;
use trial::Trial;

/// Trials in a row that fail with the same message before the search stops: then the cause is not their values.
const EQUAL_FAILURES: usize = 3;

/// A search over parameters of a recipe.
struct Search<'a> {
    store: &'a Path,
    args: &'a RunArgs,
    settings: &'a SweepSettings,
    halving: Halving,
    sampler: Sampler,
    /// The folder of the history and of the report.
    folder: PathBuf,
    history: History,
    stop: StopRequests,
}

/// Searches until all trials are as far as they get, the time is over, or the user stops it. Returns the exit code.
pub(crate) fn search(store: &Path, args: &RunArgs, settings: &SweepSettings) -> Result<u8, CliError> {
    let mut search = Search::open(store, args, settings)?;
    let clock = Instant::now();
    let mut failures: Vec<Option<String>> = Vec::new();
    let in_time = |clock: &Instant| settings.within.is_none_or(|within| clock.elapsed() < within);
    while search.stop.count() == 0 && in_time(&clock) {
        let next = search.halving.next(&search.history.reached(), settings.trials);
        let Some((number, rung, point)) = search.point_of(next) else { break };
        let trial = Trial { number, rung, share: search.halving.share(rung), point };
        let Some(entry) = search.run(&trial)? else { break };
        note(&line(&entry, settings.trials));
        failures.push(entry.failure.clone());
        search.history.add(entry)?;
        refuse_equal_failures(&failures)?;
    }
    report::write(&search)?;
    Ok(search.exit_code())
}

impl<'a> Search<'a> {
    fn open(store: &'a Path, args: &'a RunArgs, settings: &'a SweepSettings) -> Result<Self, CliError> {
        let base = Session::open(store, &args.recipe)?;
        let halving = Halving { reduction: settings.reduction, rungs: settings.rungs };
        refuse_several_methods(&base)?;
        let folder = folder(&base, settings)?;
        let history = History::open(&folder.join("history.jsonl"))?;
        if !history.entries.is_empty() {
            note(&format!("continues the search in {}", folder.display()));
        }
        let sampler = Sampler { strategy: settings.strategy, space: settings.space.clone(), seed: settings.seed };
        let stop = StopRequests::listen().context("cannot listen to signals")?;
        Ok(Self { store, args, settings, halving, sampler, folder, history, stop })
    }

    /// The number, the rung and the point of the next trial.
    fn point_of(&self, next: Next) -> Option<(usize, usize, Vec<f64>)> {
        match next {
            Next::Done => None,
            Next::Continue { trial, rung } => Some((trial, rung, self.history.trial(trial)?.point.clone())),
            Next::Start => {
                let number = self.history.reached().len();
                let compared = self.history.compared(self.settings.reduction.pow(2));
                Some((number, 0, self.sampler.point(number, &compared)?))
            }
        }
    }

    fn exit_code(&self) -> u8 {
        match (self.stop.count(), self.history.best(self.halving.rungs - 1)) {
            (0, Some(_)) => exit::OK,
            (0, None) => exit::FAILED,
            _ if self.stop.last_signal() == "TERM" => exit::TERMINATED,
            _ => exit::INTERRUPTED,
        }
    }
}

/// The error if the latest trials all failed with one message.
fn refuse_equal_failures(failures: &[Option<String>]) -> Result<(), CliError> {
    let Some(latest) = failures.last_chunk::<EQUAL_FAILURES>() else { return Ok(()) };
    match &latest[0] {
        Some(first) if latest.iter().all(|failure| failure.as_ref() == Some(first)) => {
            let message = format!("the last {EQUAL_FAILURES} trials failed with the same message: {first}");
            let failure = Failure::new(FailureKind::BadInput, message);
            Err(CliError::Input(
                failure.hint("remove the cause and run the command again: the search continues").into(),
            ))
        }
        _ => Ok(()),
    }
}

/// The folder of a search. Searches over the same space of the same recipe have one; the strategy and the number of trials
/// may differ.
fn folder(base: &Session, settings: &SweepSettings) -> Result<PathBuf, CliError> {
    let parameters: Vec<String> = settings.space.0.iter().map(ToString::to_string).collect();
    let trained: Vec<&str> =
        trial::trainings(&base.plan).map(|index| base.plan.nodes[index].plan_id.as_str()).collect();
    let identity = serde_json::json!([parameters, trained, settings.rungs, settings.reduction, settings.max_training]);
    let digest = Digest::of(identity.to_string().as_bytes());
    Ok(store_folder(&base.store).join(format!("{}-{}", base.plan.recipe, digest.short())))
}

fn store_folder(store: &Store) -> PathBuf {
    store.root().join("sweeps")
}

/// A mean over methods says nothing about any of them.
fn refuse_several_methods(base: &Session) -> Result<(), CliError> {
    let methods: std::collections::BTreeSet<&String> =
        trial::trainings(&base.plan).filter_map(|index| base.plan.nodes[index].coordinates.get("method")).collect();
    if methods.len() < 2 {
        return Ok(());
    }
    let names: Vec<&str> = methods.into_iter().map(String::as_str).collect();
    let failure =
        Failure::new(FailureKind::BadInput, "a search compares trials of one method, but the recipe has several");
    let hint = format!("choose one, e.g. -s 'axes.method=[\"{}\"]'; a search each", names[0]);
    Err(CliError::Input(failure.hint(hint).into()))
}

/// `trial 7 of 40, rung 1: 24.31 dB in 12 s (schedule_scale=0.1)`
fn line(entry: &Entry, trials: usize) -> String {
    let result = match (entry.objective, &entry.failure) {
        (Some(psnr), _) => format!("{psnr:.2} dB in {}", duration(entry.secs)),
        (None, failure) => format!("no result ({})", failure.as_deref().unwrap_or("failed")),
    };
    format!("trial {} of {trials}, rung {}: {result} ({})", entry.trial + 1, entry.rung + 1, short(&entry.assignments))
}

/// Assignments by the last part of their keys.
fn short(assignments: &[String]) -> String {
    let last = |text: &String| {
        let (key, value) = text.split_once('=').unwrap_or((text, ""));
        format!("{}={value}", key.rsplit('.').next().unwrap_or(key))
    };
    assignments.iter().map(last).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_failures_in_a_row_stop_the_search() {
        let failures = |texts: &[Option<&str>]| texts.iter().map(|text| text.map(str::to_owned)).collect::<Vec<_>>();
        let stops = |texts: &[Option<&str>]| refuse_equal_failures(&failures(texts)).is_err();
        assert!(stops(&[None, Some("out of memory"), Some("out of memory"), Some("out of memory")]));
        assert!(!stops(&[Some("out of memory"), Some("out of memory")]));
        assert!(!stops(&[Some("a"), Some("b"), Some("a")]) && !stops(&[None, None, None]));
        assert!(!stops(&[Some("a"), None, Some("a")]));
    }
}
