//! Links from numbers to their jobs, i.e. to rows of the table of runs.

use std::borrow::Cow;
use std::collections::BTreeMap;

use engine::count;

use crate::collect::Run;
use crate::distinct::distinct;
use crate::document::Link;
use crate::params::TableGenerationParams;
use crate::report::Report;

/// Link targets in the table of runs.
pub(crate) struct Traces {
    by_row: BTreeMap<String, Link>,
    by_scene: BTreeMap<(String, String), Link>,
}

impl Traces {
    /// Creates targets for every row and for each of its scenes.
    pub(crate) fn new(report: &Report, params: &TableGenerationParams) -> Self {
        let (mut by_row, mut by_scene) = (BTreeMap::new(), BTreeMap::new());
        let rows = distinct(report.runs.iter().map(|run| run.row.as_str()));
        let scenes = distinct(report.runs.iter().map(|run| run.scene.as_str()));
        for (r, row) in rows.iter().enumerate() {
            let n_runs = report.runs.iter().filter(|run| run.row == *row).count();
            by_row
                .insert(row.clone(), Link { to: format!("run-{r}"), hint: format!("{row}: {}", count(n_runs, "run")) });
            for (s, scene) in scenes.iter().enumerate() {
                let first = report.runs.iter().find(|run| run.row == *row && run.scene == *scene);
                let link = first.map(|run| Link { to: format!("run-{r}-{s}"), hint: hint(run, params) });
                by_scene.extend(link.map(|link| ((row.clone(), scene.clone()), link)));
            }
        }
        Self { by_row, by_scene }
    }

    /// Link to the first run of a row.
    pub(crate) fn row(&self, row: &str) -> Option<Link> {
        self.by_row.get(row).cloned()
    }

    /// Link to the first run of a row on a scene.
    pub(crate) fn scene(&self, row: &str, scene: &str) -> Option<Link> {
        self.by_scene.get(&(row.to_owned(), scene.to_owned())).cloned()
    }
}

/// Tooltip of a link: job, key and command.
fn hint(run: &Run, params: &TableGenerationParams) -> String {
    let job = last_job(run);
    let key = run.jobs.get(job.0).map(|job| job.key.as_str()).unwrap_or_default();
    format!("{} · key {key} · {}", job.1, command(run, params))
}

/// The command that reproduces the run: the recipe with the arguments of this report's command line.
pub(crate) fn command(run: &Run, params: &TableGenerationParams) -> String {
    let arguments = params.arguments.iter().map(|argument| format!(" {}", quoted(argument)));
    format!(
        "pipeline run {}{} --only {}",
        quoted(&params.recipe),
        arguments.collect::<String>(),
        quoted(last_job(run).1)
    )
}

/// Quotes an argument for a POSIX shell if necessary.
fn quoted(argument: &str) -> Cow<'_, str> {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,+@%".contains(c);
    match !argument.is_empty() && argument.chars().all(is_plain) {
        true => argument.into(),
        false => format!("'{}'", argument.replace('\'', r"'\''")).into(),
    }
}

/// Port and name of the run's last job.
fn last_job(run: &Run) -> (&str, &str) {
    let job = |port: &'static str| Some((port, run.jobs.get(port)?.name.as_str()));
    ["metrics", "renders", "model"].into_iter().find_map(job).unwrap_or_default()
}
