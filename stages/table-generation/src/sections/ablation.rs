//! Ablations: variants of one method compared with the first variant, in quality, in time and in size.

use metric_evaluation::Metric;

use super::cells::{MACHINES_DIFFER, traced};
use super::content::Content;
use crate::column::Column;
use crate::common_scenes;
use crate::difference::{Difference, REMARK};
use crate::document::{Block, Table, Text};
use crate::format::{NONE, number};
use crate::pairs::variants;
use crate::report::{Group, Row};

/// Metrics of which the tables have differences only: the values are among the results.
const DIFFERENCES_ONLY: [Column; 4] = {
    let [velocity, flow, prompts] = Column::TASKS;
    [velocity, flow, prompts, Column::Metric(Metric::PsnrMoving)]
};

/// The remark on intervals below tables of several scenes.
const OVER_SCENES: &str = "Each seed contributes one difference, that of its means over scenes: an interval does not contain the \
                           spread over scenes.";

/// One table per method with several variants.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let tables = content.report.groups.iter().flat_map(|group| {
        variants(group).into_iter().map(|(first, others)| Block::Table(ablation_table(content, group, first, &others)))
    });
    tables.collect()
}

/// PSNR, seconds of training, milliseconds per iteration and Gaussians of each variant, with the differences from the first,
/// and the differences in other measured metrics.
fn ablation_table(content: &Content<'_>, group: &Group, reference: &Row, others: &[&Row]) -> Table {
    let first = name(reference);
    let caption = format!("Protocol {}: ablation of {}, differences from {first}", group.name, reference.method);
    let difference_in = |row: &Row, column| common_scenes::difference(row, reference, column);
    let is_measured = |column: &Column| others.iter().any(|row| difference_in(row, *column).is_some());
    let more: Vec<Column> = DIFFERENCES_ONLY.into_iter().filter(is_measured).collect();
    let header = ["variant", "PSNR (dB)", "Δ dB", "training (s)", "Δ s", "iteration (ms)", "Δ ms", "Gaussians"];
    let header = header.into_iter().chain(["Δ Gaussians", "dB per extra minute"]).map(String::from);
    let header = header.chain(more.iter().map(|column| format!("Δ {}", column.heading())));
    let mut table = Table::new(caption, header.collect());
    for row in [&reference].into_iter().chain(others) {
        let mut cells = vec![Text::plain(name(row))];
        for column in [Column::PSNR, Column::TrainingSecs, Column::MsPerIteration, Column::Gaussians] {
            let decimals = column.decimals();
            let text = Text::plain(mean(row, column).map_or(NONE.into(), |value| number(value, decimals)));
            let is_compared = group.one_machine || !column.is_timing();
            let difference = difference(row, reference, column).filter(|_| is_compared);
            let difference = Text::plain(difference.map_or(NONE.into(), |difference| difference.text(column)));
            cells.extend([text, difference].map(|text| traced(text, content.traces.row(&row.name))));
        }
        let worth = worth(row, reference).filter(|_| group.one_machine).map_or(NONE.into(), |worth| number(worth, 2));
        cells.push(traced(Text::plain(worth), content.traces.row(&row.name)));
        cells.extend(more.iter().map(|&column| {
            let difference = difference_in(row, column).filter(|_| row.name != reference.name);
            let text = Text::plain(difference.map_or(NONE.into(), |difference| difference.text(column)));
            traced(text, content.traces.row(&row.name))
        }));
        table.rows.push(cells);
    }
    table.remarks.push(REMARK.into());
    table.remarks.extend((group.scenes.len() > 1).then(|| OVER_SCENES.to_owned()));
    let remark = || format!("{MACHINES_DIFFER}, so their differences are left out.");
    table.remarks.extend((!group.one_machine).then(remark));
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

/// The difference from the reference; none for the reference itself.
fn difference(row: &Row, reference: &Row, column: Column) -> Option<Difference> {
    Difference::of_column(&row.headline, &reference.headline, column).filter(|_| row.name != reference.name)
}

/// The gain in dB per minute of additional training, over the common seeds; none unless both quality and time increase.
fn worth(row: &Row, reference: &Row) -> Option<f64> {
    let gain_db = difference(row, reference, Column::PSNR)?.mean;
    let extra_secs = difference(row, reference, Column::TrainingSecs)?.mean;
    (gain_db > 0.0 && extra_secs > 0.0).then(|| gain_db / (extra_secs / 60.0))
}
