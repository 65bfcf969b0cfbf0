//! What a search shows at its end: the best values as a recipe, tables and a figure.

use std::fmt::Write as _;

use anyhow::Context;
use fs_err as fs;
use sweep::{Entry, best_over_cost, importance, pareto};

use super::{Search, parallel, short};
use crate::error::CliError;
use crate::output::{duration, note, print};
use crate::session::{Session, TRAINING};

/// Seeds for judging the best values: others than those that chose them.
const NEW_SEEDS: [u64; 3] = [1001, 1002, 1003];
/// Rows of the table of trials.
const ROWS: usize = 10;

/// Writes `report.md`, `trials.svg` and `best.toml` into the search's folder, and prints the report.
pub(super) fn write(search: &Search<'_>) -> Result<(), CliError> {
    fs::create_dir_all(&search.folder).context("cannot write the report of the search")?;
    let last = search.halving.rungs - 1;
    let mut text = format!("# Search over {}\n\n", search.args.recipe.recipe.display());
    text += &overview(search);
    if let Some(best) = search.history.best(last) {
        let path = search.folder.join("best.toml");
        fs::write(&path, recipe(search, best)?).context("cannot write the best recipe")?;
        let _ = writeln!(text, "\nBest: {} ({})", psnr(best), short(&best.assignments));
        let _ = writeln!(text, "\nJudge it once, with new seeds, on test views: `pipeline run {}`", path.display());
    } else {
        text += "\nNo trial is completed yet; the same command continues.\n";
    }
    text += &trials(search, last);
    let figure = parallel::svg(&search.settings.space, &completed(search, last));
    fs::write(search.folder.join("trials.svg"), figure).context("cannot write the figure for the search")?;
    text += "\n![Values and PSNR of the completed trials; the best one is orange](trials.svg)\n";
    text += &curve(search, last);
    text += &front(search, last);
    text += &importances(search);
    fs::write(search.folder.join("report.md"), &text).context("cannot write the report of the search")?;
    print(&text)?;
    note(&format!("report: {}", search.folder.join("report.md").display()));
    Ok(())
}

fn psnr(entry: &Entry) -> String {
    entry.objective.map_or("–".into(), |psnr| format!("{psnr:.2} dB"))
}

fn overview(search: &Search<'_>) -> String {
    let reached = search.history.reached();
    let mut text = String::from("| rung | share of the steps | trials |\n|---:|---:|---:|\n");
    for rung in 0..search.halving.rungs {
        let count = reached.values().filter(|rungs| rungs.contains_key(&rung)).count();
        let _ = writeln!(text, "| {} | {:.3} | {count} |", rung + 1, search.halving.share(rung));
    }
    let saved = 100.0 * search.history.saved_share();
    let _ = writeln!(
        text,
        "\nCheckpoints and cached results saved {saved:.0} % of the steps. PSNR is that on validation views."
    );
    text
}

/// The best values as a recipe that extends the searched one, with new seeds.
fn recipe(search: &Search<'_>, best: &Entry) -> Result<String, CliError> {
    let base = &search.args.recipe.recipe;
    let named = base.to_str().filter(|text| text.starts_with("builtin:")).map(str::to_owned);
    let path = match named {
        Some(name) => name,
        None => std::path::absolute(base)?.display().to_string(),
    };
    let plan = Session::read_only(search.store, &search.args.recipe)?.plan;
    let (of_nodes, others): (Vec<&String>, Vec<&String>) =
        search.args.recipe.with.set.iter().chain(&best.assignments).partition(|set| {
            let mut parts = set.splitn(4, '.');
            (parts.next(), parts.nth(1)) == (Some("nodes"), Some("params"))
        });
    let mut text = format!("# The best of a search: {} on validation views.\n", psnr(best));
    let _ = writeln!(text, "extends = [{}]\nname = \"{}-best\"", toml::Value::from(path), plan.recipe);
    let has_seeds = plan.nodes.iter().any(|node| node.stage == TRAINING && node.coordinates.contains_key("seed"));
    if has_seeds && !others.iter().any(|set| set.starts_with("axes.seed")) {
        let _ = writeln!(text, "axes.seed = {NEW_SEEDS:?} # none of those that chose the values");
    }
    others.iter().for_each(|set| _ = writeln!(text, "{set}"));
    text += "[[set]]\n";
    of_nodes.iter().for_each(|set| _ = writeln!(text, "{set}"));
    Ok(text)
}

/// The entries of trials that reached the last rung.
fn completed<'a>(search: &'a Search<'_>, last: usize) -> Vec<&'a Entry> {
    search.history.entries.iter().filter(|entry| entry.rung == last).collect()
}

fn trials(search: &Search<'_>, last: usize) -> String {
    let mut entries = completed(search, last);
    entries.sort_by(|a, b| b.objective.partial_cmp(&a.objective).unwrap_or(std::cmp::Ordering::Equal));
    let mut text = String::from("\n| completed trial | PSNR | training | values |\n|---:|---:|---:|---|\n");
    for entry in entries.iter().take(ROWS) {
        let values = short(&entry.assignments);
        let _ = writeln!(text, "| {} | {} | {} | {values} |", entry.trial + 1, psnr(entry), duration(entry.secs));
    }
    text
}

fn curve(search: &Search<'_>, last: usize) -> String {
    let mut text = String::from("\n| training of the whole search | best PSNR so far |\n|---:|---:|\n");
    for (secs, best) in best_over_cost(&search.history.entries, last) {
        let _ = writeln!(text, "| {} | {best:.2} dB |", duration(secs));
    }
    text
}

fn front(search: &Search<'_>, last: usize) -> String {
    let mut text = String::from("\n| not beaten in both quality and time | PSNR | training |\n|---|---:|---:|\n");
    for entry in pareto(&search.history.entries, last) {
        let _ = writeln!(text, "| {} | {} | {} |", short(&entry.assignments), psnr(entry), duration(entry.secs));
    }
    text
}

fn importances(search: &Search<'_>) -> String {
    let found = importance(&search.history.compared(search.settings.reduction.pow(2)));
    if found.is_empty() {
        return "\nToo few trials to say which parameters matter.\n".into();
    }
    let mut text = String::from("\n| parameter | explains of the spread | 90 % interval |\n|---|---:|---:|\n");
    for (parameter, one) in search.settings.space.0.iter().zip(found) {
        let [low, high] = one.interval.map(|share| 100.0 * share);
        let _ = writeln!(text, "| `{}` | {:.0} % | {low:.0} to {high:.0} % |", parameter.key, 100.0 * one.share);
    }
    text
}
