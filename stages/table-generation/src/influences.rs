//! Measures the influence of every loss and effect of a row: from its runs, and from the rows that lack one of them.

use std::collections::BTreeMap;

use crate::collect::{LossInfluence, Run, WITHOUT};
use crate::column::Column;
use crate::common_scenes;
use crate::difference::Difference;
use crate::influence::Influence;
use crate::report::Row;
use crate::statistics::{mean, median};

/// The influence of the losses and effects of a row with these runs; `rows` are all rows of its group. Seconds of effects,
/// which are differences between rows, need `one_machine`.
pub(crate) fn influences(row: &Row, runs: &[&Run], rows: &[Row], one_machine: bool) -> Vec<Influence> {
    if row.variant.as_ref().is_some_and(|variant| variant.starts_with(WITHOUT)) {
        return Vec::new();
    }
    let mut losses: BTreeMap<&str, Vec<&LossInfluence>> = BTreeMap::new();
    for loss in runs.iter().flat_map(|run| &run.influence) {
        losses.entry(&loss.loss).or_default().push(loss);
    }
    let has_loss = |effect: &str| losses.contains_key(effect.replace('-', "_").as_str());
    let effects = row.effects.iter().filter(|effect| !has_loss(effect)).map(|effect| of_effect(effect, row, rows));
    let effects = effects.map(|effect| Influence { secs: effect.secs.filter(|_| one_machine), ..effect });
    let influences = losses.values().map(|loss| of_loss(loss, row, rows)).chain(effects);
    let shared = |influence: Influence| {
        let secs_share = influence.secs.zip(training_secs(row)).map(|(secs, all)| secs / all);
        Influence { secs_share, ..influence }.judged()
    };
    influences.map(shared).collect()
}

/// The influence of one loss in several runs.
fn of_loss(of_runs: &[&LossInfluence], row: &Row, rows: &[Row]) -> Influence {
    let LossInfluence { loss, effect, stays, .. } = of_runs[0];
    let mut by_group: BTreeMap<&String, Vec<f64>> = BTreeMap::new();
    for (group, share) in of_runs.iter().flat_map(|run| &run.shares) {
        by_group.entry(group).or_default().push(share.unwrap_or(f64::INFINITY));
    }
    let typical = |values: Vec<f64>| median(&values).filter(|share| share.is_finite());
    let secs: Vec<f64> = of_runs.iter().filter_map(|run| run.secs).collect();
    let namesake = effect.as_deref().filter(|effect| effect.replace('-', "_") == *loss);
    let without = row_without(loss, row, rows).or_else(|| row_without(namesake?, row, rows));
    Influence {
        part: loss.clone(),
        effect: effect.clone(),
        stays: stays.clone(),
        is_loss: true,
        shares: by_group.into_iter().map(|(group, values)| (group.clone(), typical(values))).collect(),
        samples: of_runs.iter().map(|run| run.samples).sum(),
        left_out: without.map_or_else(BTreeMap::new, |without| differences(without, row)),
        secs: mean(&secs),
        ..Influence::default()
    }
}

/// The influence of an effect without a loss of its name.
fn of_effect(effect: &str, row: &Row, rows: &[Row]) -> Influence {
    let without = row_without(effect, row, rows);
    let secs =
        without.and_then(|without| Difference::of_column(&row.headline, &without.headline, Column::TrainingSecs));
    Influence {
        part: effect.into(),
        stays: row.kept_effects.get(effect).cloned(),
        left_out: without.map_or_else(BTreeMap::new, |without| differences(without, row)),
        secs: secs.map(|secs| secs.mean),
        ..Influence::default()
    }
}

/// The row that differs from `row` in nothing but lacking one part: by the axis `without`, or by its effects.
fn row_without<'r>(part: &str, row: &Row, rows: &'r [Row]) -> Option<&'r Row> {
    let is_alike = |other: &&Row| (&other.method, &other.axes) == (&row.method, &row.axes) && other.name != row.name;
    let alike = || rows.iter().filter(is_alike);
    let named = format!("{WITHOUT}{part}");
    let lacks_only = |other: &&Row| {
        let is_without = |effect: &String| *effect != part;
        row.effects.contains(part) && other.effects.iter().eq(row.effects.iter().filter(|effect| is_without(effect)))
    };
    alike().find(|other| other.variant.as_ref() == Some(&named)).or_else(|| {
        // Rows of an axis `without` name what they lack: those that lack a loss have all effects.
        alike().filter(|other| !other.variant.as_ref().is_some_and(|name| name.starts_with(WITHOUT))).find(lacks_only)
    })
}

/// The differences of a row from the whole in PSNR and the metrics of tasks, each over the scenes that both have.
fn differences(without: &Row, whole: &Row) -> BTreeMap<Column, Difference> {
    let columns = std::iter::once(Column::PSNR).chain(Column::TASKS);
    columns.filter_map(|column| Some((column, common_scenes::difference(without, whole, column)?))).collect()
}

fn training_secs(row: &Row) -> Option<f64> {
    row.headline.get(&Column::TrainingSecs)?.mean.filter(|secs| *secs > 0.0)
}
