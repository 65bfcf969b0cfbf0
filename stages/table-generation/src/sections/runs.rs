//! All runs with their jobs: the source of every number, and the command that reproduces it.

use super::content::Content;
use super::traces::command;
use crate::collect::Run;
use crate::distinct::distinct;
use crate::document::{Block, Table, Text};
use crate::format::{NONE, number};

/// The jobs of a run: port, and name of the column.
const JOBS: [(&str, &str); 3] = [("model", "training"), ("renders", "rendering"), ("metrics", "metrics")];

/// The port whose job's seconds are not shown.
const UNTIMED: &str = "metrics";

/// The table of runs, the target of all links from numbers.
pub(crate) fn blocks(content: &Content<'_>) -> Vec<Block> {
    let report = content.report;
    let header = ["method", "scene", "seed", "outcome"].into_iter().map(String::from);
    let columns = |(port, work): &(&str, &str)| {
        let seconds = (*port != UNTIMED).then(|| format!("{work} (s)"));
        [format!("{work}: key")].into_iter().chain(seconds).collect::<Vec<_>>()
    };
    let header = header.chain(JOBS.iter().flat_map(columns)).collect();
    let mut table = Table::new("Runs, their jobs, and the commands that reproduce them", header).with_text_columns(4);
    for row in distinct(report.runs.iter().map(|run| run.row.as_str())) {
        let mut place = content.traces.row(&row).map(|link| link.to);
        for scene in distinct(report.runs.iter().map(|run| run.scene.as_str())) {
            let mut scene_place = content.traces.scene(&row, &scene).map(|link| link.to);
            for run in report.runs.iter().filter(|run| run.row == row && run.scene == scene) {
                let first = Text { id: place.take(), ..Text::plain(&run.row) };
                let second = Text { id: scene_place.take(), ..Text::plain(&run.scene) };
                table.rows.push([first, second].into_iter().chain(details(run)).collect());
                table.rows.push(vec![Text::code(command(run, content.params))]);
            }
        }
    }
    table.remarks.push(
        "Seconds are those of the whole job, including loading and evaluation. `pipeline show RECIPE JOB` prints a \
         job's folder, parameters and full key. A command also runs the jobs that the run depends on, unless their \
         results are in the store. `DATA` stands for the data root; add the `--store` of the run, if it had one."
            .into(),
    );
    vec![Block::Table(table)]
}

fn details(run: &Run) -> Vec<Text> {
    let mut texts = vec![Text::plain(&run.seed), Text::plain(run.outcome())];
    for (port, _) in JOBS {
        let job = run.jobs.get(port);
        let key = job.map(|job| job.key.as_str()).filter(|key| !key.is_empty()).unwrap_or(NONE);
        let secs = job.and_then(|job| job.wall_secs).map_or(NONE.into(), |secs| number(secs, 1));
        texts.extend([Text::code(key)].into_iter().chain((port != UNTIMED).then(|| Text::plain(secs))));
    }
    texts
}
