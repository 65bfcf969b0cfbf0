//! What the report says, as a document.

use std::collections::BTreeSet;

use crate::ablation::ablation_tables;
use crate::claims::{ClaimColumn, ClaimTable, Kind, Verdict};
use crate::costs::cost_tables;
use crate::curves::figures;
use crate::document::{Block, Document, Table, Text};
use crate::format::{NONE, number, signed};
use crate::report::{Cell, Group, Report, Row, failure_mark};
use crate::{Column, TableGenerationParams};

/// Phases of training in the order of a step; others follow by name.
const PHASES: [&str; 10] =
    ["load", "motion", "projection", "sort", "blend", "losses", "backward", "optimizer", "density", "evaluation"];

/// The whole report as a document.
pub fn document(report: &Report, params: &TableGenerationParams) -> Document {
    let mut blocks = Vec::new();
    if report.groups.is_empty() {
        blocks.push(Block::Paragraph("No run was measured; see what failed below.".into()));
    }
    for group in &report.groups {
        blocks.push(Block::Heading(format!("Protocol {}: {}", group.name, group.protocol.dataset)));
        blocks.push(Block::Paragraph(protocol_text(group)));
        blocks.push(Block::Table(headline_table(group)));
        blocks.push(Block::Table(scene_table(group, Column::PSNR)));
        blocks.extend(conditional_tables(group).map(Block::Table));
        blocks.extend(ablation_tables(group).into_iter().map(Block::Table));
        blocks.extend(group.claims.iter().map(|claims| Block::Table(claim_table(claims))));
    }
    let figures = figures(report, params);
    if !figures.is_empty() {
        blocks.push(Block::Heading("What accuracy costs in time".into()));
        blocks.extend(figures);
    }
    for group in &report.groups {
        blocks.extend(time_table(group).map(Block::Table));
        blocks.extend(phase_table(group).map(Block::Table));
        blocks.extend(cost_tables(group).map(Block::Table));
    }
    blocks.extend(failure_blocks(report));
    Document { title: report.title.clone(), blocks }
}

fn protocol_text(group: &Group) -> String {
    let machines: Vec<_> = group.machines.iter().map(String::as_str).collect();
    let measured = if machines.is_empty() { String::new() } else { format!(" Times: {}.", machines.join("; ")) };
    format!("{} · {}. Means over {}.{measured}", group.protocol.line(), group.judged_by, scene_list(&group.scenes))
}

fn scene_list(scenes: &[String]) -> String {
    format!("{} scene{} ({})", scenes.len(), if scenes.len() == 1 { "" } else { "s" }, scenes.join(", "))
}

fn headline_table(group: &Group) -> Table {
    let columns = Column::HEADLINE;
    let header = ["method".into()].into_iter().chain(columns.map(Column::heading)).chain(["seeds".into()]).collect();
    let mut table = Table::new(format!("Protocol {}: means over scenes", group.name), header);
    for row in &group.rows {
        let n_seeds = row.headline.values().map(|cell| cell.n_expected).max().unwrap_or(0);
        let mut cells = vec![Text::plain(&row.name)];
        for column in columns {
            let text = row.headline.get(&column).map(|cell| mean_text(cell, column, &mut table));
            cells.push(text.unwrap_or_default());
        }
        cells.push(Text::plain(n_seeds.to_string()));
        table.rows.push(cells);
    }
    if group.rows.iter().any(|row| row.headline.values().any(|cell| cell.std.is_some())) {
        table.notes.push("± is the sample standard deviation over seeds of the mean over scenes.".into());
    }
    table
}

/// A headline cell: no mean where a scene is missing; the reason goes to a footnote.
fn mean_text(cell: &Cell, column: Column, table: &mut Table) -> Text {
    let mut text = cell_text(cell, column);
    if let Some(reason) = &cell.reason {
        let what = match cell.mean {
            None => format!("no mean: {reason}"),
            Some(_) => format!("{} of {} seeds: {reason}", cell.n, cell.n_expected),
        };
        text.text = format!("{} ({})", text.text, table.note(what));
    }
    text
}

/// `mean ± std`, or a dash.
fn cell_text(cell: &Cell, column: Column) -> Text {
    let Some(mean) = cell.mean else { return Text::plain(NONE) };
    let spread = cell.std.map(|std| format!(" ± {}", number(std, column.decimals()))).unwrap_or_default();
    Text { text: number(mean, column.decimals()) + &spread, rank: cell.rank.unwrap_or(0) }
}

/// One figure, a column per scene and their mean.
fn scene_table(group: &Group, column: Column) -> Table {
    let header = ["method".into()].into_iter().chain(group.scenes.iter().cloned()).chain(["mean".into()]).collect();
    let mut table = Table::new(format!("Protocol {}: {} per scene", group.name, column.heading()), header);
    for row in &group.rows {
        let mut cells = scene_cells(row, &group.scenes, column);
        let mean = row.headline.get(&column).map(|cell| mean_text(cell, column, &mut table));
        cells.push(mean.unwrap_or_default());
        table.rows.push(cells);
    }
    table
}

/// The figures beyond images that any run has, one table each, over the scenes that define it.
fn conditional_tables(group: &Group) -> impl Iterator<Item = Table> {
    Column::conditional().filter_map(|column| {
        let is_defined = |scene: &&String| {
            let cell = |row: &Row| row.by_scene.get(*scene)?.get(&column)?.mean;
            group.rows.iter().any(|row| cell(row).is_some())
        };
        let scenes: Vec<String> = group.scenes.iter().filter(is_defined).cloned().collect();
        let header = ["method".into()].into_iter().chain(scenes.iter().cloned()).collect();
        let better = if column.higher_is_better() { "more" } else { "less" };
        let caption = format!("Protocol {}: {} per scene ({better} is better)", group.name, column.heading());
        let mut table = Table::new(caption, header);
        table.rows = group.rows.iter().map(|row| scene_cells(row, &scenes, column)).collect();
        (!scenes.is_empty()).then_some(table)
    })
}

/// The row's name and its figure in every scene.
fn scene_cells(row: &Row, scenes: &[String], column: Column) -> Vec<Text> {
    let text = |scene: &String| {
        let cell = row.by_scene.get(scene).and_then(|cells| cells.get(&column));
        cell.map(|cell| scene_cell_text(cell, column)).unwrap_or_default()
    };
    [Text::plain(&row.name)].into_iter().chain(scenes.iter().map(text)).collect()
}

/// A figure, with `2/3` where seeds are missing; what failed stands in place of the number.
fn scene_cell_text(cell: &Cell, column: Column) -> Text {
    let mut text = cell_text(cell, column);
    if cell.mean.is_none() {
        text.text = cell.reason.clone().unwrap_or_else(|| NONE.into());
    } else if cell.n < cell.n_expected {
        text.text = format!("{} ×{}/{}", text.text, cell.n, cell.n_expected);
    }
    text
}

/// Published values in columns of their own, each with its source, protocol and verdict.
fn claim_table(claims: &ClaimTable) -> Table {
    let heading = |(i, column): (usize, &ClaimColumn)| {
        let comparable = if column.differences.is_empty() { "" } else { ", not comparable" };
        format!("published [{}]{comparable}", i + 1)
    };
    let marks = claims.columns.iter().enumerate().map(heading);
    let header = ["scene".into(), "measured".into()].into_iter().chain(marks).collect();
    let mut table = Table::new(format!("{}: PSNR (dB) beside published values", claims.row), header);
    for (i, (line, measured)) in claims.lines.iter().zip(&claims.measured).enumerate() {
        let is_mean = i + 1 == claims.lines.len();
        let ours = if is_mean { cell_text(measured, Column::PSNR) } else { scene_cell_text(measured, Column::PSNR) };
        let mut cells = vec![Text::plain(line), Text { rank: 0, ..ours }];
        cells.extend(claims.columns.iter().map(|column| Text::plain(claim_text(column, i, claims))));
        table.rows.push(cells);
    }
    table.notes = claims.columns.iter().enumerate().map(|(i, column)| claim_note(i + 1, column)).collect();
    table
}

fn claim_text(column: &ClaimColumn, line: usize, claims: &ClaimTable) -> String {
    let Some((psnr, verdict)) = &column.entries[line] else { return NONE.into() };
    let published = number(*psnr, 2);
    let set = column.claim.mean.as_ref().filter(|_| line + 1 == claims.lines.len());
    let of = set.map(|mean| format!(" (mean of {})", mean.scenes.len())).unwrap_or_default();
    let judged = match verdict {
        Verdict::Reproduced { delta_db } => format!(", reproduced ({})", signed(*delta_db, 2)),
        Verdict::Below { delta_db } => format!(", measured below ({})", signed(*delta_db, 2)),
        Verdict::Above { delta_db } => format!(", measured above ({})", signed(*delta_db, 2)),
        // The column's heading says so, or the mean is visibly one over another set of scenes.
        Verdict::NotComparable => String::new(),
        Verdict::NotMeasured => ", not measured".into(),
    };
    published + &of + &judged
}

fn claim_note(number_of_source: usize, column: &ClaimColumn) -> String {
    let claim = &column.claim;
    let kind = match claim.kind {
        Kind::Quoted => "quoted",
        Kind::ReMeasured => "re-measured by others",
    };
    let mut note =
        format!("[{number_of_source}] {kind}, {} ({}): {}.", claim.source, claim.label, claim.protocol.line());
    if !column.differences.is_empty() {
        note += &format!(" Not comparable because: {}.", column.differences.join("; "));
    }
    if let Some(mean) = &claim.mean {
        let others = mean.values.named().filter(|(name, _)| *name != "PSNR").map(|(name, v)| format!("{name} {v}"));
        let others: Vec<_> = others.collect();
        if !others.is_empty() {
            note += &format!(" Also printed, mean of {}: {}.", mean.scenes.len(), others.join(", "));
        }
    }
    claim.notes.iter().fold(note, |note, remark| format!("{note} Note: {remark}."))
}

fn time_table(group: &Group) -> Option<Table> {
    let columns = Column::TIME_TO_QUALITY;
    let header = ["method · scene".into()].into_iter().chain(columns.map(Column::heading)).collect();
    let caption = format!("Protocol {}: seconds of training to 90, 95 and 99 % of the curve's last PSNR", group.name);
    let mut table = Table::new(caption, header);
    for row in &group.rows {
        for scene in &group.scenes {
            let Some(cells) = row.by_scene.get(scene) else { continue };
            if cells.get(&Column::SecsTo99).is_none_or(|cell| cell.mean.is_none()) {
                continue;
            }
            let text = |column| cells.get(&column).map(|cell| cell_text(cell, column)).unwrap_or_default();
            let name = Text::plain(format!("{} · {scene}", row.name));
            table.rows.push([name].into_iter().chain(columns.map(text)).collect());
        }
    }
    (!table.rows.is_empty()).then_some(table)
}

fn phase_table(group: &Group) -> Option<Table> {
    let measured: Vec<&Row> = group.rows.iter().filter(|row| !row.phases.is_empty()).collect();
    let names: BTreeSet<&str> = measured.iter().flat_map(|row| row.phases.keys().map(String::as_str)).collect();
    let known = PHASES.into_iter().filter(|phase| names.contains(phase));
    let phases: Vec<&str> = known.chain(names.iter().copied().filter(|name| !PHASES.contains(name))).collect();
    let header = ["method"].into_iter().chain(phases.iter().copied()).map(String::from).collect();
    let mut table =
        Table::new(format!("Protocol {}: seconds per phase of training, mean over runs", group.name), header);
    for row in measured {
        let secs = |phase: &&str| Text::plain(row.phases.get(*phase).map_or(NONE.into(), |secs| number(*secs, 1)));
        table.rows.push([Text::plain(&row.name)].into_iter().chain(phases.iter().map(secs)).collect());
    }
    (!table.rows.is_empty()).then_some(table)
}

/// Failures by kind, with the message and the job; then data that is not there.
fn failure_blocks(report: &Report) -> Vec<Block> {
    let mut blocks = Vec::new();
    if !report.failures.is_empty() {
        let header = ["kind", "job", "message"].map(String::from).into();
        let mut table = Table::new("Runs that failed", header);
        let mut failures: Vec<_> = report.failures.iter().map(|failed| &failed.failure).collect();
        failures.sort_by_key(|failure| (failure.kind, &failure.producer, &failure.message));
        failures.dedup();
        for failure in failures {
            let texts = [failure_mark(failure.kind), &failure.producer, &failure.message];
            table.rows.push(texts.map(Text::plain).into());
        }
        blocks.extend([Block::Heading("Failures".into()), Block::Table(table)]);
    }
    if !report.missing_data.is_empty() {
        let mut table = Table::new("Scenes without data on this machine", vec!["scene".into(), "message".into()]);
        let row = |(scene, message): (&String, &String)| [scene, message].map(Text::plain).into();
        table.rows = report.missing_data.iter().map(row).collect();
        blocks.extend([Block::Heading("Missing data".into()), Block::Table(table)]);
    }
    blocks
}
