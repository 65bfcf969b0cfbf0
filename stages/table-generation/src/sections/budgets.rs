//! Time to quality, and quality under deadlines.

use super::cells::{explain_marks, mean_text, scene_text, traced};
use super::content::Content;
use super::curves::curve_split;
use crate::column::Column;
use crate::distinct::distinct;
use crate::document::{Block, Table, Text};
use crate::report::{Group, Row};

/// Two tables per group that recorded curves.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let groups = content.report.groups.iter().filter(|group| group.rows.iter().any(has_curve));
    groups.flat_map(|group| [deadline_table(content, group), time_table(content, group)]).map(Block::Table).collect()
}

fn has_curve(row: &Row) -> bool {
    row.by_scene.values().any(|cells| cells.get(&Column::PsnrAtEnd).is_some_and(|cell| cell.mean.is_some()))
}

/// PSNR under deadlines, means over scenes.
fn deadline_table(content: &Content<'_>, group: &Group) -> Table {
    let columns = Column::BUDGETS;
    let header =
        ["method".into()].into_iter().chain(columns.map(Column::heading)).chain([Column::TrainingSecs.heading()]);
    let caption = format!("Protocol {}: PSNR of the curves under deadlines, means over scenes", group.name);
    let mut table = Table::new(caption, header.collect());
    for row in group.rows.iter().filter(|row| has_curve(row)) {
        let mut cells = vec![Text::plain(&row.name)];
        for column in columns.into_iter().chain([Column::TrainingSecs]) {
            let text = mean_text(&row.headline, column, &mut table);
            cells.push(traced(text, content.traces.row(&row.name)));
        }
        table.rows.push(cells);
    }
    let views = distinct(group.scenes.iter().map(|scene| curve_split(content.report, group, scene)));
    table.remarks.push(format!(
        "Measured on {} views. \"not yet\": no evaluation before the deadline. A training that ends before the deadline \
         keeps its last value.",
        views.join(" and ")
    ));
    explain_marks(&mut table);
    table
}

/// Seconds to shares of the run's last PSNR and to fixed values, scene by scene.
fn time_table(content: &Content<'_>, group: &Group) -> Table {
    let columns = || Column::TIME_TO_SHARE.into_iter().chain(Column::TIME_TO_DB).chain([Column::TrainingSecs]);
    let header = ["method · scene".into()].into_iter().chain(columns().map(Column::heading)).collect();
    let caption = format!("Protocol {}: seconds of training until the curve reaches a PSNR", group.name);
    let mut table = Table::new(caption, header);
    for row in &group.rows {
        for scene in &group.scenes {
            let Some(cells) = row.by_scene.get(scene) else { continue };
            if cells.get(&Column::SecsTo99).is_none_or(|cell| cell.mean.is_none()) {
                continue;
            }
            let text = |column| {
                let text = cells.get(&column).map(|cell| scene_text(cell, column)).unwrap_or_default();
                traced(text, content.traces.scene(&row.name, scene))
            };
            let name = Text::plain(format!("{} · {scene}", row.name));
            table.rows.push([name].into_iter().chain(columns().map(text)).collect());
        }
    }
    table.remarks.push(
        "Percentages refer to the last value of the run's own curve, in dB. A mean without the seeds that never reached \
         the quality has no rank."
            .into(),
    );
    explain_marks(&mut table);
    table
}
