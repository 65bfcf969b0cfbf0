//! Builds reports: groups comparable runs and computes means over scenes and seeds.

use std::collections::{BTreeMap, BTreeSet};

use metric_evaluation::Score;
use scene::Protocol;

use crate::cell::{Cell, Cells};
use crate::claims::Claim;
use crate::collect::{Costs, DEGENERATE, FINISHED, Run, failure_mark};
use crate::column::Column;
use crate::comparison::claim_table;
use crate::distinct::distinct;
use crate::format::number;
use crate::influences::influences;
use crate::pairs::row_differences;
use crate::params::TableGenerationParams;
use crate::ranks::rank;
use crate::report::{FailedRun, Group, Report, Row, ScenePart};
use crate::statistics::{mean, sample_std};

/// Relative overrun of a budget up to which it counts as met; the cost of steps varies by about this much.
const BUDGET_TOLERANCE: f64 = 0.15;

impl Report {
    /// Groups `runs` by protocol and metric definitions, aggregates them, and looks up published values.
    pub(crate) fn new(runs: Vec<Run>, claims: &[Claim], params: &TableGenerationParams) -> Self {
        let missing_data = runs
            .iter()
            .filter(|run| run.misses_data())
            .filter_map(|run| run.failure.as_ref().map(|failure| (run.scene.clone(), failure.message.clone())));
        let failed = runs.iter().filter(|run| !run.misses_data()).filter_map(|run| {
            let (scene, row, seed) = (run.scene.clone(), run.row.clone(), run.seed.clone());
            run.failure.clone().map(|failure| FailedRun { scene, row, seed, failure })
        });
        let present: Vec<&Run> = runs.iter().filter(|run| !run.misses_data()).collect();
        let groups = groups(&present, claims, params);
        Self {
            title: params.title.clone(),
            differences: groups.iter().flat_map(|group| row_differences(group, params)).collect(),
            groups,
            failures: failed.collect(),
            missing_data: missing_data.collect(),
            runs,
        }
    }
}

/// One group per protocol and metric definition among the measured runs, in order of appearance.
fn groups(runs: &[&Run], claims: &[Claim], params: &TableGenerationParams) -> Vec<Group> {
    let key = |run: &Run| Some((run.protocol.as_ref()?.line(), run.judged_by.clone()?));
    let mut keys = Vec::new();
    for run in runs {
        keys.extend(key(run).filter(|key| !keys.contains(key)));
    }
    let measured: BTreeSet<(String, &str)> =
        runs.iter().filter_map(|run| Some((key(run)?.0, run.scene.as_str()))).collect();
    let in_group = |name: usize, wanted: &(String, String)| {
        let members: Vec<&Run> = runs.iter().copied().filter(|run| key(run).as_ref() == Some(wanted)).collect();
        let member_scenes: BTreeSet<&str> = members.iter().map(|run| run.scene.as_str()).collect();
        // No mean may silently skip a scene, so a failed run leaves a gap in the groups of its protocol that tabulate its
        // scene, or in all groups of its protocol if the scene failed for every method. A run that failed before it had a
        // protocol leaves a gap in every group that tabulates its scene.
        let leaves_hole = |run: &Run| {
            let is_tabulated = member_scenes.contains(run.scene.as_str());
            let belongs = match run.protocol.as_ref().map(|protocol| (protocol.line(), run.scene.as_str())) {
                Some(place) => place.0 == wanted.0 && (is_tabulated || !measured.contains(&place)),
                None => is_tabulated,
            };
            key(run).is_none() && belongs
        };
        let relevant: Vec<&Run> =
            runs.iter().copied().filter(|run| key(run).as_ref() == Some(wanted) || leaves_hole(run)).collect();
        group(name, &members, &relevant, claims, params)
    };
    keys.iter().enumerate().filter_map(|(name, wanted)| in_group(name, wanted)).collect()
}

/// The group of the measured runs `members`; `relevant` holds them and the failed runs of the group.
fn group(
    index: usize,
    members: &[&Run],
    relevant: &[&Run],
    claims: &[Claim],
    params: &TableGenerationParams,
) -> Option<Group> {
    let protocol = members.first()?.protocol.clone()?;
    let scenes = distinct(relevant.iter().map(|run| run.scene.as_str()));
    let parts = parts_of(&protocol, &scenes);
    let names = distinct(relevant.iter().map(|run| run.row.as_str()));
    let mut rows: Vec<Row> = names.iter().map(|name| row(name, &scenes, &parts, relevant)).collect();
    let works = || members.iter().flat_map(|run| &run.machines).map(|(work, machine)| (work, machine.line()));
    let machines: BTreeSet<(&String, String)> = works().collect();
    // Times of different machines are not comparable.
    let one_machine = machines.len() == works().map(|(work, _)| work).collect::<BTreeSet<_>>().len();
    rank(&mut rows, &scenes, one_machine);
    let influence = |row: &Row| {
        let sound = members.iter().copied().filter(|run| run.row == row.name && run.degenerate.is_none());
        influences(row, &sound.collect::<Vec<_>>(), &rows, one_machine)
    };
    let influence: Vec<_> = rows.iter().map(influence).collect();
    rows.iter_mut().zip(influence).for_each(|(row, influence)| row.influence = influence);
    let mut group = Group {
        name: char::from(b'A' + (index % 26) as u8).to_string().repeat(index / 26 + 1),
        protocol,
        judged_by: members.first()?.judged_by.clone()?,
        machines: machines.into_iter().map(|(work, machine)| format!("{work} on {machine}")).collect(),
        one_machine,
        trivial: members.iter().filter_map(|run| Some((run.scene.clone(), run.trivial.clone()?))).collect(),
        scenes,
        parts,
        rows,
        claims: Vec::new(),
    };
    let tolerance_db = params.reproduced_within_db;
    group.claims = group.rows.iter().filter_map(|row| claim_table(row, &group, claims, tolerance_db)).collect();
    Some(group)
}

/// The subsets of the scenes for which the literature prints means (e.g. D-NeRF without Lego), named by the scenes that
/// they leave out.
fn parts_of(protocol: &Protocol, scenes: &[String]) -> Vec<ScenePart> {
    let mut parts = Vec::new();
    for quoted in protocol.quoted_means() {
        let (own, others): (Vec<_>, Vec<_>) =
            scenes.iter().cloned().partition(|scene| quoted.contains(&scene.as_str()));
        let part = ScenePart { name: format!("without {}", others.join(", ")), scenes: own };
        if !part.scenes.is_empty() && !others.is_empty() && !parts.contains(&part) {
            parts.push(part);
        }
    }
    parts
}

fn row(name: &str, scenes: &[String], parts: &[ScenePart], runs: &[&Run]) -> Row {
    let runs: Vec<&Run> = runs.iter().copied().filter(|run| run.row == name).collect();
    let seeds = distinct(runs.iter().map(|run| run.seed.as_str()));
    let sound: Vec<&Run> = runs.iter().copied().filter(|run| run.degenerate.is_none()).collect();
    let means = |scenes: &[String]| -> Cells {
        Column::all().map(|column| (column, mean_cell(&runs, scenes, &seeds, column))).collect()
    };
    let by_scene = scenes.iter().map(|scene| {
        let here: Vec<&Run> = runs.iter().copied().filter(|run| run.scene == *scene).collect();
        (scene.clone(), Column::all().map(|column| (column, scene_cell(&here, seeds.len(), column))).collect())
    });
    Row {
        name: name.into(),
        method: runs.iter().map(|run| run.method.clone()).find(|method| !method.is_empty()).unwrap_or_default(),
        variant: runs.first().and_then(|run| run.variant.clone()),
        axes: runs.first().map(|run| run.axes.clone()).unwrap_or_default(),
        headline: means(scenes),
        parts: parts.iter().map(|part| means(&part.scenes)).collect(),
        by_scene: by_scene.collect(),
        shortened: shortened(&runs),
        phases: mean_phases(&sound),
        costs: Costs::mean(sound.iter().map(|run| &run.costs)),
        effects: common_effects(&sound),
        kept_effects: sound.iter().flat_map(|run| run.kept_effects.clone()).collect(),
        influence: Vec::new(),
    }
}

/// The effects that every run simulated.
fn common_effects(runs: &[&Run]) -> BTreeSet<String> {
    let sets = runs.iter().map(|run| run.effects.clone());
    sets.reduce(|common, other| common.intersection(&other).cloned().collect()).unwrap_or_default()
}

/// Seconds by activity, mean over the runs that measured any.
fn mean_phases(runs: &[&Run]) -> BTreeMap<String, f64> {
    let n_measured = runs.iter().filter(|run| !run.phases.is_empty()).count();
    let mut phases = BTreeMap::<String, f64>::new();
    for (phase, secs) in runs.iter().flat_map(|run| &run.phases) {
        *phases.entry(phase.clone()).or_default() += secs / n_measured as f64;
    }
    phases
}

/// Describes how the runs' schedules differ from the method's own; none where they do not.
fn shortened(runs: &[&Run]) -> Option<String> {
    let scales = || runs.iter().filter_map(|run| run.schedule_scale).filter(|scale| *scale != 1.0);
    let (shortest, longest) = (scales().reduce(f64::min)?, scales().reduce(f64::max)?);
    let length = match (short(shortest), short(longest)) {
        (one, other) if one == other => format!("schedule scaled by {one}"),
        (one, other) => format!("schedule scaled by {one} to {other}"),
    };
    let budgets: Vec<String> = runs.iter().filter_map(|run| run.budget_secs).map(short).collect();
    let budgets = distinct(budgets.iter().map(String::as_str));
    if budgets.is_empty() {
        return Some(length);
    }
    Some(format!("{length}, to fit a budget of {} s{}", budgets.join(", "), missed_budget(runs)))
}

/// Lists the seconds of the trainings that exceeded their budgets by more than [`BUDGET_TOLERANCE`].
fn missed_budget(runs: &[&Run]) -> String {
    let missed = runs.iter().filter_map(|run| {
        let (budget, took) = (run.budget_secs?, value(run, Column::TrainingSecs).ok()?);
        (took > budget * (1.0 + BUDGET_TOLERANCE)).then_some(took)
    });
    let missed: Vec<String> = missed.map(|took| format!("{} s", number(took, 1))).collect();
    if missed.is_empty() { String::new() } else { format!(" (exceeded: {})", missed.join(", ")) }
}

/// The number with up to four decimals; in scientific notation if these would round it to 0.
fn short(value: f64) -> String {
    let text = number(value, 4);
    match text.trim_end_matches('0').trim_end_matches('.') {
        "0" | "" if value != 0.0 => format!("{value:.1e}"),
        text => text.to_owned(),
    }
}

/// A value of a run, or why it is missing. A degenerate run has no values: they would distort every mean and rank.
fn value(run: &Run, column: Column) -> Result<f64, String> {
    if run.degenerate.is_some() {
        return Err(DEGENERATE.into());
    }
    match run.figures.get(&column) {
        Some(Score::Value(value)) if value.is_finite() => Ok(*value),
        Some(Score::Value(_)) => Err("not finite".into()),
        Some(Score::Undefined { undefined }) => Err(undefined.clone()),
        None => Err(run.failure.as_ref().map_or("not measured".into(), |failure| failure_mark(failure.kind).into())),
    }
}

/// Mean over the seeds of one scene.
fn scene_cell(runs: &[&Run], n_expected: usize, column: Column) -> Cell {
    let replicates = runs.iter().filter_map(|run| Some((run.seed.clone(), value(run, column).ok()?))).collect();
    // A finished run explains why it lacks this number; other runs lack all numbers.
    let reasons = runs.iter().filter_map(|run| Some((run.outcome() != FINISHED, value(run, column).err()?)));
    let reason = reasons.min_by_key(|(is_unfinished, _)| *is_unfinished).map(|(_, reason)| reason);
    cell(replicates, n_expected, if runs.is_empty() { Some("not run".into()) } else { reason })
}

/// Mean over scenes for each seed, then mean and spread over the seeds with values for all scenes.
fn mean_cell(runs: &[&Run], scenes: &[String], seeds: &[String], column: Column) -> Cell {
    let mut reason = None;
    let mut replicate = |seed: &String| {
        let value_in = |scene: &String| {
            let run = runs.iter().find(|run| run.scene == *scene && run.seed == *seed);
            run.map_or(Err("not run".into()), |run| value(run, column)).map_err(|why| format!("{scene}: {why}"))
        };
        let values: Result<Vec<f64>, String> = scenes.iter().map(value_in).collect();
        let values = values.map_err(|why| reason.get_or_insert(why).clone()).ok()?;
        Some((seed.clone(), mean(&values)?))
    };
    let replicates = seeds.iter().filter_map(&mut replicate).collect();
    cell(replicates, seeds.len(), reason)
}

/// Mean and spread over replicates, each with its seed.
fn cell(replicates: Vec<(String, f64)>, n_expected: usize, reason: Option<String>) -> Cell {
    let (seeds, values): (Vec<String>, Vec<f64>) = replicates.into_iter().unzip();
    Cell { mean: mean(&values), std: sample_std(&values), values, seeds, n_expected, reason, ..Cell::default() }
}
