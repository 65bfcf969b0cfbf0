//! Failed runs by kind, and scenes with missing data.

use std::collections::BTreeSet;

use engine::FailureKind;

use super::content::Content;
use crate::collect::Run;
use crate::document::{Block, Table, Text};
use crate::grouping::distinct;
use crate::report::{Report, failure_mark};

/// Counts and messages of failures, and missing data, where present.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let report = content.report;
    let mut blocks = Vec::new();
    if !report.failures.is_empty() {
        blocks.extend([Block::Table(count_table(report)), Block::Table(failure_table(report))]);
    }
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
    let kinds: BTreeSet<FailureKind> = report.failures.iter().map(|failed| failed.failure.kind).collect();
    let marks = kinds.iter().map(|kind| failure_mark(*kind).to_owned());
    let header = ["method", "started", "finished"].into_iter().map(String::from).chain(marks).collect();
    let mut table = Table::new("Runs by outcome", header);
    let present: Vec<&Run> = report.runs.iter().filter(|run| !run.misses_data()).collect();
    for row in distinct(present.iter().map(|run| run.row.as_str())) {
        let own = || present.iter().filter(|run| run.row == row);
        let n_finished = own().filter(|run| run.failure.is_none()).count();
        let n_failed = |kind: &FailureKind| {
            own().filter(|run| run.failure.as_ref().is_some_and(|failure| failure.kind == *kind)).count()
        };
        let counts = [own().count(), n_finished].into_iter().chain(kinds.iter().map(n_failed));
        let counts = counts.map(|count| Text::plain(count.to_string())).collect::<Vec<_>>();
        table.rows.push([Text::plain(&row)].into_iter().chain(counts).collect());
    }
    table
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
