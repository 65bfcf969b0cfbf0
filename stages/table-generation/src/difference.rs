//! Differences paired by seed.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::cell::{Cell, Cells};
use crate::column::Column;
use crate::format::{number, signed};
use crate::statistics::{half_width, mean, sample_std};

/// The remark below every table of differences.
pub(crate) const REMARK: &str = "± is half the 95 % interval (Student) of the paired difference over seeds. A \
                                 difference without ± is from one seed and proves nothing.";

/// The mean difference of two cells over the seeds that both have.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Difference {
    /// The mean over seeds.
    pub mean: f64,
    /// Half the width of its 95 % interval; none for one seed.
    pub half_width: Option<f64>,
    /// Number of seeds.
    pub seeds: usize,
}

impl Difference {
    /// `cell` − `reference`, seed by seed: equal seeds share their random streams, so most of the spread over seeds
    /// cancels. None without a common seed.
    pub(crate) fn of(cell: &Cell, reference: &Cell) -> Option<Self> {
        let theirs: BTreeMap<&String, f64> = reference.seeds.iter().zip(reference.values.iter().copied()).collect();
        let own = cell.seeds.iter().zip(&cell.values);
        let differences: Vec<f64> = own.filter_map(|(seed, value)| Some(value - theirs.get(seed)?)).collect();
        let seeds = differences.len();
        let half_width = sample_std(&differences).and_then(|std| half_width(std, seeds));
        Some(Self { mean: mean(&differences)?, half_width, seeds })
    }

    /// The difference of one column.
    pub(crate) fn of_column(cells: &Cells, reference: &Cells, column: Column) -> Option<Self> {
        Self::of(cells.get(&column)?, reference.get(&column)?)
    }

    /// Whether the interval contains 0; false for one seed, which has no interval.
    pub(crate) fn is_noise(self) -> bool {
        self.half_width.is_some_and(|half_width| self.mean.abs() <= half_width)
    }

    /// E.g. `+0.52 ± 0.10`, without ± for one seed.
    pub(crate) fn text(self, column: Column) -> String {
        let decimals = column.decimals();
        let interval = self.half_width.map(|width| format!(" ± {}", number(width, decimals)));
        signed(self.mean, decimals) + &interval.unwrap_or_default()
    }
}

/// A difference in PSNR that a report shows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RowDifference {
    /// The name of the protocol's group.
    pub protocol: String,
    /// The row.
    pub row: String,
    /// The row that it is compared with.
    pub reference: String,
    /// The difference in mean PSNR, dB.
    pub psnr: Difference,
}
