//! Formats aggregated numbers as cells of tables.

use super::content::Content;
use crate::cell::{Cell, Cells};
use crate::column::Column;
use crate::document::{Link, Table, Text};
use crate::format::{NONE, number};
use crate::report::Row;

/// Marks a value that is not distinguishable from the best of its column.
const NOISE_MARK: &str = "≈";

/// Precedes the share of the seeds that have a value, e.g. `×2/3`.
const MISSING_MARK: &str = "×";

/// Begins the remarks of tables that compare no times because of [`crate::report::Group::one_machine`].
pub(crate) const MACHINES_DIFFER: &str = "Times were measured on several kinds of machines";

/// `mean ± std` with the mark ≈, or a dash.
pub(crate) fn cell_text(cell: &Cell, column: Column) -> Text {
    let Some(mean) = cell.mean else { return Text::plain(NONE) };
    let spread = cell.std.map(|std| format!(" ± {}", number(std, column.decimals()))).unwrap_or_default();
    let noise = if cell.within_noise { format!(" {NOISE_MARK}") } else { String::new() };
    let text = number(mean, column.decimals()) + &spread + &noise;
    Text { text, rank: cell.rank.unwrap_or(0), ..Text::default() }
}

/// A mean over scenes; the reason for missing values goes to a footnote of `table`.
pub(crate) fn mean_text(cells: &Cells, column: Column, table: &mut Table) -> Text {
    let Some(cell) = cells.get(&column) else { return Text::default() };
    let mut text = cell_text(cell, column);
    if let Some(reason) = &cell.reason {
        let what = match cell.mean {
            None => format!("no mean ({reason})"),
            Some(_) => format!("mean of {} of {} seeds ({reason})", cell.n(), cell.n_expected),
        };
        text.text = format!("{} ({})", text.text, table.note(what));
    }
    text
}

/// A value of one scene, with e.g. `×2/3` if seeds are missing; the reason replaces a missing number.
pub(crate) fn scene_text(cell: &Cell, column: Column) -> Text {
    let mut text = cell_text(cell, column);
    if cell.mean.is_none() {
        text.text = cell.reason.clone().unwrap_or_else(|| NONE.into());
    } else if cell.n() < cell.n_expected {
        text.text = format!("{} {MISSING_MARK}{}/{}", text.text, cell.n(), cell.n_expected);
    }
    text
}

/// The row's name and its value in every scene, each linked to its runs.
pub(crate) fn scene_cells(content: &Content<'_>, row: &Row, scenes: &[String], column: Column) -> Vec<Text> {
    let text = |scene: &String| {
        let cell = row.by_scene.get(scene).and_then(|cells| cells.get(&column));
        let text = cell.map(|cell| scene_text(cell, column)).unwrap_or_default();
        text.linked(content.traces.scene(&row.name, scene))
    };
    [Text::plain(&row.name)].into_iter().chain(scenes.iter().map(text)).collect()
}

/// Explains the emphasis of ranks among `n_rows` rows.
pub(crate) fn explain_ranks(table: &mut Table, n_rows: usize) {
    let others =
        if n_rows > 2 { "; the page and LaTeX underline the second and print the third in italics" } else { "" };
    table.remarks.extend((n_rows > 1).then(|| format!("Bold: the best of its column{others}.")));
}

/// Adds explanations of the marks that occur in the cells of the table. Without a third rank, only the best is emphasised.
pub(crate) fn explain_marks(table: &mut Table) {
    if table.rows.iter().flatten().all(|cell| cell.rank < 3) {
        table.rows.iter_mut().flatten().filter(|cell| cell.rank == 2).for_each(|cell| cell.rank = 0);
    }
    let marks = [
        ("±", "± is the sample standard deviation over seeds; in a mean over scenes, that of this mean."),
        (
            NOISE_MARK,
            "≈ not distinguishable from the best of the column with these seeds: the 95 % interval of the paired difference \
             contains 0.",
        ),
        (MISSING_MARK, "×m/n: mean of m of n seeds."),
    ];
    let texts = || table.rows.iter().flat_map(|row| row.iter().skip(table.n_text)).map(|cell| cell.text.as_str());
    let occurs = |mark: &str| texts().any(|text| text.split(' ').any(|word| word.starts_with(mark)));
    let remarks: Vec<String> =
        marks.into_iter().filter(|(mark, _)| occurs(mark)).map(|(_, remark)| remark.to_owned()).collect();
    table.remarks.extend(remarks);
}

/// Links the text to its runs, unless there is nothing to link.
pub(crate) fn traced(text: Text, link: Option<Link>) -> Text {
    if text.text.is_empty() || text.text == NONE { text } else { text.linked(link) }
}
