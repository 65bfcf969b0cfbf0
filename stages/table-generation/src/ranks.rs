//! Ranks the values of every column, and marks those that are not distinguishable from the best.

use std::collections::{BTreeMap, BTreeSet};

use crate::cell::Cell;
use crate::column::Column;
use crate::difference::Difference;
use crate::format;
use crate::report::Row;

/// Ranks every column by rounded values, so that equal printed values share a rank. A single value has no rank, and
/// times are ranked only if `one_machine`.
pub(crate) fn rank(rows: &mut [Row], scenes: &[String], one_machine: bool) {
    let n_parts = rows.first().map_or(0, |row| row.parts.len());
    for column in Column::all().filter(|column| one_machine || !column.is_timing()) {
        rank_cells(rows.iter_mut().filter_map(|row| row.headline.get_mut(&column)).collect(), column);
        for part in 0..n_parts {
            rank_cells(rows.iter_mut().filter_map(|row| row.parts[part].get_mut(&column)).collect(), column);
        }
        for scene in scenes {
            let cells = rows.iter_mut().filter_map(|row| row.by_scene.get_mut(scene)?.get_mut(&column));
            rank_cells(cells.collect(), column);
        }
    }
}

fn rank_cells(mut cells: Vec<&mut Cell>, column: Column) {
    let complete = complete_seeds(cells.iter().map(|cell| &**cell));
    // Only the fastest seeds reach a quality: a mean over them is no value of the method.
    let reaches = |cell: &Cell| !column.is_time_to_quality() || cell.n() == cell.n_expected;
    let is_ranked = |cell: &&Cell| seeds_of(cell) == complete && reaches(cell);
    let rounded = |cell: &Cell| {
        let mean = Some(cell).filter(is_ranked)?.mean?;
        format::number(mean, column.decimals()).parse::<f64>().ok()
    };
    let values: Vec<f64> = cells.iter().filter_map(|cell| rounded(cell)).collect();
    if values.len() < 2 {
        return;
    }
    for cell in &mut cells {
        let better = |mine: f64| {
            values
                .iter()
                .filter(|other| if column.higher_is_better() { **other > mine } else { **other < mine })
                .count()
        };
        cell.rank = rounded(cell).map(|mine| 1 + better(mine));
    }
    mark_noise(&mut cells);
}

/// The seeds that a value needs for a rank or for the Pareto front: the most that any value has, and of several such sets the
/// most frequent one. Seeds differ in difficulty, so a mean without a hard seed would lead.
pub(crate) fn complete_seeds<'c>(cells: impl Iterator<Item = &'c Cell>) -> BTreeSet<String> {
    let mut counts: BTreeMap<BTreeSet<String>, usize> = BTreeMap::new();
    for cell in cells {
        *counts.entry(seeds_of(cell)).or_default() += 1;
    }
    let most = counts.into_iter().max_by_key(|(seeds, count)| (seeds.len(), *count));
    most.map(|(seeds, _)| seeds).unwrap_or_default()
}

/// The seeds of a value.
pub(crate) fn seeds_of(cell: &Cell) -> BTreeSet<String> {
    cell.seeds.iter().cloned().collect()
}

/// Marks the values whose paired difference from the best has a 95 % interval over seeds that contains 0.
fn mark_noise(cells: &mut [&mut Cell]) {
    let Some(best) = cells.iter().find(|cell| cell.rank == Some(1)).map(|cell| (**cell).clone()) else { return };
    for cell in cells.iter_mut().filter(|cell| cell.rank.is_some_and(|rank| rank > 1)) {
        cell.within_noise = Difference::of(cell, &best).is_some_and(Difference::is_noise);
    }
}
