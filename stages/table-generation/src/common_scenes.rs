//! Differences of rows over the scenes that both have.

use crate::cell::Cell;
use crate::column::Column;
use crate::difference::Difference;
use crate::report::Row;
use crate::statistics::mean;

/// The difference of one column over the scenes in which both rows have a value.
pub(crate) fn difference(row: &Row, reference: &Row, column: Column) -> Option<Difference> {
    let has_value = |row: &Row, scene: &String| cell_of(row, scene, column).is_some_and(|cell| cell.mean.is_some());
    let is_common = |scene: &&String| has_value(row, scene) && has_value(reference, scene);
    let scenes: Vec<&String> = reference.by_scene.keys().filter(is_common).collect();
    Difference::of(&mean_over(row, &scenes, column)?, &mean_over(reference, &scenes, column)?)
}

fn cell_of<'r>(row: &'r Row, scene: &String, column: Column) -> Option<&'r Cell> {
    row.by_scene.get(scene)?.get(&column)
}

/// The mean of a column over scenes for each seed that has all of them.
fn mean_over(row: &Row, scenes: &[&String], column: Column) -> Option<Cell> {
    let cells: Vec<&Cell> = scenes.iter().filter_map(|scene| cell_of(row, scene, column)).collect();
    let value = |cell: &Cell, seed: &String| Some(cell.values[cell.seeds.iter().position(|own| own == seed)?]);
    let of_seed = |seed: &String| {
        let values: Option<Vec<f64>> = cells.iter().map(|cell| value(cell, seed)).collect();
        Some((seed.clone(), mean(&values?)?))
    };
    let (seeds, values) = cells.first()?.seeds.iter().filter_map(of_seed).unzip();
    Some(Cell { seeds, values, ..Cell::default() })
}
