//! Ablations: variants of one method compared with the first variant, in quality, in time and in size.

use super::cells::traced;
use super::content::Content;
use crate::column::Column;
use crate::difference::{Difference, REMARK};
use crate::document::{Block, Table, Text};
use crate::format::{NONE, number};
use crate::pairs::variants;
use crate::report::{Group, Row};

/// One table per method with several variants.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let tables = content.report.groups.iter().flat_map(|group| {
        variants(group).into_iter().map(|(first, others)| Block::Table(ablation_table(content, group, first, &others)))
    });
    tables.collect()
}

/// PSNR, seconds of training, milliseconds per iteration and Gaussians of each variant, with the differences from the first.
fn ablation_table(content: &Content<'_>, group: &Group, reference: &Row, others: &[&Row]) -> Table {
    let first = name(reference);
    let caption = format!("Protocol {}: ablation of {}, differences from {first}", group.name, reference.method);
    let header = [
        "variant",
        "PSNR (dB)",
        "Δ dB",
        "training (s)",
        "Δ s",
        "iteration (ms)",
        "Δ ms",
        "Gaussians",
        "Δ Gaussians",
        "dB per extra minute",
    ];
    let mut table = Table::new(caption, header.map(String::from).into());
    for row in [&reference].into_iter().chain(others) {
        let mut cells = vec![Text::plain(name(row))];
        for column in [Column::PSNR, Column::TrainingSecs, Column::MsPerIteration, Column::Gaussians] {
            let decimals = column.decimals();
            let text = Text::plain(mean(row, column).map_or(NONE.into(), |value| number(value, decimals)));
            let difference = Text::plain(difference_text(row, reference, column));
            cells.extend([text, difference].map(|text| traced(text, content.traces.row(&row.name))));
        }
        cells.push(traced(Text::plain(worth(row, reference)), content.traces.row(&row.name)));
        table.rows.push(cells);
    }
    table.remarks.push(REMARK.into());
    table
}

/// The variant, with the values of further axes.
fn name(row: &Row) -> String {
    let others = row.axes.iter().map(|(axis, value)| format!("{axis}={value}"));
    row.variant.clone().into_iter().chain(others).collect::<Vec<_>>().join(" ")
}

fn mean(row: &Row, column: Column) -> Option<f64> {
    row.headline.get(&column)?.mean
}

/// The difference from the reference; a dash for the reference itself.
fn difference_text(row: &Row, reference: &Row, column: Column) -> String {
    let difference =
        Difference::of_column(&row.headline, &reference.headline, column).filter(|_| row.name != reference.name);
    difference.map_or(NONE.into(), |difference| difference.text(column))
}

/// The gain in dB per minute of additional training; a dash unless both quality and time increase.
fn worth(row: &Row, reference: &Row) -> String {
    let difference = |column| mean(row, column).zip(mean(reference, column)).map(|(mine, base)| mine - base);
    match difference(Column::PSNR).zip(difference(Column::TrainingSecs)) {
        Some((gain_db, extra_secs)) if gain_db > 0.0 && extra_secs > 0.0 => number(gain_db / (extra_secs / 60.0), 2),
        _ => NONE.into(),
    }
}
