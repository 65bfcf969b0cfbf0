//! Paired differences: of variants from the first variant, of methods from their bases and from the baseline.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::cell::Cell;
use crate::column::Column;
use crate::format::{number, signed};
use crate::grouping::distinct;
use crate::params::TableGenerationParams;
use crate::report::{Group, Row};
use crate::statistics::{half_width, mean, sample_std};

/// The remark below every table of differences.
pub(crate) const REMARK: &str = "± is half the 95 % interval (Student) of the paired difference over seeds. A \
                                 difference without ± is of one seed: it is no finding.";

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

    /// The difference of a column of two rows, from the means over scenes.
    pub(crate) fn of_rows(row: &Row, reference: &Row, column: Column) -> Option<Self> {
        Self::of(row.headline.get(&column)?, reference.headline.get(&column)?)
    }

    /// Whether the interval contains 0. One seed shows nothing either way.
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

/// A difference in PSNR that a report is about.
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

/// The differences in PSNR of a group's variants from their first variants and of its methods from their bases; without
/// any of these, of its methods from the baseline.
pub(crate) fn row_differences(group: &Group, params: &TableGenerationParams) -> Vec<RowDifference> {
    let mut pairs: Vec<(&Row, &Row)> = variants(group)
        .into_iter()
        .flat_map(|(first, others)| others.into_iter().map(move |row| (row, first)))
        .collect();
    pairs.extend(with_bases(group, params));
    if pairs.is_empty() {
        pairs.extend(with_baseline(group, params));
    }
    let difference = |(row, reference): (&Row, &Row)| {
        let psnr = Difference::of_rows(row, reference, Column::PSNR)?;
        let [protocol, row, reference] = [&group.name, &row.name, &reference.name].map(Clone::clone);
        Some(RowDifference { protocol, row, reference, psnr })
    };
    pairs.into_iter().filter_map(difference).collect()
}

/// The first variant of each method with several, and its other variants.
pub(crate) fn variants(group: &Group) -> Vec<(&Row, Vec<&Row>)> {
    let rows = || group.rows.iter().filter(|row| row.variant.is_some());
    let of_method = |method: String| {
        let mut own = rows().filter(|row| row.method == method);
        let first = own.next()?;
        let others: Vec<&Row> = own.collect();
        (!others.is_empty()).then_some((first, others))
    };
    distinct(rows().map(|row| row.method.as_str())).into_iter().filter_map(of_method).collect()
}

/// The methods with a base ([`TableGenerationParams::bases`]) that was measured too, each with its base.
pub(crate) fn with_bases<'g>(group: &'g Group, params: &TableGenerationParams) -> Vec<(&'g Row, &'g Row)> {
    let whole = |name: &str| group.rows.iter().find(|row| row.method == name && row.variant.is_none());
    params.bases.iter().filter_map(|(method, base)| whole(method).zip(whole(base))).collect()
}

/// The rows other than the baseline, each with the baseline; none if it was not measured.
pub(crate) fn with_baseline<'g>(group: &'g Group, params: &TableGenerationParams) -> Vec<(&'g Row, &'g Row)> {
    let baseline = group.rows.iter().find(|row| row.method == params.baseline && row.variant.is_none());
    let others = |baseline: &'g Row| {
        group.rows.iter().filter(|row| row.name != baseline.name).map(|row| (row, baseline)).collect()
    };
    baseline.map_or(Vec::new(), others)
}
