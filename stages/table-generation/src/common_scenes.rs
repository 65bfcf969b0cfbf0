//! Differences of rows over the scenes that both have.

use crate::cell::Cell;
use crate::column::Column;
use crate::difference::Difference;
use crate::report::Row;
use crate::statistics::{mean, sample_std};

/// The difference of one column over the scenes in which both rows have a value.
pub(crate) fn difference(row: &Row, reference: &Row, column: Column) -> Option<Difference> {
    let has_value = |row: &Row, scene: &String| cell_of(row, scene, column).is_some_and(|cell| cell.mean.is_some());
    let is_common = |scene: &&String| has_value(row, scene) && has_value(reference, scene);
    let scenes: Vec<&String> = reference.by_scene.keys().filter(is_common).collect();
    let over_common = |row: &Row| mean_over(row, scenes.iter().copied(), column);
    Difference::of(&over_common(row)?, &over_common(reference)?)
}

fn cell_of<'r>(row: &'r Row, scene: &String, column: Column) -> Option<&'r Cell> {
    row.by_scene.get(scene)?.get(&column)
}

/// The mean of a column over scenes for each seed that has all of them, with its mean and spread over these seeds. None if
/// no scene has a cell.
pub(crate) fn mean_over<'s>(row: &Row, scenes: impl Iterator<Item = &'s String>, column: Column) -> Option<Cell> {
    let cells: Vec<&Cell> = scenes.filter_map(|scene| cell_of(row, scene, column)).collect();
    let value = |cell: &Cell, seed: &String| Some(cell.values[cell.seeds.iter().position(|own| own == seed)?]);
    let of_seed = |seed: &String| {
        let values: Option<Vec<f64>> = cells.iter().map(|cell| value(cell, seed)).collect();
        Some((seed.clone(), mean(&values?)?))
    };
    let first = cells.first()?;
    let (seeds, values): (Vec<String>, Vec<f64>) = first.seeds.iter().filter_map(of_seed).unzip();
    let reason = cells.iter().find_map(|cell| cell.reason.clone());
    let n_expected = first.n_expected;
    Some(Cell { mean: mean(&values), std: sample_std(&values), seeds, values, n_expected, reason, ..Cell::default() })
}
