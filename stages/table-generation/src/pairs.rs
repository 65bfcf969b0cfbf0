//! The rows that a report compares: variants with the first variant, methods with their bases and with the baseline.

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
