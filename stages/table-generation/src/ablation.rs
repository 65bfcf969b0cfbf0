//! What each effect is worth: variants of one method against the first of them, in quality and in time.

use crate::Column;
use crate::document::{Table, Text};
use crate::format::{NONE, number, signed};
use crate::report::{Group, Row};

/// The axis whose values are variants of a method; the first value that a recipe lists is what others are compared with.
pub const AXIS: &str = "ablation";

/// One table per method with variants: PSNR and seconds of each, and their differences to the first.
pub fn ablation_tables(group: &Group) -> Vec<Table> {
    let mut methods: Vec<&str> = Vec::new();
    for row in group.rows.iter().filter(|row| row.variant.is_some()) {
        if !methods.contains(&row.method.as_str()) {
            methods.push(&row.method);
        }
    }
    methods.into_iter().filter_map(|method| ablation_table(group, method)).collect()
}

fn ablation_table(group: &Group, method: &str) -> Option<Table> {
    let rows: Vec<&Row> = group.rows.iter().filter(|row| row.method == method && row.variant.is_some()).collect();
    let [reference, _, ..] = rows[..] else { return None };
    let first = reference.variant.as_deref().unwrap_or_default();
    let caption = format!("Protocol {}: ablation of {method}, differences to {first}", group.name);
    let header = ["variant", "PSNR (dB)", "Δ dB", "training (s)", "Δ s", "iteration (ms)", "Δ ms"];
    let mut table = Table::new(caption, header.map(String::from).into());
    for row in rows {
        let mut cells = vec![Text::plain(row.variant.as_deref().unwrap_or_default())];
        for column in [Column::PSNR, Column::TrainingSecs, Column::MsPerIteration] {
            let value = |row: &Row| row.headline.get(&column).and_then(|cell| cell.mean);
            let difference = value(row).zip(value(reference)).map(|(mine, base)| mine - base);
            let decimals = column.decimals();
            cells.push(Text::plain(value(row).map_or(NONE.into(), |value| number(value, decimals))));
            cells.push(Text::plain(difference.map_or(NONE.into(), |value| signed(value, decimals))));
        }
        table.rows.push(cells);
    }
    Some(table)
}
