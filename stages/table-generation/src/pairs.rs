//! The rows that a report compares: variants with the first variant, methods with their bases and with the baseline.

use std::collections::{BTreeMap, BTreeSet};

use crate::column::Column;
use crate::difference::{Difference, RowDifference};
use crate::distinct::distinct;
use crate::params::TableGenerationParams;
use crate::report::{Group, Row};

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
        let psnr = Difference::of_column(&row.headline, &reference.headline, Column::PSNR)?;
        let [protocol, row, reference] = [&group.name, &row.name, &reference.name].map(Clone::clone);
        Some(RowDifference { protocol, row, reference, psnr })
    };
    pairs.into_iter().filter_map(difference).collect()
}

/// The first variant of each method with several, and the variants that are compared with it. With further axes, there is one
/// first variant for each combination of their values.
pub(crate) fn variants(group: &Group) -> Vec<(&Row, Vec<&Row>)> {
    let rows = || group.rows.iter().filter(|row| row.variant.is_some());
    let of_method = |method: String| {
        let own: Vec<&Row> = rows().filter(|row| row.method == method).collect();
        let firsts: Vec<&Row> = own.iter().copied().filter(|row| row.variant == own[0].variant).collect();
        let others = |first: &Row| {
            let is_compared = |row: &&Row| reference(row, &firsts).is_some_and(|other| other.name == first.name);
            own.iter().copied().filter(is_compared).collect::<Vec<_>>()
        };
        firsts.iter().map(|&first| (first, others(first))).filter(|(_, others)| !others.is_empty()).collect::<Vec<_>>()
    };
    distinct(rows().map(|row| row.method.as_str())).into_iter().flat_map(of_method).collect()
}

/// The methods with a base ([`TableGenerationParams::bases`]) that was measured too, each with its base.
pub(crate) fn with_bases<'g>(group: &'g Group, params: &TableGenerationParams) -> Vec<(&'g Row, &'g Row)> {
    let of_method = |(method, base): (&String, &String)| {
        let bases = whole(group, base);
        let rows = whole(group, method).into_iter();
        rows.filter_map(|row| Some((row, reference(row, &bases)?))).collect::<Vec<_>>()
    };
    params.bases.iter().flat_map(of_method).collect()
}

/// The rows other than the baseline, each with the baseline; none if it was not measured.
pub(crate) fn with_baseline<'g>(group: &'g Group, params: &TableGenerationParams) -> Vec<(&'g Row, &'g Row)> {
    let baselines = whole(group, &params.baseline);
    group.rows.iter().filter_map(|row| Some((row, reference(row, &baselines)?))).collect()
}

/// The rows of a whole method, i.e. of no variant of it: several if the recipe has further axes.
fn whole<'g>(group: &'g Group, method: &str) -> Vec<&'g Row> {
    group.rows.iter().filter(|row| row.method == method && row.variant.is_none()).collect()
}

/// The reference that a row is compared with: the one whose values of further axes differ least from those of the row, because
/// every other value that differs would add its own effect to the difference. References themselves are compared with the
/// first; the first has none.
fn reference<'g>(row: &Row, references: &[&'g Row]) -> Option<&'g Row> {
    let nearest = *references.iter().min_by_key(|other| differing(&row.axes, &other.axes))?;
    let other = if nearest.name == row.name { references[0] } else { nearest };
    (other.name != row.name).then_some(other)
}

/// The number of axes on which two rows or runs differ, those that only one of them has included.
pub(crate) fn differing(axes: &BTreeMap<String, String>, others: &BTreeMap<String, String>) -> usize {
    let names: BTreeSet<&String> = axes.keys().chain(others.keys()).collect();
    names.into_iter().filter(|name| axes.get(*name) != others.get(*name)).count()
}
