//! Printed cells beside what we measured and what others measured.

use std::collections::BTreeSet;

use super::{Figure, Heading, PaperTable, Place};
use crate::claims::{Claim, Kind, Verdict};
use crate::report::{Cell, Group, Report, Row};
use crate::statistics::mean;
use crate::{Column, TableGenerationParams};

/// A printed cell, and what stands beside it.
pub struct ComparedCell {
    /// As printed.
    pub printed: String,
    /// Ours; none where the method is not one of this project.
    pub measured: Option<Measured>,
    /// What ours says about the printed value, and why it says nothing.
    pub verdict: Option<(Verdict, Vec<String>)>,
    /// What others measured: the source and the value.
    pub others: Vec<(String, f64)>,
}

/// Our figure, or why there is none.
pub enum Measured {
    /// A number in the paper's unit.
    Value {
        /// The number.
        value: f64,
        /// Its decimals.
        decimals: usize,
        /// The row that it belongs to.
        row: String,
        /// The scene, where it is about one.
        scene: Option<String>,
    },
    /// Why there is none, as `missing data`.
    None(String),
}

impl PaperTable {
    /// What stands beside the cell where row and column meet, which prints `text`; `others` are claims of other sources.
    pub fn compared(
        &self,
        (row, column): (&Heading, &Heading),
        text: &str,
        report: &Report,
        others: &[&Claim],
        params: &TableGenerationParams,
    ) -> ComparedCell {
        let place = self.place(row, column);
        let mut cell = ComparedCell { printed: text.into(), measured: None, verdict: None, others: Vec::new() };
        let (Some(figure), Some(method)) = (place.figure, place.method) else { return cell };
        if figure.has_verdict() && place.variant.is_none() {
            cell.others = measured_by_others(&place, method, others);
        }
        let published = figure.value(text).filter(|_| figure.has_verdict());
        let found = place.find(method, report).and_then(|(group, row)| {
            let (column, _) = figure.measured_as().ok_or_else(|| not_a_figure_of_ours(figure).to_owned())?;
            Ok((group, row, place.cell(group, row, column, report)?))
        });
        let (group, row, found) = match found {
            Ok(found) => found,
            Err(why) => {
                cell.measured = Some(Measured::None(why));
                cell.verdict = published.map(|_| (Verdict::NotMeasured, Vec::new()));
                return cell;
            }
        };
        let unit = figure.measured_as().map_or(1.0, |(_, unit)| unit);
        cell.measured = Some(match found.mean {
            None => Measured::None(found.reason.clone().unwrap_or_else(|| "not measured".into())),
            Some(value) => Measured::Value {
                value: value / unit,
                decimals: figure.decimals(),
                row: row.name.clone(),
                scene: (!place.is_mean).then(|| place.scenes.first().cloned()).flatten(),
            },
        });
        if let Some(published) = published {
            let mut differences = place.protocol.differences(group, row);
            if place.scenes.is_empty() {
                differences.push("the paper does not name its scenes".into());
            }
            let verdict = Verdict::new(published, &found, &differences, params.reproduced_within_db);
            cell.verdict = Some((verdict, differences));
        }
        cell
    }
}

fn not_a_figure_of_ours(figure: Figure) -> &'static str {
    match figure {
        Figure::Vbench => "VBench is not part of this project",
        Figure::Lpips | Figure::MaskedLpips => "needs LPIPS weights",
        _ => "not measured",
    }
}

impl Place<'_> {
    /// The group and row that measured the method on these scenes.
    fn find<'r>(&self, method: &str, report: &'r Report) -> Result<(&'r Group, &'r Row), String> {
        let is_row = |row: &Row| {
            let same_variant = row.variant.as_deref() == self.variant || (self.full && row.variant.is_none());
            (row.method == method && same_variant) && self.scenes.iter().any(|scene| row.by_scene.contains_key(scene))
        };
        let rows = report.groups.iter().flat_map(|group| group.rows.iter().map(move |row| (group, row)));
        let mut found: Vec<_> = rows.filter(|(_, row)| is_row(row)).collect();
        // The variant itself comes before the whole method without one.
        found.sort_by_key(|(_, row)| row.variant.as_deref() != self.variant);
        found.first().copied().ok_or_else(|| self.absent(self.scenes, report))
    }

    /// Our figure over exactly the scenes of the cell.
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
        let values = self.scenes.iter().filter_map(|scene| row.by_scene[scene].get(&column));
        let means: Option<Vec<f64>> = values.clone().map(|cell| cell.mean).collect();
        let reason = values.filter_map(|cell| cell.reason.clone()).next();
        Ok(Cell { mean: means.as_deref().and_then(mean), reason, ..Cell::default() })
    }

    /// Why scenes are not there.
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

/// What others than the authors measured of the same method on the same scenes.
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
    let told = |claim: &Claim| format!("{} ({})", claim.source, claim.protocol.line());
    claims.iter().filter(is_other).filter_map(|claim| Some((told(claim), value(claim)?))).collect()
}
