//! The warnings of the jobs that a run executed, printed at its end. Those of cached jobs were printed when they ran.

use engine::event::{NodeResult, Outcome};
use engine::scheduler::RunSummary;
use engine::store::Lookup;
use engine::{ActionKey, Store};
use serde::Deserialize;

use crate::output::{count, names};

/// Maximum number of distinct warnings that are listed; the others are counted.
const MAX_WARNINGS: usize = 10;

/// The remarks in a stage's measurements. The log also has the warnings among them, some after the name of a source.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Remarks {
    warnings: Vec<String>,
    notices: Vec<String>,
}

/// Each warning once, with its jobs, e.g. `warning capture/mine: images are read from images_4`.
pub(crate) fn lines(store: &Store, summary: &RunSummary) -> Vec<String> {
    let executed = summary.results.iter().filter(|(_, result)| result.outcome == Outcome::Executed);
    listed(executed.map(|(name, result)| (name.as_str(), of_job(store, result))))
}

fn listed<'a>(jobs: impl Iterator<Item = (&'a str, Vec<String>)>) -> Vec<String> {
    let mut found: Vec<(String, Vec<&str>)> = Vec::new();
    for (job, warnings) in jobs {
        for warning in warnings {
            match found.iter_mut().find(|(known, _)| *known == warning) {
                Some((_, jobs)) if jobs.contains(&job) => (),
                Some((_, jobs)) => jobs.push(job),
                None => found.push((warning, vec![job])),
            }
        }
    }
    let shown = found.iter().take(MAX_WARNINGS);
    let mut lines: Vec<String> =
        shown.map(|(text, jobs)| format!("warning {}: {text}", names(jobs.iter().copied()))).collect();
    if let Some((_, jobs)) = found.get(MAX_WARNINGS) {
        let more = count(found.len() - MAX_WARNINGS, "other warning");
        lines.push(format!("… and {more}; `pipeline show RECIPE {}` and the logs of the jobs have them", jobs[0]));
    }
    lines
}

/// The warnings of a job: those that its stage measured, and the others in its log.
fn of_job(store: &Store, result: &NodeResult) -> Vec<String> {
    let Remarks { mut warnings, notices } = remarks(store, result).unwrap_or_default();
    warnings.extend(notices);
    let logged = result.log_dir.as_deref().map(engine::job::warnings).unwrap_or_default();
    let is_measured = |line: &String| warnings.iter().any(|warning| line.ends_with(warning.as_str()));
    let others: Vec<String> = logged.into_iter().filter(|line| !is_measured(line)).collect();
    warnings.extend(others);
    warnings
}

/// The remarks that the stage measured; none if the result cannot be read.
fn remarks(store: &Store, result: &NodeResult) -> Option<Remarks> {
    let key: ActionKey = serde_json::from_value(result.key.as_deref()?.into()).ok()?;
    let Lookup::Hit(record) = store.lookup(&key) else { return None };
    Remarks::deserialize(store.read_measurements(&record.measurements).ok()?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_warnings_share_a_line_and_many_are_counted() {
        let of = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect::<Vec<String>>();
        let jobs = [("layers/a", of(&["x", "x", "y"])), ("layers/b", of(&["x"])), ("train/a", of(&[]))];
        assert_eq!(listed(jobs.into_iter()), ["warning layers/a, layers/b: x", "warning layers/a: y"]);
        let many: Vec<String> = (0..13).map(|number| format!("text {number}")).collect();
        let lines = listed([("train/a", many)].into_iter());
        assert_eq!(lines.len(), 11);
        assert!(lines[10].starts_with("… and 3 other warnings; `pipeline show RECIPE train/a`"), "{lines:?}");
    }
}
