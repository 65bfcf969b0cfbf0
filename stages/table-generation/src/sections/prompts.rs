//! Prompt IoU of every prompt, next to that of answers that need no model.

use std::collections::BTreeSet;

use metric_evaluation::{Metric, TrivialOverlap};

use super::cells::{explain_marks, scene_text, traced};
use super::content::Content;
use crate::cell::Cell;
use crate::collect::Run;
use crate::column::Column;
use crate::distinct::distinct;
use crate::document::{Table, Text};
use crate::format::{NONE, number};
use crate::report::Group;
use crate::statistics::{mean, sample_std};

const COLUMN: Column = Column::Metric(Metric::PromptIou);

/// One line per scene and prompt, one column per table row; none without prompts.
pub(crate) fn table(content: &Content<'_>, group: &Group) -> Option<Table> {
    let is_judged = |run: &&Run| group.holds(run) && run.degenerate.is_none() && !run.prompts.is_empty();
    let runs: Vec<&Run> = content.report.runs.iter().filter(is_judged).collect();
    let rows = distinct(runs.iter().map(|run| run.row.as_str()));
    let header = ["scene", "prompt"].into_iter().chain(rows.iter().map(String::as_str));
    let header = header.chain(["best constant answer", "spatial prior"]).map(String::from).collect();
    let caption = format!("Protocol {}: prompt IoU per prompt (higher is better)", group.name);
    let mut table = Table::new(caption, header).with_text_columns(2);
    for scene in &group.scenes {
        let here: Vec<&Run> = runs.iter().copied().filter(|run| run.scene == *scene).collect();
        let prompts = here.iter().flat_map(|run| &run.prompts).filter(|(_, score)| score.value().is_some());
        let prompts: BTreeSet<&String> = prompts.map(|(prompt, _)| prompt).collect();
        table.rows.extend(prompts.into_iter().map(|prompt| line(content, group, [scene, prompt], &rows, &here)));
    }
    explain_marks(&mut table);
    (!table.rows.is_empty()).then_some(table)
}

/// The mean over seeds of each row, and the trivial answers, which are equal for all models with the same prompts.
fn line(
    content: &Content<'_>,
    group: &Group,
    [scene, prompt]: [&String; 2],
    rows: &[String],
    runs: &[&Run],
) -> Vec<Text> {
    let of_row = |row: &String| {
        let own = runs.iter().filter(|run| run.row == *row);
        let values: Vec<f64> = own.filter_map(|run| run.prompts.get(prompt)?.value()).collect();
        let of_scene = group.rows.iter().find(|other| other.name == *row).and_then(|row| row.by_scene.get(scene));
        let n_expected = of_scene.and_then(|cells| cells.get(&Column::PSNR)).map_or(0, |cell| cell.n_expected);
        let cell = Cell { mean: mean(&values), std: sample_std(&values), values, n_expected, ..Cell::default() };
        traced(scene_text(&cell, COLUMN), content.traces.scene(row, scene))
    };
    let trivial = runs.iter().find_map(|run| run.trivial_prompts.get(prompt));
    let of_trivial = |value: fn(&TrivialOverlap) -> f64| {
        Text::plain(trivial.map_or(NONE.into(), |trivial| number(value(trivial), COLUMN.decimals())))
    };
    let names = [scene, prompt].map(Text::plain);
    let trivial = [of_trivial(|trivial| trivial.constant), of_trivial(|trivial| trivial.spatial_prior)];
    names.into_iter().chain(rows.iter().map(of_row)).chain(trivial).collect()
}
