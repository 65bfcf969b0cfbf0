//! The report's data: runs, and groups of them by protocol, aggregated and ranked.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::ensure;
use engine::FailureKind;
use metric_evaluation::Trivial;
use scene::Protocol;
use serde::{Deserialize, Serialize};

use crate::cell::Cells;
use crate::claims::ClaimTable;
use crate::collect::{Costs, Run, RunFailure};
use crate::difference::RowDifference;
use crate::influence::Influence;

/// All numbers of the report, unrounded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Report {
    /// The title.
    pub title: String,
    /// One group per protocol; numbers of different groups never share a column.
    pub groups: Vec<Group>,
    /// The differences in PSNR that the report shows.
    pub differences: Vec<RowDifference>,
    /// Failures other than missing data.
    pub failures: Vec<FailedRun>,
    /// Scenes whose data is not on this machine, with the reason.
    pub missing_data: BTreeMap<String, String>,
    /// All runs, in the order of the recipe.
    pub runs: Vec<Run>,
}

/// Comparable runs: they share one protocol and one set of metric definitions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Group {
    /// `A`, `B`, … in order of appearance.
    pub name: String,
    /// Origin and format of the images.
    pub protocol: Protocol,
    /// The evaluated images and the metric definitions.
    pub judged_by: String,
    /// Machines on which times were measured.
    pub machines: BTreeSet<String>,
    /// Whether each kind of work was measured on one kind of machine. Otherwise times are printed, but not compared.
    #[serde(default)]
    pub one_machine: bool,
    /// The scenes that every mean covers.
    pub scenes: Vec<String>,
    /// Subsets of the scenes for which the literature prints means.
    pub parts: Vec<ScenePart>,
    /// PSNR of images that need no model, by scene; scenes without measured runs are absent.
    #[serde(default)]
    pub trivial: BTreeMap<String, Trivial>,
    /// One row per method (and per value of further axes).
    pub rows: Vec<Row>,
    /// Published values, a table per row.
    pub claims: Vec<ClaimTable>,
}

/// A subset of the scenes of a group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ScenePart {
    /// Name, e.g. `without lego`.
    pub name: String,
    /// Scenes of the subset.
    pub scenes: Vec<String>,
}

/// One method in one group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Row {
    /// The method, and the values of further axes.
    pub name: String,
    /// The method's id.
    pub method: String,
    /// The variant of the method, where the recipe compares several.
    pub variant: Option<String>,
    /// The values of all axes but scene, method and seed and the one that defines the variant.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub axes: BTreeMap<String, String>,
    /// Means over the scenes, with the spread over seeds.
    pub headline: Cells,
    /// Means over each of [`Group::parts`], with the spread over seeds.
    pub parts: Vec<Cells>,
    /// Means over seeds, by scene.
    pub by_scene: BTreeMap<String, Cells>,
    /// Difference from the method's own schedule, e.g. `schedule scaled by 0.25`; none where there is none.
    pub shortened: Option<String>,
    /// Seconds of training by activity, mean over the row's runs.
    pub phases: BTreeMap<String, f64>,
    /// Costs by phase, by loss and by skipped work, mean over the row's runs.
    pub costs: Costs,
    /// The effects that all runs of the row simulated.
    #[serde(default)]
    pub effects: BTreeSet<String>,
    /// Those of them that stay on even if they are inert, each with the reason.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub kept_effects: BTreeMap<String, String>,
    /// The influence of every loss and effect; empty for a variant that leaves one out.
    #[serde(default)]
    pub influence: Vec<Influence>,
}

/// A run that failed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct FailedRun {
    /// The scene.
    pub scene: String,
    /// The table row.
    pub row: String,
    /// The seed.
    pub seed: String,
    /// The failure.
    pub failure: RunFailure,
}

impl Report {
    /// Fails on numbers that are not finite, on missing numbers without a reason, and on two groups with one protocol.
    pub(crate) fn check(&self) -> anyhow::Result<()> {
        ensure!(!self.runs.is_empty(), "the report has no runs");
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

    /// The group in which a run was measured; none for a run without measurements.
    pub(crate) fn group_of(&self, run: &Run) -> Option<&Group> {
        self.groups.iter().find(|group| group.holds(run))
    }
}

impl Group {
    /// Whether the run was measured under this group's protocol and metric definitions.
    pub(crate) fn holds(&self, run: &Run) -> bool {
        run.protocol.as_ref() == Some(&self.protocol) && run.judged_by.as_ref() == Some(&self.judged_by)
    }

    /// `protocol A`; empty if the report has a single group.
    pub(crate) fn label(&self, report: &Report) -> String {
        if report.groups.len() > 1 { format!("protocol {}", self.name) } else { String::new() }
    }
}

impl Row {
    /// What may distinguish the row from the method as published: its schedule, and the values of further axes.
    pub(crate) fn departures(&self) -> Vec<String> {
        let axes: Vec<String> = self.axes.iter().map(|(axis, value)| format!("{axis}={value}")).collect();
        let axes = (!axes.is_empty()).then(|| format!("settings of further axes: {}", axes.join(", ")));
        self.shortened.iter().cloned().chain(axes).collect()
    }

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

impl Run {
    /// Whether the run failed because its data is not on this machine.
    pub(crate) fn misses_data(&self) -> bool {
        self.failure.as_ref().is_some_and(|failure| failure.kind == FailureKind::MissingData)
    }
}
