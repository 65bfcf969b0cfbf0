//! The rows that a report compares: variants with the first variant, methods with their bases and with the baseline.

use std::collections::{BTreeMap, BTreeSet};

use crate::base::Base;
use crate::collect::is_whole;
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
            let is_compared =
                |row: &&Row| reference(row, &firsts, &BTreeMap::new()).is_some_and(|other| other.name == first.name);
            own.iter().copied().filter(is_compared).collect::<Vec<_>>()
        };
        firsts.iter().map(|&first| (first, others(first))).filter(|(_, others)| !others.is_empty()).collect::<Vec<_>>()
    };
    distinct(rows().map(|row| row.method.as_str())).into_iter().flat_map(of_method).collect()
}

/// The methods with a base ([`TableGenerationParams::bases`]) that was measured too, each with its base.
pub(crate) fn with_bases<'g>(group: &'g Group, params: &TableGenerationParams) -> Vec<(&'g Row, &'g Row)> {
    params.bases.iter().flat_map(|(method, base)| with_base(group, method, base)).collect()
}

/// The measured methods whose base was not measured, each with a name of the base.
pub(crate) fn without_base<'p>(group: &Group, params: &'p TableGenerationParams) -> Vec<(&'p String, String)> {
    let lacks_base = |(method, base): &(&String, &String)| {
        !whole(group, method).is_empty() && with_base(group, method, base).is_empty()
    };
    let name = |base: &String| match whole(group, base).is_empty() {
        true => base.clone(),
        false => format!("{base} without further axes"),
    };
    params.bases.iter().filter(lacks_base).map(|(method, base)| (method, name(base))).collect()
}

/// The whole rows of a method, each with the row of its base; none if the base is malformed, which
/// [`TableGenerationParams::problems`] reports.
fn with_base<'g>(group: &'g Group, method: &str, base: &str) -> Vec<(&'g Row, &'g Row)> {
    let Ok(base) = base.parse::<Base>() else { return Vec::new() };
    let has_values = |row: &&Row| base.axes.iter().all(|(axis, value)| row.axes.get(axis) == Some(value));
    let bases: Vec<&Row> = whole(group, &base.method).into_iter().filter(has_values).collect();
    let with_reference = |row| Some((row, reference(row, &bases, &base.axes)?));
    whole(group, method).into_iter().filter_map(with_reference).collect()
}

/// The rows other than the baseline, each with the baseline; none if it was not measured.
pub(crate) fn with_baseline<'g>(group: &'g Group, params: &TableGenerationParams) -> Vec<(&'g Row, &'g Row)> {
    let baselines = whole(group, &params.baseline);
    group.rows.iter().filter_map(|row| Some((row, reference(row, &baselines, &BTreeMap::new())?))).collect()
}

/// The rows of a whole method, i.e. of no variant that changes it: several if the recipe has further axes.
fn whole<'g>(group: &'g Group, method: &str) -> Vec<&'g Row> {
    group.rows.iter().filter(|row| row.method == method && is_whole(row.variant.as_deref())).collect()
}

/// The reference that a row is compared with: the one that differs from it on the fewest further axes, because each
/// differing value adds its own effect to the difference. For the same reason, a row with an axis that is neither
/// `named` nor an axis of `row` is no reference. A row that is a reference itself is compared with the first one of
/// those with the fewest axes; that one has no reference.
fn reference<'g>(row: &Row, references: &[&'g Row], named: &BTreeMap<String, String>) -> Option<&'g Row> {
    let is_known = |axis: &String| row.axes.contains_key(axis) || named.contains_key(axis);
    let references = || references.iter().copied().filter(|other| other.axes.keys().all(is_known));
    let first = references().min_by_key(|other| other.axes.len())?;
    let nearest = references().min_by_key(|other| (differing(&row.axes, &other.axes), other.axes.len()))?;
    let other = if nearest.name == row.name { first } else { nearest };
    (other.name != row.name).then_some(other)
}

/// The number of axes on which two rows or runs differ, those that only one of them has included.
pub(crate) fn differing(axes: &BTreeMap<String, String>, others: &BTreeMap<String, String>) -> usize {
    let names: BTreeSet<&String> = axes.keys().chain(others.keys()).collect();
    names.into_iter().filter(|name| axes.get(*name) != others.get(*name)).count()
}
