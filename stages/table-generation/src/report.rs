//! The report's content: runs grouped by protocol, aggregated and ranked. Typesetting lies elsewhere.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::ensure;
use engine::FailureKind;
use scene::Protocol;
use serde::{Deserialize, Serialize};

use crate::claims::{Claim, ClaimTable};
use crate::collect::costs::Costs;
use crate::collect::{Run, RunFailure};
use crate::grouping::groups;
use crate::{Column, TableGenerationParams};

/// Everything that the report says, unrounded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The title.
    pub title: String,
    /// One per protocol; numbers of different groups never share a column.
    pub groups: Vec<Group>,
    /// Failures other than missing data.
    pub failures: Vec<FailedRun>,
    /// Scenes whose data is not on this machine, with the reason.
    pub missing_data: BTreeMap<String, String>,
    /// Every run, in the order of the recipe.
    pub runs: Vec<Run>,
}

/// Figures by column.
pub type Cells = BTreeMap<Column, Cell>;

/// Runs that may be compared: one protocol, one set of metric definitions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Group {
    /// `A`, `B`, … in order of appearance.
    pub name: String,
    /// How the images came to be.
    pub protocol: Protocol,
    /// Which images were judged, and by which definitions.
    pub judged_by: String,
    /// Machines that the times were measured on.
    pub machines: BTreeSet<String>,
    /// The scenes that every mean is over.
    pub scenes: Vec<String>,
    /// Parts of the scenes that have means of their own, because the literature has them.
    pub parts: Vec<ScenePart>,
    /// One per method (and per value of further axes).
    pub rows: Vec<Row>,
    /// Published values per row.
    pub claims: Vec<ClaimTable>,
}

/// A part of the scenes of a group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScenePart {
    /// What it is called, as `without lego`.
    pub name: String,
    /// Its scenes.
    pub scenes: Vec<String>,
}

/// One method in one group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The method, and the values of further axes.
    pub name: String,
    /// The method's id.
    pub method: String,
    /// Which variant of the method, where the recipe compares several.
    pub variant: Option<String>,
    /// Means over the scenes, ± over seeds.
    pub headline: Cells,
    /// The same over each of [`Group::parts`].
    pub parts: Vec<Cells>,
    /// Means over seeds, by scene.
    pub by_scene: BTreeMap<String, Cells>,
    /// Why the trainings are not those of the method's own settings, as `schedule at 0.25 of its length`.
    pub shortened: Option<String>,
    /// Mean seconds per phase of training over the row's runs.
    pub phases: BTreeMap<String, f64>,
    /// The same by phase, loss and what was left out.
    pub costs: Costs,
}

/// An aggregated number, or why there is none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Mean over replicates.
    pub mean: Option<f64>,
    /// Sample standard deviation over replicates; none for a single one.
    pub std: Option<f64>,
    /// The replicates that count, in the order of seeds.
    pub values: Vec<f64>,
    /// Replicates that were asked for.
    pub n_expected: usize,
    /// Why there is no number, or why some replicates do not count.
    pub reason: Option<String>,
    /// 1 for the best rounded value of the column; none where there is nothing to compare.
    pub rank: Option<usize>,
    /// Whether the spread over seeds is too large to tell this value from the best of its column.
    pub within_noise: bool,
}

/// A run that failed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FailedRun {
    /// The scene.
    pub scene: String,
    /// The table row.
    pub row: String,
    /// The seed.
    pub seed: String,
    /// What went wrong.
    pub failure: RunFailure,
}

impl Report {
    /// Groups `runs` by protocol and metric definitions, aggregates them, and finds what was published about them.
    pub fn new(runs: Vec<Run>, claims: &[Claim], params: &TableGenerationParams) -> Self {
        let missing_data = runs
            .iter()
            .filter(|run| run.misses_data())
            .filter_map(|run| run.failure.as_ref().map(|failure| (run.scene.clone(), failure.message.clone())));
        let failed = runs.iter().filter(|run| !run.misses_data()).filter_map(|run| {
            let (scene, row, seed) = (run.scene.clone(), run.row.clone(), run.seed.clone());
            run.failure.clone().map(|failure| FailedRun { scene, row, seed, failure })
        });
        let present: Vec<&Run> = runs.iter().filter(|run| !run.misses_data()).collect();
        Self {
            title: params.title.clone(),
            groups: groups(&present, claims, params),
            failures: failed.collect(),
            missing_data: missing_data.collect(),
            runs,
        }
    }

    /// Whatever is not finite must not have come this far, and every group must keep to one protocol.
    pub fn check(&self) -> anyhow::Result<()> {
        ensure!(!self.runs.is_empty(), "report about no run");
        for group in &self.groups {
            ensure!(!group.rows.is_empty() && !group.scenes.is_empty(), "group {} is empty", group.name);
            for row in &group.rows {
                row.check().map_err(|error| error.context(format!("group {}, {}", group.name, row.name)))?;
            }
        }
        let lines: BTreeSet<_> = self.groups.iter().map(|group| (group.protocol.line(), &group.judged_by)).collect();
        ensure!(lines.len() == self.groups.len(), "two groups have the same protocol");
        Ok(())
    }

    /// The group that a run was measured in; none where it was not measured.
    pub fn group_of(&self, run: &Run) -> Option<&Group> {
        self.groups.iter().find(|group| group.holds(run))
    }
}

impl Group {
    /// Whether the run was measured under this group's protocol and metric definitions.
    pub fn holds(&self, run: &Run) -> bool {
        run.protocol.as_ref() == Some(&self.protocol) && run.judged_by.as_ref() == Some(&self.judged_by)
    }

    /// `Protocol A`, and nothing where there is only one in the report.
    pub fn label(&self, report: &Report) -> String {
        if report.groups.len() > 1 { format!("protocol {}", self.name) } else { String::new() }
    }
}

impl Row {
    fn check(&self) -> anyhow::Result<()> {
        let all = [&self.headline].into_iter().chain(&self.parts).chain(self.by_scene.values());
        for (column, cell) in all.flatten() {
            let finite = cell.mean.iter().chain(&cell.std).chain(&cell.values).all(|value| value.is_finite());
            ensure!(finite, "{} is not finite", column.key());
            ensure!(cell.mean.is_some() || cell.reason.is_some(), "{} is missing without a reason", column.key());
        }
        ensure!(
            self.costs.is_finite() && self.phases.values().all(|secs| secs.is_finite()),
            "a phase of training is not finite"
        );
        Ok(())
    }
}

impl Cell {
    /// Replicates that count.
    pub fn n(&self) -> usize {
        self.values.len()
    }
}

impl Run {
    /// Whether the run has no numbers because its data is not on this machine.
    pub fn misses_data(&self) -> bool {
        self.failure.as_ref().is_some_and(|failure| failure.kind == FailureKind::MissingData)
    }
}

/// What stands in a cell instead of a number, by kind of failure.
pub fn failure_mark(kind: FailureKind) -> &'static str {
    match kind {
        FailureKind::MissingData => "no data",
        FailureKind::BadInput => "bad input",
        FailureKind::Diverged => "diverged",
        FailureKind::OutOfMemory => "OOM",
        FailureKind::Timeout => "timeout",
        FailureKind::Interrupted => "stopped",
        FailureKind::DeviceLost => "device lost",
        FailureKind::World => "machine",
        FailureKind::Crashed => "crash",
    }
}
