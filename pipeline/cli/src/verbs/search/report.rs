//! The report of a search: the best values as a recipe, tables and a figure.

use std::fmt::Write as _;

use anyhow::Context;
use fs_err as fs;
use sweep::{Entry, best_over_cost, importance, pareto};

use super::{Search, parallel, recipe, short};
use crate::args::Goal;
use crate::error::CliError;
use crate::output::{duration, note, print};

/// Rows of the table of trials.
const ROWS: usize = 10;

/// Writes `report.md`, `trials.svg` and `best.toml` into the search's folder, and prints the report.
pub(super) fn write(search: &Search<'_>) -> Result<(), CliError> {
    fs::create_dir_all(&search.folder).context("cannot write the report of the search")?;
    let last = search.halving.rungs - 1;
    let mut text = format!("# Search over {}\n\n", search.recipe.recipe.display());
    text += &overview(search);
    if let Some(best) = search.history.best(last) {
        let value = value(search, best);
        let _ = writeln!(text, "\nBest: {value} ({})", short(&best.assignments));
        let _ = writeln!(text, "\n{}", recipe::write(search, best, &value)?);
    } else {
        text += "\nNo trial is completed yet; the same command continues.\n";
    }
    text += &trials(search, last);
    let goal = &search.settings.goal;
    let figure = parallel::svg((&search.space, goal.objective, &goal.heading()), &completed(search, last));
    fs::write(search.folder.join("trials.svg"), figure).context("cannot write the figure for the search")?;
    let _ = writeln!(
        text,
        "\n![Values and {} of the completed trials; the best one is orange](trials.svg)",
        goal.heading()
    );
    text += &curve(search, last);
    text += &front(search, last);
    text += &importances(search);
    fs::write(search.folder.join("report.md"), &text).context("cannot write the report of the search")?;
    print(&text)?;
    note(&format!("report: {}", search.folder.join("report.md").display()));
    Ok(())
}

/// The objective of an entry with its unit.
fn value(search: &Search<'_>, entry: &Entry) -> String {
    search.text(entry).unwrap_or_else(|| "–".into())
}

fn overview(search: &Search<'_>) -> String {
    let reached = search.history.reached();
    let mut text = String::from("| rung | share of the last phase | trials |\n|---:|---:|---:|\n");
    for rung in 0..search.halving.rungs {
        let count = reached.values().filter(|rungs| rungs.contains_key(&rung)).count();
        let _ = writeln!(text, "| {} | {:.3} | {count} |", rung + 1, search.halving.share(rung));
    }
    let saved = 100.0 * search.history.saved_share();
    let _ = writeln!(
        text,
        "\nCheckpoints and cached results saved {saved:.0} % of the steps. All values are those on validation views."
    );
    let goal = &search.settings.goal;
    let limits: Vec<String> = goal.limits.iter().map(|limit| format!("`{limit}`")).collect();
    if !limits.is_empty() {
        let _ = writeln!(text, "Limits: {}.", limits.join(", "));
    }
    let failures = || search.history.entries.iter().filter_map(|entry| Some((entry, entry.failure.as_deref()?)));
    if let Some((entry, reason)) = failures().next() {
        let (count, trial) = (failures().count(), entry.trial + 1);
        let _ = writeln!(text, "Trials without a result: {count}, e.g. trial {trial}: {reason}.");
    }
    if search.halving.rungs > 1 && goal.compared_by(false) != goal.objective {
        text += "Before the last rung, trials are compared by the PSNR of the training's own curve.\n";
    }
    text
}

/// The entries of trials that reached the last rung.
fn completed<'a>(search: &'a Search<'_>, last: usize) -> Vec<&'a Entry> {
    search.history.entries.iter().filter(|entry| entry.rung == last).collect()
}

fn trials(search: &Search<'_>, last: usize) -> String {
    let mut entries = completed(search, last);
    entries.sort_by(|a, b| b.objective.partial_cmp(&a.objective).unwrap_or(std::cmp::Ordering::Equal));
    let objective = search.settings.goal.heading();
    let mut text = format!("\n| completed trial | {objective} | training | values |\n|---:|---:|---:|---|\n");
    for entry in entries.iter().take(ROWS) {
        let values = short(&entry.assignments);
        let reason = entry.failure.as_deref().map(|reason| format!(" ({reason})")).unwrap_or_default();
        let (number, value) = (entry.trial + 1, value(search, entry));
        let _ = writeln!(text, "| {number} | {value}{reason} | {} | {values} |", duration(entry.secs));
    }
    text
}

fn curve(search: &Search<'_>, last: usize) -> String {
    let goal = &search.settings.goal;
    let mut text = format!("\n| training of the whole search | best {} so far |\n|---:|---:|\n", goal.heading());
    for (secs, best) in best_over_cost(&search.history.entries, last) {
        let best = Goal::text(goal.objective, Goal::score(goal.objective, best));
        let _ = writeln!(text, "| {} | {best} |", duration(secs));
    }
    text
}

fn front(search: &Search<'_>, last: usize) -> String {
    let objective = search.settings.goal.heading();
    let mut text = format!("\n| best trade-offs of objective and time | {objective} | training |\n|---|---:|---:|\n");
    for entry in pareto(&search.history.entries, last) {
        let value = value(search, entry);
        let _ = writeln!(text, "| {} | {value} | {} |", short(&entry.assignments), duration(entry.secs));
    }
    text
}

fn importances(search: &Search<'_>) -> String {
    let found = importance(&search.space, &search.history.compared(search.settings.reduction.pow(2)));
    if found.iter().all(Option::is_none) {
        return "\nToo few trials to say which parameters matter.\n".into();
    }
    let mut text = String::from("\n| parameter | share of the variance | 90 % interval |\n|---|---:|---:|\n");
    for (parameter, one) in search.space.0.iter().zip(found) {
        let Some(one) = one else {
            let _ = writeln!(text, "| `{}` | – | too few trials set it |", parameter.key);
            continue;
        };
        let [low, high] = one.interval.map(|share| 100.0 * share);
        let _ = writeln!(text, "| `{}` | {:.0} % | {low:.0} to {high:.0} % |", parameter.key, 100.0 * one.share);
    }
    text
}
