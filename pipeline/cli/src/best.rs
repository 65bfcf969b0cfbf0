//! The best rows of a run's tables, printed at its end.

use engine::scheduler::RunSummary;
use metric_evaluation::Metric;
use table_generation::{Column, number};

use crate::measured::{self, Group};
use crate::session::Session;

/// The columns for which the end of a run names the best row.
const COLUMNS: [Column; 4] =
    [Column::PSNR, Column::Metric(Metric::Ssim), Column::Metric(Metric::LpipsAlex), Column::TrainingSecs];

/// One line per protocol and column of [`COLUMNS`] in which the table ranks rows, e.g. `best PSNR (dB): 24.61 (mcgs, mean
/// of 2 scenes)`.
pub(crate) fn lines(session: &Session, summary: &RunSummary) -> Vec<String> {
    // A report that cannot be read has no best rows; `pipeline table` prints the reason.
    let groups = measured::of_run(session, summary).unwrap_or_default().groups;
    of_groups(&groups)
}

fn of_groups(groups: &[Group]) -> Vec<String> {
    let label = |group: &Group| if groups.len() > 1 { format!(", protocol {}", group.name) } else { String::new() };
    groups
        .iter()
        .flat_map(|group| COLUMNS.into_iter().filter_map(|column| line(group, &label(group), column)))
        .collect()
}

fn line(group: &Group, label: &str, column: Column) -> Option<String> {
    let cells = group.rows.iter().filter_map(|row| Some((row.name.as_str(), row.headline.get(&column)?)));
    let best: Vec<_> = cells.filter(|(_, cell)| cell.rank == Some(1)).collect();
    let value = number(best.first()?.1.mean?, column.decimals());
    let names: Vec<&str> = best.iter().map(|(name, _)| *name).collect();
    let over = match group.scenes.len() {
        1 => String::new(),
        scenes => format!(", mean of {scenes} scenes"),
    };
    Some(format!("best {}: {value} ({}{over}{label})", column.heading(), names.join(", ")))
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_best_rows_are_those_that_the_table_ranks_first() {
        let cell = |mean: f64, rank: Option<usize>| json!({ "mean": mean, "rank": rank });
        let row = |name: &str, psnr: f64, rank: Option<usize>, secs: f64| json!({ "name": name, "headline": { "psnr": cell(psnr, rank), "training_secs": cell(secs, Some(1)) } });
        let groups = json!([
            { "name": "A", "scenes": ["a", "b"], "rows": [row("m", 20.0, Some(2), 7.0), row("n", 21.0, Some(1), 7.0)] },
            { "name": "B", "scenes": ["c"], "rows": [row("m", 30.0, None, 8.0)] },
        ]);
        let groups: Vec<Group> = serde_json::from_value(groups).unwrap();
        let expected = [
            "best PSNR (dB): 21.00 (n, mean of 2 scenes, protocol A)",
            "best training (s): 7.0 (m, n, mean of 2 scenes, protocol A)",
            "best training (s): 8.0 (m, protocol B)",
        ];
        assert_eq!(of_groups(&groups), expected);
        assert_eq!(of_groups(&groups[..1])[0], "best PSNR (dB): 21.00 (n, mean of 2 scenes)");
    }
}
