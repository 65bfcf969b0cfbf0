//! The report's content: runs grouped by protocol, aggregated and ranked. Typesetting lies elsewhere.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::ensure;
use engine::FailureKind;
use metric_evaluation::Score;
use scene::Protocol;
use serde::{Deserialize, Serialize};

use crate::claims::{Claim, ClaimTable};
use crate::collect::{Run, RunFailure};
use crate::costs::Costs;
use crate::statistics::{mean, sample_std};
use crate::{Column, TableGenerationParams, format};

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
    /// One per method (and per value of further axes).
    pub rows: Vec<Row>,
    /// Published values per row.
    pub claims: Vec<ClaimTable>,
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
    pub headline: BTreeMap<Column, Cell>,
    /// Means over seeds, by scene.
    pub by_scene: BTreeMap<String, BTreeMap<Column, Cell>>,
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
    /// Replicates (seeds) that count.
    pub n: usize,
    /// Replicates that were asked for.
    pub n_expected: usize,
    /// Why there is no number, or why some replicates do not count.
    pub reason: Option<String>,
    /// 1 for the best rounded value of the column; none where there is nothing to compare.
    pub rank: Option<usize>,
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
        let is_missing =
            |run: &Run| run.failure.as_ref().is_some_and(|failure| failure.kind == FailureKind::MissingData);
        let missing_data = runs
            .iter()
            .filter(|run| is_missing(run))
            .filter_map(|run| run.failure.as_ref().map(|failure| (run.scene.clone(), failure.message.clone())));
        let failed = runs.iter().filter(|run| !is_missing(run)).filter_map(|run| {
            let (scene, row, seed) = (run.scene.clone(), run.row.clone(), run.seed.clone());
            run.failure.clone().map(|failure| FailedRun { scene, row, seed, failure })
        });
        let present: Vec<&Run> = runs.iter().filter(|run| !is_missing(run)).collect();
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
                let cells = row.headline.iter().chain(row.by_scene.values().flatten());
                for (column, cell) in cells {
                    let finite = cell.mean.iter().chain(&cell.std).all(|value| value.is_finite());
                    ensure!(finite, "{} of {} in group {} is not finite", column.key(), row.name, group.name);
                    let reason_known = cell.mean.is_some() || cell.reason.is_some();
                    ensure!(reason_known, "{} of {} is missing without a reason", column.key(), row.name);
                }
                ensure!(
                    row.costs.is_finite() && row.phases.values().all(|secs| secs.is_finite()),
                    "a phase of {} is not finite",
                    row.name
                );
            }
        }
        let lines: BTreeSet<_> = self.groups.iter().map(|group| (group.protocol.line(), &group.judged_by)).collect();
        ensure!(lines.len() == self.groups.len(), "two groups have the same protocol");
        Ok(())
    }
}

/// One group per protocol and metric definition among the measured runs, in order of appearance.
fn groups(runs: &[&Run], claims: &[Claim], params: &TableGenerationParams) -> Vec<Group> {
    let key = |run: &Run| Some((run.protocol.as_ref()?.line(), run.judged_by.clone()?));
    let mut keys = Vec::new();
    for run in runs {
        keys.extend(key(run).filter(|key| !keys.contains(key)));
    }
    let measured_scenes: BTreeSet<&str> =
        runs.iter().filter(|run| key(run).is_some()).map(|run| run.scene.as_str()).collect();
    let in_group = |name: usize, wanted: &(String, String)| {
        let members: Vec<&Run> = runs.iter().copied().filter(|run| key(run).as_ref() == Some(wanted)).collect();
        let member_scenes: BTreeSet<&str> = members.iter().map(|run| run.scene.as_str()).collect();
        // A failed run has no protocol: it leaves a hole wherever its scene is tabulated, or, where its scene failed
        // for every method, in every group, so that no mean silently skips that scene.
        let leaves_hole = |run: &Run| {
            key(run).is_none()
                && (member_scenes.contains(run.scene.as_str()) || !measured_scenes.contains(run.scene.as_str()))
        };
        let relevant: Vec<&Run> =
            runs.iter().copied().filter(|run| key(run).as_ref() == Some(wanted) || leaves_hole(run)).collect();
        group(name, &members, &relevant, claims, params)
    };
    keys.iter().enumerate().filter_map(|(name, wanted)| in_group(name, wanted)).collect()
}

/// The group of the measured runs `members`; `relevant` adds the failed ones.
fn group(
    index: usize,
    members: &[&Run],
    relevant: &[&Run],
    claims: &[Claim],
    params: &TableGenerationParams,
) -> Option<Group> {
    let scenes = distinct(relevant.iter().map(|run| run.scene.as_str()));
    let names = distinct(relevant.iter().map(|run| run.row.as_str()));
    let mut rows: Vec<Row> = names.iter().map(|name| row(name, &scenes, relevant)).collect();
    let machines: BTreeSet<String> = members.iter().flat_map(|run| run.machines.iter().cloned()).collect();
    // Times of different machines do not compare.
    let works = machines.iter().filter_map(|machine| machine.split_once(" on ")).map(|(work, _)| work);
    let one_machine = works.clone().collect::<BTreeSet<_>>().len() == works.count();
    rank(&mut rows, &scenes, one_machine);
    let mut group = Group {
        name: char::from(b'A' + (index % 26) as u8).to_string().repeat(index / 26 + 1),
        protocol: members.first()?.protocol.clone()?,
        judged_by: members.first()?.judged_by.clone()?,
        machines,
        scenes,
        rows,
        claims: Vec::new(),
    };
    group.claims = group.rows.iter().filter_map(|row| ClaimTable::new(row, &group, claims, params)).collect();
    Some(group)
}

/// The distinct values in order of appearance, which is that of the recipe.
fn distinct<'a>(values: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut seen = Vec::new();
    for value in values {
        if !seen.iter().any(|other| other == value) {
            seen.push(value.to_owned());
        }
    }
    seen
}

fn row(name: &str, scenes: &[String], runs: &[&Run]) -> Row {
    let runs: Vec<&Run> = runs.iter().copied().filter(|run| run.row == name).collect();
    let seeds = distinct(runs.iter().map(|run| run.seed.as_str()));
    let headline = Column::all().map(|column| (column, headline_cell(&runs, scenes, &seeds, column)));
    let by_scene = scenes.iter().map(|scene| {
        let here: Vec<&Run> = runs.iter().copied().filter(|run| run.scene == *scene).collect();
        (scene.clone(), Column::all().map(|column| (column, scene_cell(&here, seeds.len(), column))).collect())
    });
    let mut phases = BTreeMap::<String, Vec<f64>>::new();
    for (phase, secs) in runs.iter().flat_map(|run| &run.phases) {
        phases.entry(phase.clone()).or_default().push(*secs);
    }
    let costs = Costs::mean(runs.iter().map(|run| &run.costs));
    let n_with_phases = runs.iter().filter(|run| !run.phases.is_empty()).count();
    Row {
        name: name.into(),
        method: runs.first().map(|run| run.method.clone()).unwrap_or_default(),
        variant: runs.first().and_then(|run| run.variant.clone()),
        headline: headline.collect(),
        by_scene: by_scene.collect(),
        phases: phases
            .into_iter()
            .map(|(phase, secs)| (phase, secs.iter().sum::<f64>() / n_with_phases as f64))
            .collect(),
        costs,
    }
}

/// A figure of a run, or why it has none.
fn figure(run: &Run, column: Column) -> Result<f64, String> {
    match run.figures.get(&column) {
        Some(Score::Value(value)) if value.is_finite() => Ok(*value),
        Some(Score::Value(_)) => Err("not finite".into()),
        Some(Score::Undefined { undefined }) => Err(undefined.clone()),
        None => Err(run.failure.as_ref().map_or("not measured".into(), |failure| failure_mark(failure.kind).into())),
    }
}

/// Mean over the seeds of one scene.
fn scene_cell(runs: &[&Run], n_expected: usize, column: Column) -> Cell {
    let figures: Vec<_> = runs.iter().map(|run| figure(run, column)).collect();
    let values: Vec<f64> = figures.iter().filter_map(|figure| figure.clone().ok()).collect();
    let reason = figures.into_iter().find_map(Result::err);
    let reason = if runs.is_empty() { Some("not run".into()) } else { reason };
    Cell { mean: mean(&values), std: sample_std(&values), n: values.len(), n_expected, reason, rank: None }
}

/// Mean over scenes for each seed, then mean and spread over the seeds for which no scene is missing.
fn headline_cell(runs: &[&Run], scenes: &[String], seeds: &[String], column: Column) -> Cell {
    let mut reason = None;
    let mut replicate = |seed: &String| {
        let value_in = |scene: &String| {
            let run = runs.iter().find(|run| run.scene == *scene && run.seed == *seed);
            run.map_or(Err("not run".into()), |run| figure(run, column)).map_err(|why| format!("{scene}: {why}"))
        };
        let values: Result<Vec<f64>, String> = scenes.iter().map(value_in).collect();
        values.map_err(|why| reason.get_or_insert(why).clone()).ok().and_then(|values| mean(&values))
    };
    let replicates: Vec<f64> = seeds.iter().filter_map(&mut replicate).collect();
    let (n, n_expected) = (replicates.len(), seeds.len());
    Cell { mean: mean(&replicates), std: sample_std(&replicates), n, n_expected, reason, rank: None }
}

/// What stands in a cell instead of a number, by kind of failure.
pub fn failure_mark(kind: FailureKind) -> &'static str {
    match kind {
        FailureKind::MissingData => "no data",
        FailureKind::BadInput => "bad input",
        FailureKind::Diverged => "NaN",
        FailureKind::OutOfMemory => "OOM",
        FailureKind::Timeout => "timeout",
        FailureKind::Interrupted => "stopped",
        FailureKind::DeviceLost => "device lost",
        FailureKind::World => "machine",
        FailureKind::Crashed => "crash",
    }
}

/// Ranks every column on rounded values: equal roundings share a rank; a single value has none.
fn rank(rows: &mut [Row], scenes: &[String], one_machine: bool) {
    for column in Column::all().filter(|column| one_machine || !column.is_timing()) {
        rank_cells(rows.iter_mut().filter_map(|row| row.headline.get_mut(&column)).collect(), column);
        for scene in scenes {
            let cells = rows.iter_mut().filter_map(|row| row.by_scene.get_mut(scene)?.get_mut(&column));
            rank_cells(cells.collect(), column);
        }
    }
}

fn rank_cells(cells: Vec<&mut Cell>, column: Column) {
    let rounded = |cell: &Cell| format::number(cell.mean?, column.decimals()).parse::<f64>().ok();
    let values: Vec<f64> = cells.iter().filter_map(|cell| rounded(cell)).collect();
    if values.len() < 2 {
        return;
    }
    for cell in cells {
        let better = |mine: f64| {
            values
                .iter()
                .filter(|other| if column.higher_is_better() { **other > mine } else { **other < mine })
                .count()
        };
        cell.rank = rounded(cell).map(|mine| 1 + better(mine));
    }
}
