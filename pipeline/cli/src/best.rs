//! The best rows of a run's tables, printed at its end.

use std::collections::BTreeMap;

use engine::scheduler::RunSummary;
use metric_evaluation::Metric;
use table_generation::{Column, Run, number};

use crate::measured;
use crate::session::Session;

/// The columns for which the end of a run names the best row.
const COLUMNS: [Column; 4] =
    [Column::PSNR, Column::Metric(Metric::Ssim), Column::Metric(Metric::LpipsAlex), Column::TrainingSecs];

/// One line per column of [`COLUMNS`] that at least two rows have, e.g. `best PSNR (dB): mcgs 24.61 (mean of 2 scenes)`.
pub(crate) fn lines(session: &Session, summary: &RunSummary) -> Vec<String> {
    let mut lines = Vec::new();
    for index in session.reports() {
        let result = summary.results.get(&session.plan.nodes[index].name);
        let Some(content) = result.and_then(|result| result.content) else { continue };
        // A report that cannot be read has no best rows; `pipeline table` prints the reason.
        let runs = session.store.view(&content).ok().and_then(|dir| measured::read_report(&dir).ok());
        lines.extend(runs.iter().flat_map(|runs| COLUMNS.iter().filter_map(|column| line(runs, *column))));
    }
    lines
}

fn line(runs: &[Run], column: Column) -> Option<String> {
    let mut rows: BTreeMap<&str, BTreeMap<&str, Vec<f64>>> = BTreeMap::new();
    for run in runs {
        if let Ok(value) = measured::value(run, column) {
            rows.entry(&run.row).or_default().entry(&run.scene).or_default().push(value);
        }
    }
    let scenes = rows.values().map(BTreeMap::len).max()?;
    // A row without all scenes may have only the easy ones.
    let complete: Vec<(&str, f64)> = rows
        .iter()
        .filter(|(_, of_scene)| of_scene.len() == scenes)
        .map(|(row, of_scene)| (*row, mean(of_scene.values().map(|values| mean(values.iter().copied())))))
        .collect();
    let is_better = |a: f64, b: f64| if column.higher_is_better() { a > b } else { a < b };
    let best = complete.iter().copied().reduce(|best, row| if is_better(row.1, best.1) { row } else { best })?;
    if complete.len() < 2 {
        return None;
    }
    let over = if scenes > 1 { format!(", mean of {scenes} scenes") } else { String::new() };
    let value = number(best.1, column.decimals());
    Some(format!("best {}: {value} ({}{over})", column.heading(), best.0))
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0.0, 0.0), |(count, sum), value| (count + 1.0, sum + value));
    sum / count
}
