//! Published values beside the rows that we measured.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::{Claim, Verdict};
use crate::report::{Cell, Group, Row};
use crate::{Column, TableGenerationParams};

/// Published values beside one measured row: a line per scene, a column per source.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClaimTable {
    /// The measured row.
    pub row: String,
    /// What a line is about: a scene, or a mean; means last.
    pub lines: Vec<String>,
    /// Our PSNR per line.
    pub measured: Vec<Cell>,
    /// One per source.
    pub columns: Vec<ClaimColumn>,
}

/// One source beside one measured row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClaimColumn {
    /// The claim.
    pub claim: Claim,
    /// Why its protocol is not ours; empty where the two agree.
    pub differences: Vec<String>,
    /// Published PSNR and verdict per line, where the source prints one.
    pub entries: Vec<Option<(f64, Verdict)>>,
}

/// A line of a table of claims: the scenes that it is a mean over, and our figure.
struct Line<'a> {
    name: String,
    scenes: BTreeSet<&'a String>,
    is_mean: bool,
    measured: Cell,
}

impl ClaimTable {
    /// Looks up what was published about the method of `row` on the scenes of `group`. Published means stand beside the
    /// mean over the same scenes; a source's mean over other scenes stands beside that over all, and has no verdict.
    pub fn new(row: &Row, group: &Group, claims: &[Claim], params: &TableGenerationParams) -> Option<Self> {
        // A variant is not what anybody published under the method's name.
        if row.variant.is_some() {
            return None;
        }
        let lines = lines(row, group);
        let about = |claim: &&Claim| claim.is_about(&row.method, &group.protocol.dataset, &group.scenes);
        let column = |claim: &Claim| {
            let differences = claim.protocol.differences(group, row);
            let entries: Vec<_> =
                lines.iter().map(|line| line.entry(claim, &lines, &differences, params.reproduced_within_db)).collect();
            let prints_any = entries.iter().any(Option::is_some);
            prints_any.then(|| ClaimColumn { claim: claim.clone(), differences, entries })
        };
        let columns: Vec<_> = claims.iter().filter(about).filter_map(column).collect();
        let (names, measured) = lines.into_iter().map(|line| (line.name, line.measured)).unzip();
        (!columns.is_empty()).then(|| Self { row: row.name.clone(), lines: names, measured, columns })
    }
}

fn lines<'a>(row: &Row, group: &'a Group) -> Vec<Line<'a>> {
    let psnr = |cells: Option<&crate::report::Cells>| cells.and_then(|cells| cells.get(&Column::PSNR)).cloned();
    let scenes = group.scenes.iter().map(|scene| Line {
        name: scene.clone(),
        scenes: [scene].into(),
        is_mean: false,
        measured: psnr(row.by_scene.get(scene)).unwrap_or_default(),
    });
    let mean = |name: String, scenes: &'a [String], cells| Line {
        name,
        scenes: scenes.iter().collect(),
        is_mean: true,
        measured: psnr(cells).unwrap_or_default(),
    };
    let whole = mean(format!("mean of {}", group.scenes.len()), &group.scenes, Some(&row.headline));
    let parts =
        group.parts.iter().zip(&row.parts).map(|(part, cells)| {
            mean(format!("mean of {} ({})", part.scenes.len(), part.name), &part.scenes, Some(cells))
        });
    scenes.chain([whole]).chain(parts).collect()
}

impl Line<'_> {
    fn entry(
        &self,
        claim: &Claim,
        lines: &[Line<'_>],
        differences: &[String],
        tolerance_db: f64,
    ) -> Option<(f64, Verdict)> {
        if !self.is_mean {
            let published = claim.scenes.get(*self.scenes.first()?)?.psnr?;
            return Some((published, Verdict::new(published, &self.measured, differences, tolerance_db)));
        }
        let mean = claim.mean.as_ref()?;
        let published = mean.values.psnr?;
        let theirs: BTreeSet<&String> = mean.scenes.iter().collect();
        if theirs == self.scenes {
            return Some((published, Verdict::new(published, &self.measured, differences, tolerance_db)));
        }
        let has_its_own = lines.iter().any(|line| line.is_mean && line.scenes == theirs);
        let is_whole = lines.iter().find(|line| line.is_mean).is_some_and(|whole| whole.scenes == self.scenes);
        (is_whole && !has_its_own).then_some((published, Verdict::NotComparable))
    }
}
