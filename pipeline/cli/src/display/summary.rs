//! The end of a run: what came of it, what went wrong and where the results are.

use anyhow::Context;
use engine::event::{NodeResult, Outcome};
use engine::scheduler::RunSummary;

use crate::error::CliError;
use crate::output::{self, duration, tell};
use crate::session::Session;
use crate::verbs::results::table_nodes;

/// Results listed by name; the others are counted.
const MAX_LISTED: usize = 20;

/// Counts, failures and folders of results, to standard error.
pub fn print(session: &Session, summary: &RunSummary) {
    tell(&headline(summary));
    list(summary, Outcome::Failed, "failed");
    list(summary, Outcome::MissingData, "MISSING DATA");
    let done = |name: &&String| summary.results.get(*name).is_some_and(|result| result.content.is_some());
    let sinks: Vec<&String> = summary.sinks.iter().filter(done).collect();
    let contents = summary.results.iter().filter_map(|(name, result)| Some((name.as_str(), result.content.as_ref()?)));
    if let Err(error) = session.store.link_results(&summary.recipe, contents) {
        tell(&format!("warning: cannot link results to their names: {error:#}"));
    }
    for name in sinks.iter().take(MAX_LISTED) {
        // A report is a file to open; any other artifact is a folder.
        let folder = session.store.result_link(&summary.recipe, name);
        let report = folder.join("report.md");
        tell(&format!("{name}: {}", if report.exists() { report } else { folder }.display()));
    }
    if sinks.len() > MAX_LISTED {
        tell(&format!("… and {} more; see `pipeline show`", sinks.len() - MAX_LISTED));
    }
    summary.not_kept.iter().for_each(|reason| tell(&format!("warning: {reason}")));
}

/// `run …: 7 executed, 2 cached, 1 failed in 12 s`, without what did not occur.
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
        tell(&format!("{title}:"));
    }
    for (name, result) in found {
        if let Some(failure) = &result.failure {
            tell(&format!("  {name}: {failure}"));
        }
        if let Some(dir) = &result.log_dir {
            tell(&format!("    logs: {}", dir.display()));
        }
    }
}

/// The tables that the run made or found, as Markdown on standard output.
pub fn print_tables(session: &Session, summary: &RunSummary) -> Result<(), CliError> {
    for index in table_nodes(session) {
        let result = summary.results.get(&session.plan.nodes[index].name);
        let Some(content) = result.and_then(|result| result.content) else { continue };
        let path = session.store.view(&content)?.join("report.md");
        let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        output::print(&text)?;
    }
    Ok(())
}
