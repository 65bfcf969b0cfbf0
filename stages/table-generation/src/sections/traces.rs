//! From a number to the jobs that it comes from: places in the table of runs.

use std::borrow::Cow;
use std::collections::BTreeMap;

use crate::collect::Run;
use crate::document::Link;
use crate::grouping::distinct;
use crate::{Report, TableGenerationParams};

/// Places in the table of runs.
pub struct Traces {
    by_row: BTreeMap<String, Link>,
    by_scene: BTreeMap<(String, String), Link>,
}

impl Traces {
    /// Places for every row and every scene of it.
    pub fn new(report: &Report, params: &TableGenerationParams) -> Self {
        let (mut by_row, mut by_scene) = (BTreeMap::new(), BTreeMap::new());
        let rows = distinct(report.runs.iter().map(|run| run.row.as_str()));
        let scenes = distinct(report.runs.iter().map(|run| run.scene.as_str()));
        for (r, row) in rows.iter().enumerate() {
            let n_runs = report.runs.iter().filter(|run| run.row == *row).count();
            let plural = if n_runs == 1 { "" } else { "s" };
            by_row.insert(row.clone(), Link { to: format!("run-{r}"), hint: format!("{row}: {n_runs} run{plural}") });
            for (s, scene) in scenes.iter().enumerate() {
                let first = report.runs.iter().find(|run| run.row == *row && run.scene == *scene);
                let link = first.map(|run| Link { to: format!("run-{r}-{s}"), hint: hint(run, params) });
                by_scene.extend(link.map(|link| ((row.clone(), scene.clone()), link)));
            }
        }
        Self { by_row, by_scene }
    }

    /// Where all runs of a row begin.
    pub fn row(&self, row: &str) -> Option<Link> {
        self.by_row.get(row).cloned()
    }

    /// Where the runs of a row on a scene begin.
    pub fn scene(&self, row: &str, scene: &str) -> Option<Link> {
        self.by_scene.get(&(row.to_owned(), scene.to_owned())).cloned()
    }
}

/// The job, its key and the command that makes it.
fn hint(run: &Run, params: &TableGenerationParams) -> String {
    let job = last_job(run);
    let key = run.jobs.get(job.0).map(|job| job.key.as_str()).unwrap_or_default();
    format!("{} · key {key} · {}", job.1, command(run, params))
}

/// The command that makes the run, with all that it needs: the recipe with what this report's command line changed in it.
pub fn command(run: &Run, params: &TableGenerationParams) -> String {
    let arguments = params.arguments.iter().map(|argument| format!(" {}", quoted(argument)));
    format!(
        "pipeline run {}{} --only {}",
        quoted(&params.recipe),
        arguments.collect::<String>(),
        quoted(last_job(run).1)
    )
}

/// An argument as a shell takes it for itself.
fn quoted(argument: &str) -> Cow<'_, str> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,+@%".contains(c);
    match !argument.is_empty() && argument.chars().all(is_plain) {
        true => argument.into(),
        false => format!("'{}'", argument.replace('\'', r"'\''")).into(),
    }
}

/// Port and name of the last job of the run.
fn last_job(run: &Run) -> (&str, &str) {
    let job = |port: &'static str| Some((port, run.jobs.get(port)?.name.as_str()));
    ["metrics", "renders", "model"].into_iter().find_map(job).unwrap_or_default()
}
