//! Published values next to measured values, with source, protocol and verdict.

use super::cells::{cell_text, explain_marks, scene_text, traced};
use super::content::Content;
use crate::claims::{ClaimColumn, ClaimTable, Kind, Verdict};
use crate::column::Column;
use crate::document::{Block, Table, Text};
use crate::format::{NONE, number};

/// One table per measured row with published values.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let groups = content.report.groups.iter();
    groups.flat_map(|group| &group.claims).map(|claims| Block::Table(claim_table(content, claims))).collect()
}

fn claim_table(content: &Content<'_>, claims: &ClaimTable) -> Table {
    let heading = |(i, column): (usize, &ClaimColumn)| {
        let comparable = if column.differences.is_empty() { "" } else { ", not comparable" };
        format!("published [{}]{comparable}", i + 1)
    };
    let marks = claims.columns.iter().enumerate().map(heading);
    let header = ["scene".into(), "measured".into()].into_iter().chain(marks).collect();
    let mut table = Table::new(format!("{}: PSNR (dB) next to published values", claims.row), header);
    for (i, (line, measured)) in claims.lines.iter().zip(&claims.measured).enumerate() {
        let scene = content.traces.scene(&claims.row, line);
        let ours = match scene {
            Some(_) => traced(scene_text(measured, Column::PSNR), scene),
            None => traced(cell_text(measured, Column::PSNR), content.traces.row(&claims.row)),
        };
        let mut cells = vec![Text::plain(line), Text { rank: 0, ..ours }];
        cells.extend(claims.columns.iter().map(|column| Text::plain(claim_text(column, i, line))));
        table.rows.push(cells);
    }
    table.notes = claims.columns.iter().enumerate().map(|(i, column)| claim_note(i + 1, column)).collect();
    explain_marks(&mut table);
    table
}

fn claim_text(column: &ClaimColumn, line: usize, name: &str) -> String {
    let Some((psnr, verdict)) = &column.entries[line] else { return NONE.into() };
    let n_scenes = column.claim.mean.as_ref().map(|mean| mean.scenes.len());
    let own_set = name.strip_prefix("mean of ").and_then(|set| set.split(' ').next());
    let other_set = n_scenes.filter(|n| own_set.is_some_and(|own| own != n.to_string()));
    let of = other_set.map(|n| format!(" (mean of {n})")).unwrap_or_default();
    let judged = match verdict {
        // The column's heading already states this, or the mean is over another number of scenes.
        Verdict::NotComparable => String::new(),
        verdict => format!(", {}", verdict.text()),
    };
    number(*psnr, 2) + &of + &judged
}

fn claim_note(number_of_source: usize, column: &ClaimColumn) -> String {
    let claim = &column.claim;
    let mut note = format!(
        "[{number_of_source}] {}, {} ({}): {}.",
        origin(claim.kind),
        claim.source,
        claim.label,
        claim.protocol.line()
    );
    if !column.differences.is_empty() {
        note += &format!(" Not comparable: {}.", column.differences.join("; "));
    }
    if let Some(mean) = &claim.mean {
        let others = mean.values.named().filter(|(name, _)| *name != "PSNR").map(|(name, v)| format!("{name} {v}"));
        let others: Vec<_> = others.collect();
        if !others.is_empty() {
            note += &format!(" Also printed (mean of {}): {}.", mean.scenes.len(), others.join(", "));
        }
    }
    claim.notes.iter().fold(note, |note, remark| format!("{note} Note: {remark}."))
}

/// Origin of a published value in words.
pub(crate) fn origin(kind: Kind) -> &'static str {
    match kind {
        Kind::Quoted => "quoted",
        Kind::ReMeasured => "re-measured by a third party",
    }
}
