//! The summary after a run: counts, failures, folders of results, and tables.

use anyhow::Context;
use engine::event::{NodeResult, Outcome};
use engine::scheduler::RunSummary;

use crate::error::CliError;
use crate::output::{self, duration, note};
use crate::session::Session;

/// Results that are listed by name; the others are counted.
const MAX_LISTED: usize = 20;

/// Prints counts, failures and folders of results to standard error.
pub(crate) fn print(session: &Session, summary: &RunSummary) {
    note(&headline(summary));
    list(summary, Outcome::Failed, "failed");
    list(summary, Outcome::MissingData, "MISSING DATA");
    let done = |name: &&String| summary.results.get(*name).is_some_and(|result| result.content.is_some());
    let sinks: Vec<&String> = summary.sinks.iter().filter(done).collect();
    let contents = summary.results.iter().filter_map(|(name, result)| Some((name.as_str(), result.content.as_ref()?)));
    if let Err(error) = session.store.link_results(&summary.recipe, contents) {
        note(&format!("warning: cannot link results to their names: {error:#}"));
    }
    for name in sinks.iter().take(MAX_LISTED) {
        // A report has a file to open; for other artifacts, name the folder.
        let folder = session.store.result_link(&summary.recipe, name);
        let report = folder.join("report.md");
        note(&format!("{name}: {}", if report.exists() { report } else { folder }.display()));
    }
    if sinks.len() > MAX_LISTED {
        note(&format!("… and {} more; see `pipeline show`", sinks.len() - MAX_LISTED));
    }
    summary.not_kept.iter().for_each(|reason| note(&format!("warning: {reason}")));
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

fn list(summary: &RunSummary, outcome: Outcome, title: &str) {
    let found: Vec<(&String, &NodeResult)> =
        summary.results.iter().filter(|(_, result)| result.outcome == outcome).collect();
    if !found.is_empty() {
        note(&format!("{title}:"));
    }
    for (name, result) in found {
        if let Some(failure) = &result.failure {
            note(&format!("  {name}: {failure}"));
        }
        if let Some(dir) = &result.log_dir {
            note(&format!("    logs: {}", dir.display()));
        }
    }
}

/// Prints the run's tables to standard output, as Markdown.
pub(crate) fn print_tables(session: &Session, summary: &RunSummary) -> Result<(), CliError> {
    for index in session.reports() {
        let result = summary.results.get(&session.plan.nodes[index].name);
        let Some(content) = result.and_then(|result| result.content) else { continue };
        let path = session.store.view(&content)?.join("report.md");
        let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        output::print(&text)?;
    }
    Ok(())
}
