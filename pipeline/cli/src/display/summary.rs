//! The summary of a run: counts, the best rows, the failures with their causes, the warnings, and the paths of the results.

use std::collections::BTreeMap;
use std::path::PathBuf;

use engine::Failure;
use engine::event::{NodeResult, Outcome};
use engine::scheduler::RunSummary;
use table_generation::{DegenerateRun, Run};

use crate::measured;
use crate::output::{count, duration, names, note};
use crate::session::Session;
use crate::{best, links, warnings};

/// Maximum number of distinct failures that are listed; `pipeline status` lists all.
const MAX_FAILURES: usize = 5;
/// Results that are listed by name; the others are counted.
const MAX_RESULTS: usize = 5;

/// Links the results of a run to their names, and warns of what could not be written. Returns the nodes whose links stay
/// at an earlier, more complete result, with the folder of this run's result.
pub(crate) fn link(session: &Session, summary: &RunSummary) -> BTreeMap<String, PathBuf> {
    summary.not_kept.iter().for_each(|reason| note(&format!("warning: {reason}")));
    links::update(session, summary).unwrap_or_else(|error| {
        note(&format!("warning: cannot link results to their names: {error:#}"));
        BTreeMap::new()
    })
}

/// Links the results of a run to their names and prints its summary to standard error; `table` is the command that prints
/// its table.
pub(crate) fn print(session: &Session, summary: &RunSummary, table: &str) {
    let kept = link(session, summary);
    note(&headline(summary));
    best::lines(session, summary).iter().for_each(|line| note(line));
    failures(summary).iter().for_each(|line| note(line));
    warnings::lines(&session.store, summary).iter().for_each(|line| note(line));
    results(session, summary, &kept).iter().for_each(|line| note(line));
    if summary.counts.interrupted + summary.counts.not_run > 0 {
        note(&format!("finished cells: {table} --partial"));
    }
}

/// `run …: 7 executed, 2 cached, 1 failed in 12 s`; other counts appear only if they are positive.
fn headline(summary: &RunSummary) -> String {
    let counts = &summary.counts;
    let optional = [
        (counts.failed, "failed"),
        (counts.missing_data, "missing data"),
        (counts.skipped, "skipped"),
        (counts.interrupted, "interrupted"),
        (counts.not_run, "not run"),
    ];
    let mut parts = vec![format!("{} executed", counts.executed), format!("{} cached", counts.cached)];
    parts.extend(optional.iter().filter(|(count, _)| *count > 0).map(|(count, word)| format!("{count} {word}")));
    format!("run {}: {} in {}", summary.run, parts.join(", "), duration(summary.wall_secs))
}

/// Each failure once, with all of its jobs, its log, and the number of jobs that were skipped because of it.
pub(crate) fn failures(summary: &RunSummary) -> Vec<String> {
    let mut lines = Vec::new();
    for (outcome, word) in [(Outcome::Failed, "FAILED"), (Outcome::MissingData, "MISSING DATA")] {
        let groups = groups(summary, outcome);
        for (failure, jobs) in groups.iter().take(MAX_FAILURES) {
            lines.push(format!("{word} {}: {failure}", names(jobs.iter().map(|(name, _)| *name))));
            let log = jobs.iter().find_map(|(_, result)| result.log_dir.as_ref());
            lines.extend(log.map(|dir| format!("  log: {}", dir.join("log").display())));
        }
        if groups.len() > MAX_FAILURES {
            let more = count(groups.len() - MAX_FAILURES, "other failure");
            lines.push(format!("… and {more}; `pipeline status` lists them"));
        }
    }
    let skipped = summary.results.values().filter(|result| result.outcome == Outcome::Skipped).count();
    lines.extend((skipped > 0).then(|| format!("skipped {} that need these results", count(skipped, "job"))));
    lines
}

/// The jobs with this outcome, grouped by equal messages; files may differ.
fn groups(summary: &RunSummary, outcome: Outcome) -> Vec<(String, Vec<(&str, &NodeResult)>)> {
    let mut groups: Vec<(String, Vec<(&str, &NodeResult)>)> = Vec::new();
    let found = summary.results.iter().filter(|(_, result)| result.outcome == outcome);
    for (name, result) in found {
        let text = result.failure.as_ref().map(Failure::to_string).unwrap_or_default();
        let same = |a: &NodeResult| match (&a.failure, &result.failure) {
            (Some(a), Some(b)) => (a.kind, &a.message, &a.hint) == (b.kind, &b.message, &b.hint),
            _ => false,
        };
        match groups.iter_mut().find(|(_, jobs)| same(jobs[0].1)) {
            Some((_, jobs)) => jobs.push((name, result)),
            None => groups.push((text, vec![(name, result)])),
        }
    }
    groups
}

/// Whether there are degenerate runs. Unless `is_quiet`, names them on standard error, with likely causes for the first.
pub(crate) fn degenerate(runs: &[Run], is_quiet: bool) -> bool {
    let found: Vec<(&Run, &DegenerateRun)> =
        runs.iter().filter_map(|run| Some((run, run.degenerate.as_ref()?))).collect();
    if is_quiet {
        return !found.is_empty();
    }
    for (at, (run, degenerate)) in found.iter().take(MAX_FAILURES).enumerate() {
        note(&format!("DEGENERATE {}: {}", measured::name(run), degenerate.message));
        if at == 0 {
            degenerate.advice.iter().for_each(|advice| note(&format!("  {advice}")));
        }
    }
    if found.len() > MAX_FAILURES {
        let more = count(found.len() - MAX_FAILURES, "other degenerate run");
        note(&format!("… and {more}; the report lists them with likely causes"));
    }
    !found.is_empty()
}

/// The paths of the results: the page of a report, otherwise the folder of an artifact. `kept` has the nodes whose
/// links stay at an earlier, more complete result, with the folder of this run's result.
fn results(session: &Session, summary: &RunSummary, kept: &BTreeMap<String, PathBuf>) -> Vec<String> {
    let done = |name: &&String| summary.results.get(*name).is_some_and(|result| result.content.is_some());
    let sinks: Vec<&String> = summary.sinks.iter().filter(done).collect();
    let mut lines = Vec::new();
    for name in sinks.iter().take(MAX_RESULTS) {
        let link = session.store.result_link(&summary.recipe, name);
        let folder = kept.get(*name).unwrap_or(&link);
        let page = folder.join("index.html");
        lines.push(format!("{name}: {}", if page.exists() { &page } else { folder }.display()));
        if kept.contains_key(*name) {
            lines.push(format!("  {} stays at the last result with more data", link.display()));
        }
    }
    if sinks.len() > MAX_RESULTS {
        lines.push(format!("… and {} more; see `pipeline show`", sinks.len() - MAX_RESULTS));
    }
    lines
}
