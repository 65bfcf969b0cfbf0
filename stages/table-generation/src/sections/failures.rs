//! Degenerate and failed runs, notices of trainings, and scenes with missing data.

use std::collections::BTreeSet;

use super::content::Content;
use crate::collect::{FINISHED, Run, failure_mark};
use crate::column::Column;
use crate::distinct::distinct;
use crate::document::{Block, Table, Text};
use crate::format::{NONE, number};
use crate::report::Report;

/// Counts and reasons of runs that are degenerate or failed, notices, and missing data, where present.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let report = content.report;
    let mut blocks = Vec::new();
    let degenerate = degenerate_table(content);
    if !report.failures.is_empty() || degenerate.is_some() {
        blocks.push(Block::Table(count_table(report)));
    }
    blocks.extend(degenerate.map(Block::Table));
    if !report.failures.is_empty() {
        blocks.push(Block::Table(failure_table(report)));
    }
    blocks.extend(notice_table(report).map(Block::Table));
    if !report.missing_data.is_empty() {
        let header = ["scene", "message"].map(String::from).into();
        let mut table = Table::new("Scenes without data on this machine", header).with_text_columns(2);
        let row = |(scene, message): (&String, &String)| [scene, message].map(Text::plain).into();
        table.rows = report.missing_data.iter().map(row).collect();
        blocks.push(Block::Table(table));
    }
    blocks
}

/// Number of runs by method and outcome.
fn count_table(report: &Report) -> Table {
    let present: Vec<&Run> = report.runs.iter().filter(|run| !run.misses_data()).collect();
    let others: BTreeSet<&str> =
        present.iter().map(|run| run.outcome()).filter(|outcome| *outcome != FINISHED).collect();
    let outcomes = || [FINISHED].into_iter().chain(others.iter().copied());
    let header = ["method", "runs"].into_iter().chain(outcomes()).map(String::from).collect();
    let mut table = Table::new("Runs by outcome", header);
    for row in distinct(present.iter().map(|run| run.row.as_str())) {
        let own = || present.iter().filter(|run| run.row == row);
        let count = |outcome| own().filter(|run| run.outcome() == outcome).count();
        let counts = [own().count()].into_iter().chain(outcomes().map(count));
        let counts = counts.map(|count| Text::plain(count.to_string()));
        table.rows.push([Text::plain(&row)].into_iter().chain(counts).collect());
    }
    table
}

/// Every degenerate run with its reason, likely causes and what to try; none if no run is degenerate.
fn degenerate_table(content: &Content<'_>) -> Option<Table> {
    let header = ["method", "scene", "seed", "Gaussians", "reason", "likely causes, and what to try"];
    let mut table =
        Table::new("Degenerate runs: no better than an image that needs no model", header.map(String::from).into())
            .with_text_columns(6);
    for run in &content.report.runs {
        let Some(degenerate) = &run.degenerate else { continue };
        let count = run.figures.get(&Column::Gaussians).and_then(|score| score.value());
        let count = count.map_or(NONE.into(), |count| number(count, 0));
        let texts = [&run.scene, &run.seed, &count, &degenerate.message, &degenerate.advice.join("; ")];
        let first = Text::plain(&run.row).linked(content.traces.scene(&run.row, &run.scene));
        table.rows.push([first].into_iter().chain(texts.map(Text::plain)).collect());
    }
    table.remarks.push(
        "Their values belong to no mean, rank, gain, verdict or comparison; report.csv and report.json have them."
            .into(),
    );
    (!table.rows.is_empty()).then_some(table)
}

/// Every failure with its job and message, by kind.
fn failure_table(report: &Report) -> Table {
    let header = ["kind", "job", "message"].map(String::from).into();
    let mut table = Table::new("Failed runs", header).with_text_columns(3);
    let mut failures: Vec<_> = report.failures.iter().map(|failed| &failed.failure).collect();
    failures.sort_by_key(|failure| (failure.kind, &failure.producer, &failure.message));
    failures.dedup();
    for failure in failures {
        let texts = [failure_mark(failure.kind), &failure.producer, &failure.message];
        table.rows.push(texts.map(Text::plain).into());
    }
    table
}

/// Notices of trainings, with the runs that reported them.
fn notice_table(report: &Report) -> Option<Table> {
    let mut table = Table::new("Notices of trainings", ["run", "notice"].map(String::from).into()).with_text_columns(2);
    for run in &report.runs {
        let name = format!("{} on {}, seed {}", run.row, run.scene, run.seed);
        table.rows.extend(run.notices.iter().map(|notice| [&name, notice].map(Text::plain).into()));
    }
    (!table.rows.is_empty()).then_some(table)
}
