//! Printed cells with measured values and values measured by third parties.

use std::collections::BTreeSet;

use super::quantity::Quantity;
use super::table::{Heading, PaperTable, Place};
use crate::cell::Cell;
use crate::claims::{Claim, Kind, Verdict};
use crate::collect::is_whole;
use crate::column::Column;
use crate::common_scenes;
use crate::report::{Group, Report, Row};

/// A printed cell with the values to compare it with.
pub(crate) struct ComparedCell {
    /// The text as printed.
    pub printed: String,
    /// The measured value; none if the method is not part of this project.
    pub measured: Option<Measured>,
    /// Verdict on the printed value, with the differences between the protocols.
    pub verdict: Option<(Verdict, Vec<String>)>,
    /// Values measured by third parties: source and PSNR (dB).
    pub others: Vec<(String, f64)>,
}

/// A measured value, or the reason why it is missing.
pub(crate) enum Measured {
    /// A value in the paper's unit.
    Value {
        /// The value.
        value: f64,
        /// Number of decimals to print.
        decimals: usize,
        /// The report's row that it comes from.
        row: String,
        /// The scene; none for a mean.
        scene: Option<String>,
        /// The variant of the metric, where there are several.
        variant: Option<&'static str>,
    },
    /// The reason why it is missing, e.g. `missing data`.
    Missing(String),
}

impl PaperTable {
    /// Pairs measured values with the cell where `row` and `column` meet, which prints `text`. `others` are the claims
    /// of other sources; `tolerance_db` is the largest difference that counts as reproduced.
    pub(crate) fn compared(
        &self,
        (row, column): (&Heading, &Heading),
        text: &str,
        report: &Report,
        others: &[&Claim],
        tolerance_db: f64,
    ) -> ComparedCell {
        let place = self.place(row, column);
        let mut cell = ComparedCell { printed: text.into(), measured: None, verdict: None, others: Vec::new() };
        let (Some(quantity), Some(method)) = (place.quantity, place.method) else { return cell };
        // Other sources measured whole images.
        if quantity == Quantity::Psnr && place.variant.is_none() {
            cell.others = measured_by_others(&place, method, others);
        }
        let published = quantity.value(text).filter(|_| quantity.has_verdict());
        let found = place.find(method, report).and_then(|(group, row)| {
            let (column, _) = quantity.measured_as(place.mask).ok_or_else(|| why_unmeasured(quantity).to_owned())?;
            Ok((group, row, place.cell(group, row, column, report)?))
        });
        let (group, row, found) = match found {
            Ok(found) => found,
            Err(why) => {
                cell.measured = Some(Measured::Missing(why));
                cell.verdict = published.map(|_| (Verdict::NotMeasured, Vec::new()));
                return cell;
            }
        };
        let unit = quantity.measured_as(place.mask).map_or(1.0, |(_, unit)| unit);
        cell.measured = Some(match found.mean {
            None => Measured::Missing(found.reason.clone().unwrap_or_else(|| "not measured".into())),
            Some(value) => Measured::Value {
                value: value / unit,
                decimals: quantity.decimals(),
                row: row.name.clone(),
                scene: (!place.is_mean).then(|| place.scenes.first().cloned()).flatten(),
                variant: quantity.variant(),
            },
        });
        if let Some(published) = published {
            let mut differences = place.differences(group, row);
            if place.scenes.is_empty() {
                differences.push("the paper does not name its scenes".into());
            }
            let verdict = Verdict::new(published, &found, &differences, tolerance_db);
            cell.verdict = Some((verdict, differences));
        }
        cell
    }
}

fn why_unmeasured(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::Vbench => "VBench is not part of this project",
        _ => "not measured",
    }
}

impl Place<'_> {
    /// The differences of a measured row from the cell's protocol and from the method as published.
    fn differences(&self, group: &Group, row: &Row) -> Vec<String> {
        self.protocol.differences(&group.protocol, &group.judged_by, row.departures())
    }

    /// The group and row that hold measurements of the method on at least one of the scenes, or why there are none. Among
    /// several, those with the most scenes, and then with the fewest differences from the cell.
    fn find<'r>(&self, method: &str, report: &'r Report) -> Result<(&'r Group, &'r Row), String> {
        let is_row = |row: &Row| {
            let wants_whole = self.full || self.variant.is_none();
            let same_variant =
                row.variant.as_deref() == self.variant || (wants_whole && is_whole(row.variant.as_deref()));
            (row.method == method && same_variant) && self.scenes.iter().any(|scene| row.by_scene.contains_key(scene))
        };
        let rows = report.groups.iter().flat_map(|group| group.rows.iter().map(move |row| (group, row)));
        let order = |(group, row): &(&Group, &Row)| {
            let n_lacking = self.scenes.iter().filter(|scene| !row.by_scene.contains_key(*scene)).count();
            // A row of the variant itself takes precedence over a row of the whole method.
            (row.variant.as_deref() != self.variant, n_lacking, self.differences(group, row).len())
        };
        rows.filter(|(_, row)| is_row(row)).min_by_key(order).ok_or_else(|| self.absent(self.scenes, report))
    }

    /// The measured value over exactly the scenes of the cell, or why it is missing.
    fn cell(&self, group: &Group, row: &Row, column: Column, report: &Report) -> Result<Cell, String> {
        let wanted: BTreeSet<&String> = self.scenes.iter().collect();
        let is_over = |scenes: &[String]| scenes.iter().collect::<BTreeSet<_>>() == wanted;
        let part = group.parts.iter().position(|part| is_over(&part.scenes));
        let cells = match (self.is_mean, part) {
            (false, _) => self.scenes.first().and_then(|scene| row.by_scene.get(scene)),
            (true, _) if is_over(&group.scenes) => Some(&row.headline),
            (true, Some(part)) => row.parts.get(part),
            (true, None) => None,
        };
        if let Some(cell) = cells.and_then(|cells| cells.get(&column)) {
            return Ok(cell.clone());
        }
        let lacking: Vec<String> =
            self.scenes.iter().filter(|scene| !row.by_scene.contains_key(*scene)).cloned().collect();
        if !lacking.is_empty() {
            return Err(self.absent(&lacking, report));
        }
        Ok(common_scenes::mean_over(row, self.scenes.iter(), column).unwrap_or_default())
    }

    /// Why `scenes` were not measured.
    fn absent(&self, scenes: &[String], report: &Report) -> String {
        let n_missing = scenes.iter().filter(|scene| report.missing_data.contains_key(*scene)).count();
        let n_wanted = self.scenes.len();
        match (n_missing, n_wanted) {
            (0, _) => "not run".into(),
            (missing, wanted) if missing < wanted => format!("missing data ({missing} of {wanted} scenes)"),
            _ => "missing data".into(),
        }
    }
}

/// Sources and PSNR of third parties that measured the same method on the same scenes.
fn measured_by_others(place: &Place<'_>, method: &str, claims: &[&Claim]) -> Vec<(String, f64)> {
    let wanted: BTreeSet<&String> = place.scenes.iter().collect();
    let value = |claim: &Claim| {
        if place.is_mean {
            let mean = claim.mean.as_ref().filter(|mean| mean.scenes.iter().collect::<BTreeSet<_>>() == wanted)?;
            return mean.values.psnr;
        }
        claim.scenes.get(place.scenes.first()?)?.psnr
    };
    let is_other = |claim: &&&Claim| {
        claim.kind == Kind::ReMeasured && claim.method == method && claim.protocol.dataset == place.protocol.dataset
    };
    let source = |claim: &Claim| format!("{} ({})", claim.source, claim.protocol.line());
    claims.iter().filter(is_other).filter_map(|claim| Some((source(claim), value(claim)?))).collect()
}
