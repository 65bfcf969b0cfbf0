//! Measured runs, read from a recipe's reports or from a report file.

use std::collections::BTreeMap;
use std::path::Path;

use engine::scheduler::RunSummary;
use engine::status::State;
use engine::{Digest, Failure, FailureKind, builtin_name};
use metric_evaluation::Score;
use serde::Deserialize;
use table_generation::{Column, DEGENERATE, Job, RowDifference, Run};

use crate::args::{Conditions, RecipeArgs};
use crate::error::CliError;
use crate::session::Session;

/// The file of a report that holds everything unrounded.
const REPORT: &str = "report.json";

/// The parts of report files that verbs read.
#[derive(Default, Deserialize)]
pub(crate) struct Measured {
    /// The runs.
    pub(crate) runs: Vec<Run>,
    /// The differences that the reports are about.
    pub(crate) differences: Vec<RowDifference>,
    /// The tables, one per protocol.
    pub(crate) groups: Vec<Group>,
}

/// The table of one protocol.
#[derive(Deserialize)]
pub(crate) struct Group {
    /// The name of the protocol, e.g. `A`.
    pub(crate) name: String,
    /// The scenes that every mean covers.
    pub(crate) scenes: Vec<String>,
    /// The rows.
    pub(crate) rows: Vec<Row>,
}

/// A row of a table.
#[derive(Deserialize)]
pub(crate) struct Row {
    /// The method, and the values of further axes.
    pub(crate) name: String,
    /// The means over the scenes.
    pub(crate) headline: BTreeMap<Column, Cell>,
}

/// A mean over scenes.
#[derive(Deserialize)]
pub(crate) struct Cell {
    /// The mean; none if a scene has no value.
    pub(crate) mean: Option<f64>,
    /// The rank in the column, 1 for the best; none if there is nothing to compare.
    pub(crate) rank: Option<usize>,
}

/// The runs of `named`: a recipe (`.toml`), whose latest results under the conditions are read, or a report's folder or
/// file.
pub(crate) fn open(store: &Path, named: &Path, with: &Conditions) -> Result<Vec<Run>, CliError> {
    if builtin_name(named).is_some() || named.extension().is_some_and(|extension| extension == "toml") {
        let recipe = RecipeArgs { recipe: named.to_owned(), with: with.clone() };
        let session = Session::read_only(store, &recipe)?;
        return collect(&session, |index| Ok(session.record(index)?.content));
    }
    Ok(read(&if named.is_dir() { named.join(REPORT) } else { named.to_owned() })?.runs)
}

/// The runs of all tables of a recipe, which must be up to date.
pub(crate) fn current(session: &Session) -> Result<Vec<Run>, CliError> {
    let predictions = session.predict()?;
    collect(session, |index| match predictions.get(&index).map(|prediction| &prediction.state) {
        Some(State::Cached { record }) => Ok(record.content),
        _ => {
            let name = &session.plan.nodes[index].name;
            Err(CliError::nothing(format!("{name} is not up to date"), "run the recipe first"))
        }
    })
}

/// The runs of all tables, each once; `content` returns the artifact of a table's job.
fn collect(session: &Session, content: impl Fn(usize) -> Result<Digest, CliError>) -> Result<Vec<Run>, CliError> {
    let mut runs = Vec::new();
    for index in session.required_reports()? {
        add_new(&mut runs, stored(session, &content(index)?)?.runs);
    }
    Ok(runs)
}

/// Adds the runs that no earlier table has. A run that one has adds only the values that this table lacks, e.g. because it
/// does not read the renders.
fn add_new(all: &mut Vec<Run>, of_table: Vec<Run>) {
    let n_earlier = all.len();
    for run in of_table {
        match all[..n_earlier].iter_mut().find(|earlier| is_same(earlier, &run)) {
            Some(earlier) => {
                for (column, score) in run.figures {
                    earlier.figures.entry(column).or_insert(score);
                }
            }
            None => all.push(run),
        }
    }
}

/// Whether two tables show one run: no job of one is another job in the other.
fn is_same(run: &Run, other: &Run) -> bool {
    let is_alike = (&run.row, &run.scene, &run.seed) == (&other.row, &other.scene, &other.seed);
    let differs = |(port, job): (&String, &Job)| other.jobs.get(port).is_some_and(|theirs| theirs.name != job.name);
    is_alike && run.protocol_lines() == other.protocol_lines() && !run.jobs.iter().any(differs)
}

/// The report in an artifact of the store.
fn stored(session: &Session, content: &Digest) -> Result<Measured, CliError> {
    Ok(serde_json::from_slice(&session.store.read_file(content, REPORT)?)?)
}

/// The content of the reports that `summary` has results of.
pub(crate) fn of_run(session: &Session, summary: &RunSummary) -> Result<Measured, CliError> {
    let mut all = Measured::default();
    for index in session.reports() {
        let result = summary.results.get(&session.plan.nodes[index].name);
        if let Some(content) = result.and_then(|result| result.content) {
            let Measured { runs, differences, groups } = stored(session, &content)?;
            all.runs.extend(runs);
            all.differences.extend(differences);
            all.groups.extend(groups);
        }
    }
    Ok(all)
}

fn read(path: &Path) -> Result<Measured, CliError> {
    let bad = |message: String| {
        let hint = format!("name a recipe (.toml), a report folder, or its {REPORT}");
        CliError::of_input(Failure::new(FailureKind::BadInput, message).hint(hint).at(path).into())
    };
    let bytes = std::fs::read(path).map_err(|error| bad(format!("cannot read the report ({error})")))?;
    serde_json::from_slice(&bytes).map_err(|error| bad(format!("not a report file ({error})")))
}

/// A finite value of a run, or the reason why it has none. The values of a degenerate run are ignored.
pub(crate) fn value(run: &Run, column: Column) -> Result<f64, String> {
    if run.degenerate.is_some() {
        return Err(DEGENERATE.into());
    }
    match run.figures.get(&column) {
        Some(Score::Value(value)) if value.is_finite() => Ok(*value),
        Some(Score::Value(_)) => Err("not finite".into()),
        Some(Score::Undefined { undefined }) => Err(undefined.clone()),
        None => Err(run.failure.as_ref().map_or("not measured".into(), |failure| failure.message.clone())),
    }
}

/// A run's name: row, scene and seed.
pub(crate) fn name(run: &Run) -> String {
    format!("{} on {}, seed {}", run.row, run.scene, run.seed)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(scene: &str, port: &str, job: &str, figures: &[(Column, f64)]) -> Run {
        let figures = figures.iter().map(|(column, value)| (*column, Score::Value(*value))).collect();
        let jobs = [(port.to_owned(), Job { name: job.into(), ..Job::default() })].into();
        Run { row: "m".into(), scene: scene.into(), seed: "0".into(), figures, jobs, ..Run::default() }
    }

    #[test]
    fn runs_of_several_tables_count_once() {
        let psnr = [(Column::PSNR, 20.0)];
        let table = [run("a", "metrics", "metrics/a", &psnr), run("b", "metrics", "metrics/b", &psnr)];
        let mut all = Vec::new();
        add_new(&mut all, table.to_vec());
        add_new(&mut all, table.to_vec());
        assert_eq!(all, table);
        // Another table of the run also reads its model.
        add_new(&mut all, vec![run("a", "model", "train/a", &[(Column::Gaussians, 7.0), (Column::PSNR, 20.0)])]);
        let n_values: Vec<usize> = all.iter().map(|run| run.figures.len()).collect();
        assert_eq!(n_values, [2, 1]);
        // Another node over the same axes, e.g. of another split, makes another run.
        add_new(&mut all, vec![run("a", "metrics", "metrics-val/a", &psnr)]);
        assert_eq!(all.len(), 3);
    }
}
