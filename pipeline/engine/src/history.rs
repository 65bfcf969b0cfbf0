//! The last results of a recipe's jobs, for tables, explanations and warnings.
//!
//! The last result of a job is that of the newest run that finished it, whether the run made the result or found it in
//! the store. It is read from the events of the runs, because killed runs and the workers of shared runs write them as
//! well. Two things do not count: runs of the recipe with other options, and results that lack data which an earlier
//! result had. The links for users (`results/`) are never moved to a result that lacks such data, either.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::{Path, PathBuf};

use crate::estimate::Estimator;
use crate::event::Event;
use crate::runs::{event_files, results, run_dirs};
use crate::store::{ActionRecord, Provenance};
use crate::{DeviceClass, FailureKind, KeyComponents, Node, Plan, Store};

/// The number of runs of each kind whose events are read completely. For a job that none of them finished, the records
/// decide.
const MOST_RUNS: usize = 50;

/// The results of earlier runs, as the jobs of one plan see them.
#[derive(Default)]
pub struct History {
    /// All records of the store, oldest first.
    records: Vec<ActionRecord>,
    estimator: Estimator,
    recipe: String,
    device: DeviceClass,
    /// Node → index of the record of its last result.
    last: BTreeMap<String, usize>,
    /// Node → index of a record, for nodes that only runs on the other device or without options have finished.
    similar: BTreeMap<String, usize>,
    /// The recipe's runs with other options or on another device, by name: the newest is the last.
    others: BTreeMap<String, PastRun>,
}

impl History {
    /// Reads all records of the store, and the newest runs of the plan's recipe.
    pub fn read(store: &Store, plan: &Plan) -> anyhow::Result<Self> {
        let records = store.records()?;
        let runs = past_runs(store, plan)?;
        let mut open: BTreeMap<&str, &str> =
            plan.nodes.iter().map(|node| (node.name.as_str(), node.stage.as_str())).collect();
        let last = finished(&runs, &[Likeness::Equal], &records, &open);
        open.retain(|name, _| !last.contains_key(*name));
        let similar = finished(&runs, &[Likeness::OtherDevice, Likeness::WithoutOptions], &records, &open);
        let others = runs.into_iter().filter(|run| run.likeness != Likeness::Equal);
        let others = others.map(|run| (run.name.clone(), run)).collect();
        let estimator = Estimator::new(records.iter());
        Ok(Self { records, estimator, recipe: plan.recipe.clone(), device: plan.device, last, similar, others })
    }

    /// Predicts times from the records.
    pub fn estimator(&self) -> &Estimator {
        &self.estimator
    }

    /// The last result of a job of the plan: of this recipe with these options on this class of devices.
    pub fn last(&self, node: &Node) -> Option<&ActionRecord> {
        let of_run = self.last.get(&node.name).map(|&at| &self.records[at]);
        of_run.or_else(|| self.made(node, |by| by.device == self.device && !self.others.contains_key(&by.run)))
    }

    /// The options and devices of the newest runs that finished the job with other options or on another device than
    /// the plan's, newest first.
    pub fn other_runs<'a>(&'a self, node: &'a Node) -> impl Iterator<Item = (&'a [String], DeviceClass)> {
        let has_finished = move |run: &&PastRun| {
            let mut finished = run.events.iter().flat_map(|file| results(file));
            finished.any(|(name, _)| name == node.name)
        };
        self.others.values().rev().take(MOST_RUNS).filter(has_finished).map(|run| (run.changes.as_slice(), run.device))
    }

    /// The result that the job of the plan is compared with: its last result, or else one of the recipe with other
    /// options or on another device.
    pub fn earlier(&self, node: &Node) -> Option<&ActionRecord> {
        let similar = || self.similar.get(&node.name).map(|&at| &self.records[at]);
        self.last(node).or_else(similar).or_else(|| self.made(node, |_| true))
    }

    /// The newest result that a run of this recipe made.
    fn made(&self, node: &Node, is_wanted: impl Fn(&Provenance) -> bool) -> Option<&ActionRecord> {
        let is_same = |record: &&ActionRecord| {
            let by = &record.provenance;
            let is_job = by.recipe == self.recipe && by.node == node.name && record.components.stage == node.stage;
            is_job && is_wanted(by)
        };
        self.records.iter().rev().find(is_same)
    }
}

/// How a run relates to a plan of its recipe.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Likeness {
    /// Equal options and devices.
    Equal,
    /// Equal options, another class of devices.
    OtherDevice,
    /// No options, but the plan has some.
    WithoutOptions,
    /// Other options.
    Other,
}

/// An earlier run of the recipe.
struct PastRun {
    name: String,
    /// The events of each of its processes.
    events: Vec<PathBuf>,
    changes: Vec<String>,
    device: DeviceClass,
    likeness: Likeness,
}

/// The runs of the plan's recipe, newest first. A run without readable events has finished nothing.
fn past_runs(store: &Store, plan: &Plan) -> io::Result<Vec<PastRun>> {
    let run = |dir: &PathBuf| {
        let events = event_files(dir);
        let Event::Planned { run, recipe, changes, device, .. } = events.iter().find_map(|file| first_event(file))?
        else {
            return None;
        };
        let likeness = match (changes == plan.changes, device == plan.device) {
            (true, true) => Likeness::Equal,
            (true, false) => Likeness::OtherDevice,
            _ if changes.is_empty() => Likeness::WithoutOptions,
            _ => Likeness::Other,
        };
        (recipe == plan.recipe).then_some(PastRun { name: run, events, changes, device, likeness })
    };
    Ok(run_dirs(store)?.iter().rev().filter_map(run).collect())
}

fn first_event(file: &Path) -> Option<Event> {
    let mut line = String::new();
    BufReader::new(File::open(file).ok()?).read_line(&mut line).ok()?;
    serde_json::from_str(&line).ok()
}

/// For each node in `open` (node → stage), the index of the record of its last result in runs of these kinds. Kinds
/// that are listed first take precedence.
fn finished(
    runs: &[PastRun],
    kinds: &[Likeness],
    records: &[ActionRecord],
    open: &BTreeMap<&str, &str>,
) -> BTreeMap<String, usize> {
    let by_key: BTreeMap<&str, usize> =
        records.iter().enumerate().map(|(at, record)| (record.key.as_str(), at)).collect();
    let of_kind = |kind: Likeness| runs.iter().filter(move |run| run.likeness == kind).take(MOST_RUNS);
    let mut open = open.clone();
    // Newest first, up to a result that lacks no data.
    let mut found: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for run in kinds.iter().copied().flat_map(of_kind) {
        if open.is_empty() {
            break;
        }
        for (node, key) in run.events.iter().flat_map(|file| results(file)) {
            let (Some(stage), Some(&at)) = (open.get(node.as_str()), by_key.get(key.as_str())) else { continue };
            let components = &records[at].components;
            if components.stage != *stage {
                continue;
            }
            if !lacks_data(components) {
                open.remove(node.as_str());
            }
            found.entry(node).or_default().push(at);
        }
    }
    let best = |newest_first: Vec<usize>| {
        let oldest_first = newest_first.into_iter().rev();
        oldest_first
            .reduce(|old, new| if loses_data(&records[old].components, &records[new].components) { old } else { new })
    };
    found.into_iter().filter_map(|(node, found)| Some((node, best(found)?))).collect()
}

/// Whether a failure of this kind is due to the data or the machine, and not to a method.
pub fn is_lack_of_data(kind: FailureKind) -> bool {
    matches!(kind, FailureKind::MissingData | FailureKind::BadInput | FailureKind::World)
}

/// Whether the job of `new` lacks data and read fewer results than that of `old`, e.g. after a mistyped data folder or
/// with a damaged image. Such a result does not take the place of the old one.
pub fn loses_data(old: &KeyComponents, new: &KeyComponents) -> bool {
    let read = |components: &KeyComponents| {
        components.inputs.values().flatten().filter(|input| input.content.is_some()).count()
    };
    lacks_data(new) && read(old) > read(new)
}

/// Whether a producer of the inputs had no usable data.
fn lacks_data(components: &KeyComponents) -> bool {
    components.inputs.values().flatten().any(|input| input.failure.is_some_and(is_lack_of_data))
}
