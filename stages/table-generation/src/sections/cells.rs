//! How aggregated figures look in tables.

use super::Content;
use crate::Column;
use crate::document::{Link, Table, Text};
use crate::format::{NONE, number};
use crate::report::{Cell, Cells, Row};

/// Stands behind a value that the spread over seeds does not tell from the best of its column.
const NOISE_MARK: &str = "≈";

/// `mean ± std`, or a dash.
pub fn cell_text(cell: &Cell, column: Column) -> Text {
    let Some(mean) = cell.mean else { return Text::plain(NONE) };
    let spread = cell.std.map(|std| format!(" ± {}", number(std, column.decimals()))).unwrap_or_default();
    let noise = if cell.within_noise { format!(" {NOISE_MARK}") } else { String::new() };
    let text = number(mean, column.decimals()) + &spread + &noise;
    Text { text, rank: cell.rank.unwrap_or(0), ..Text::default() }
}

/// A mean over scenes: none where a scene is missing; the reason goes to a footnote.
pub fn mean_text(cells: &Cells, column: Column, table: &mut Table) -> Text {
    let Some(cell) = cells.get(&column) else { return Text::default() };
    let mut text = cell_text(cell, column);
    if let Some(reason) = &cell.reason {
        let what = match cell.mean {
            None => format!("no mean: {reason}"),
            Some(_) => format!("{} of {} seeds: {reason}", cell.n(), cell.n_expected),
        };
        text.text = format!("{} ({})", text.text, table.note(what));
    }
    text
}

/// A figure of one scene, with `2/3` where seeds are missing; what failed stands in place of the number.
pub fn scene_text(cell: &Cell, column: Column) -> Text {
    let mut text = cell_text(cell, column);
    if cell.mean.is_none() {
        text.text = cell.reason.clone().unwrap_or_else(|| NONE.into());
    } else if cell.n() < cell.n_expected {
        text.text = format!("{} ×{}/{}", text.text, cell.n(), cell.n_expected);
    }
    text
}

/// The row's name and its figure in every scene, each leading to its runs.
pub fn scene_cells(content: &Content<'_>, row: &Row, scenes: &[String], column: Column) -> Vec<Text> {
    let text = |scene: &String| {
        let cell = row.by_scene.get(scene).and_then(|cells| cells.get(&column));
        let text = cell.map(|cell| scene_text(cell, column)).unwrap_or_default();
        text.linked(content.traces.scene(&row.name, scene))
    };
    [Text::plain(&row.name)].into_iter().chain(scenes.iter().map(text)).collect()
}

/// Explains the marks that the cells of the table have.
pub fn explain_marks<'a>(table: &mut Table, cells: impl Iterator<Item = &'a Cell> + Clone) {
    if cells.clone().any(|cell| cell.std.is_some()) {
        table.remarks.push("± is the sample standard deviation over seeds of the mean over scenes.".into());
    }
    if cells.clone().any(|cell| cell.within_noise) {
        table.remarks.push(format!(
            "{NOISE_MARK} within noise: the 95 % interval (Welch) of the difference to the best of the column holds 0."
        ));
    }
}

/// The text with its link, unless there is no number to trace.
pub fn traced(text: Text, link: Option<Link>) -> Text {
    if text.text == NONE { text } else { text.linked(link) }
}
