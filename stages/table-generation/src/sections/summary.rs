//! The summary: number of runs, best methods, smallest significant difference, reproduced values.

use std::collections::BTreeMap;

use super::content::Content;
use super::published::origin;
use crate::cell::Cell;
use crate::claims::{ClaimColumn, Verdict};
use crate::column::Column;
use crate::document::{Block, Table, Text};
use crate::format::number;
use crate::report::{Group, Report, failure_mark};
use crate::statistics::{mean, welch_half_width};

/// Sentences about runs, leaders and noise, then the table of published values.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let mut sentences = vec![outcomes(content.report)];
    sentences.extend(content.report.groups.iter().flat_map(|group| [best(group), noise(group)]));
    let mut blocks: Vec<Block> = sentences.into_iter().map(Block::Paragraph).collect();
    let table = published(content);
    if content.report.groups.is_empty() {
        blocks.push(Block::Paragraph("Nothing was measured.".into()));
    } else if table.rows.is_empty() {
        blocks.push(Block::Paragraph("No published values are available for these methods and scenes.".into()));
    } else {
        blocks.push(Block::Table(table));
    }
    blocks
}

/// Number of finished runs, and of failed runs by kind.
fn outcomes(report: &Report) -> String {
    let mut failed: BTreeMap<&str, usize> = BTreeMap::new();
    for failure in report.runs.iter().filter_map(|run| run.failure.as_ref()) {
        *failed.entry(failure_mark(failure.kind)).or_default() += 1;
    }
    let n_runs = report.runs.len();
    let n_finished = n_runs - failed.values().sum::<usize>();
    let others: String = failed.iter().map(|(what, count)| format!(", {count} × {what}")).collect();
    format!("{n_runs} runs: {n_finished} finished{others}.")
}

/// The best methods in quality, training time and speed, with the methods that are within noise of them.
fn best(group: &Group) -> String {
    let leader = |column: Column, what: &str, unit: &str| {
        let cells = || group.rows.iter().filter_map(|row| Some((row.name.as_str(), row.headline.get(&column)?)));
        let best: Vec<_> = cells().filter(|(_, cell)| cell.rank == Some(1)).collect();
        let value = best.first()?.1.mean?;
        let limit = smallest_difference(group, column).map_or(0.0, |(limit, _)| limit);
        let is_tied = |cell: &Cell| {
            let behind = cell.mean.map(|mean| (mean - value).abs());
            cell.rank.is_some_and(|rank| rank > 1)
                && (cell.within_noise || behind.is_some_and(|behind| cell.std.is_some() && behind < limit))
        };
        let text = |value| number(value, column.decimals());
        let tied: Vec<String> = cells()
            .filter(|(_, cell)| is_tied(cell))
            .filter_map(|(name, cell)| Some(format!("{name} {}", text(cell.mean?))))
            .collect();
        let names: Vec<&str> = best.iter().map(|(name, _)| *name).collect();
        let tie = if tied.is_empty() { String::new() } else { format!("; within noise: {}", tied.join(", ")) };
        Some(format!("{what}: {} ({} {unit}{tie})", names.join(", "), text(value)))
    };
    let leaders = [
        leader(Column::PSNR, "highest PSNR", "dB"),
        leader(Column::TrainingSecs, "shortest training", "s"),
        leader(Column::FpsModel, "fastest rendering", "frames per second"),
    ];
    let leaders: Vec<String> = leaders.into_iter().flatten().collect();
    let [width, height] = [group.protocol.width, group.protocol.height];
    let about = format!("Protocol {} ({}, {width}×{height})", group.name, group.protocol.dataset);
    if leaders.is_empty() {
        return format!("{about}: nothing to rank.");
    }
    format!("{about}: {}.", leaders.join("; "))
}

/// The smallest significant difference of two means, from the pooled spread of all rows, and the number of seeds.
fn smallest_difference(group: &Group, column: Column) -> Option<(f64, usize)> {
    let cells = || group.rows.iter().filter_map(|row| row.headline.get(&column));
    let variances: Vec<f64> = cells().filter_map(|cell| cell.std).map(|std| std * std).collect();
    let n_seeds = cells().filter(|cell| cell.std.is_some()).map(|cell| cell.n()).min()?;
    let one = (mean(&variances)?.sqrt(), n_seeds);
    Some((welch_half_width(one, one)?, n_seeds))
}

/// A sentence about the smallest significant difference in PSNR.
fn noise(group: &Group) -> String {
    match smallest_difference(group, Column::PSNR) {
        Some((width, n)) => format!(
            "With {n} seeds, differences in mean PSNR below {} dB are not significant under protocol {} (95 %).",
            number(width, 2),
            group.name
        ),
        _ => format!(
            "Protocol {} has one seed per run, so the noise is unknown and small differences may be noise.",
            group.name
        ),
    }
}

/// One line per row and source, with a summary of the verdicts.
fn published(content: &Content<'_>) -> Table {
    let header = ["method", "source", "origin", "verdict on PSNR"].map(String::from).into();
    let mut table = Table::new("Published values and their reproduction", header).with_text_columns(4);
    for (group, claims) in content.report.groups.iter().flat_map(|group| group.claims.iter().map(move |c| (group, c))) {
        for column in &claims.columns {
            let label = match group.label(content.report) {
                label if label.is_empty() => claims.row.clone(),
                label => format!("{} ({label})", claims.row),
            };
            let source = format!("{} ({})", column.claim.source, column.claim.label);
            let texts = [source, origin(column.claim.kind).into(), summary(column, &claims.lines)];
            let first = Text::plain(label).linked(content.traces.row(&claims.row));
            table.rows.push([first].into_iter().chain(texts.map(Text::plain)).collect());
        }
    }
    table
}

/// Number of reproduced lines, and the lines that are not reproduced.
fn summary(column: &ClaimColumn, lines: &[String]) -> String {
    if !column.differences.is_empty() {
        return format!("not comparable: {}", column.differences.join("; "));
    }
    let entries = || column.entries.iter().zip(lines).filter_map(|(entry, line)| Some((&entry.as_ref()?.1, line)));
    let judged = entries().filter(|(verdict, _)| !matches!(verdict, Verdict::NotComparable | Verdict::NotMeasured));
    let agrees = |verdict: &Verdict| matches!(verdict, Verdict::Reproduced { .. } | Verdict::WithinSpread { .. });
    let n_judged = judged.clone().count();
    let n_agreeing = judged.clone().filter(|(verdict, _)| agrees(verdict)).count();
    let others: String = judged
        .filter(|(verdict, _)| !agrees(verdict))
        .map(|(verdict, line)| format!("; {line}: {}", verdict.text()))
        .collect();
    match n_judged {
        0 => "not measured, or measured on other scenes".into(),
        n => format!("{n_agreeing} of {n} reproduced{others}"),
    }
}
