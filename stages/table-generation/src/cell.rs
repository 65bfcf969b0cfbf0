//! Aggregated numbers, as tables show them.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::column::Column;

/// Aggregated numbers by column.
pub(crate) type Cells = BTreeMap<Column, Cell>;

/// An aggregated number, or the reason why it is missing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Cell {
    /// Mean over replicates.
    pub mean: Option<f64>,
    /// Sample standard deviation over replicates; none for a single replicate.
    pub std: Option<f64>,
    /// The valid replicates, in the order of seeds.
    pub values: Vec<f64>,
    /// The seed of each value.
    pub seeds: Vec<String>,
    /// Number of replicates that the recipe requests.
    pub n_expected: usize,
    /// The reason why the number is missing, or why some replicates are left out.
    pub reason: Option<String>,
    /// Rank of the rounded value in its column, 1 for the best; `None` if there is nothing to compare.
    pub rank: Option<usize>,
    /// Whether the 95 % interval of the paired difference from the best of the column contains 0.
    pub within_noise: bool,
}

impl Cell {
    /// Number of valid replicates.
    pub(crate) fn n(&self) -> usize {
        self.values.len()
    }
}
