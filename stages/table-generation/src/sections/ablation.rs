//! Ablations: variants of one method compared with the first variant, in quality and in time.

use super::cells::traced;
use super::content::Content;
use crate::cell::Cell;
use crate::column::Column;
use crate::document::{Block, Table, Text};
use crate::format::{NONE, number, signed};
use crate::grouping::distinct;
use crate::report::{Group, Row};
use crate::statistics::welch_half_width;

/// One table per method with several variants.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let tables = content.report.groups.iter().flat_map(|group| {
        let variants = group.rows.iter().filter(|row| row.variant.is_some());
        let methods = distinct(variants.map(|row| row.method.as_str()));
        methods.into_iter().filter_map(move |method| ablation_table(content, group, &method)).collect::<Vec<_>>()
    });
    tables.map(Block::Table).collect()
}

/// PSNR, seconds of training and milliseconds per iteration of each variant, with the differences from the first.
fn ablation_table(content: &Content<'_>, group: &Group, method: &str) -> Option<Table> {
    let rows: Vec<&Row> = group.rows.iter().filter(|row| row.method == method && row.variant.is_some()).collect();
    let [reference, _, ..] = rows[..] else { return None };
    let first = reference.variant.as_deref().unwrap_or_default();
    let caption = format!("Protocol {}: ablation of {method}, differences from {first}", group.name);
    let header =
        ["variant", "PSNR (dB)", "Δ dB", "training (s)", "Δ s", "iteration (ms)", "Δ ms", "dB per extra minute"];
    let mut table = Table::new(caption, header.map(String::from).into());
    for row in rows {
        let mut cells = vec![Text::plain(row.variant.as_deref().unwrap_or_default())];
        for column in [Column::PSNR, Column::TrainingSecs, Column::MsPerIteration] {
            let decimals = column.decimals();
            let text = Text::plain(mean(row, column).map_or(NONE.into(), |value| number(value, decimals)));
            let difference = Text::plain(difference_text(row, reference, column));
            cells.extend([text, difference].map(|text| traced(text, content.traces.row(&row.name))));
        }
        cells.push(traced(Text::plain(worth(row, reference)), content.traces.row(&row.name)));
        table.rows.push(cells);
    }
    if table.rows.iter().any(|row| row.iter().any(|cell| cell.text.contains('±'))) {
        table.remarks.push("± of a difference is half the width of its 95 % interval over seeds (Welch).".into());
    }
    Some(table)
}

fn mean(row: &Row, column: Column) -> Option<f64> {
    row.headline.get(&column)?.mean
}

/// The difference from the reference, with half the width of its interval for several seeds.
fn difference_text(row: &Row, reference: &Row, column: Column) -> String {
    let Some(difference) = mean(row, column).zip(mean(reference, column)).map(|(mine, base)| mine - base) else {
        return NONE.into();
    };
    let spread = |row: &Row| row.headline.get(&column).and_then(|cell: &Cell| Some((cell.std?, cell.n())));
    let interval = spread(row).zip(spread(reference)).and_then(|(mine, base)| welch_half_width(mine, base));
    let interval = interval.filter(|_| row.name != reference.name);
    let text = signed(difference, column.decimals());
    interval.map_or(text.clone(), |width| format!("{text} ± {}", number(width, column.decimals())))
}

/// The gain in dB per minute of additional training; a dash unless both quality and time increase.
fn worth(row: &Row, reference: &Row) -> String {
    let difference = |column| mean(row, column).zip(mean(reference, column)).map(|(mine, base)| mine - base);
    match difference(Column::PSNR).zip(difference(Column::TrainingSecs)) {
        Some((gain_db, extra_secs)) if gain_db > 0.0 && extra_secs > 0.0 => number(gain_db / (extra_secs / 60.0), 2),
        _ => NONE.into(),
    }
}
