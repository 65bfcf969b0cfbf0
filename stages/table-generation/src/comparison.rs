//! Looks up published values and pairs them with measured rows.

use std::collections::BTreeSet;

use crate::cell::{Cell, Cells};
use crate::claims::{Claim, ClaimColumn, ClaimTable, Verdict};
use crate::collect::is_whole;
use crate::column::Column;
use crate::report::{Group, Row};

/// A line of a [`ClaimTable`]: a scene or a set of scenes, with the measured PSNR.
struct Line<'a> {
    name: String,
    scenes: BTreeSet<&'a String>,
    is_mean: bool,
    measured: Cell,
}

/// Published values about the method of `row` on the scenes of `group`; none where no claim matches.
///
/// A published mean is compared with the measured mean over the same scenes. Without such a mean it is printed next to
/// the mean over all scenes and has no verdict.
pub(crate) fn claim_table(row: &Row, group: &Group, claims: &[Claim], tolerance_db: f64) -> Option<ClaimTable> {
    // Published values describe the whole method, not a variant of it.
    if !is_whole(row.variant.as_deref()) {
        return None;
    }
    let lines = lines(row, group);
    let about = |claim: &&Claim| claim.is_about(&row.method, &group.protocol.dataset, &group.scenes);
    let column = |claim: &Claim| {
        let differences = claim.protocol.differences(&group.protocol, &group.judged_by, row.departures());
        let entries: Vec<_> = lines.iter().map(|line| line.entry(claim, &lines, &differences, tolerance_db)).collect();
        let prints_any = entries.iter().any(Option::is_some);
        prints_any.then(|| ClaimColumn { claim: claim.clone(), differences, entries })
    };
    let columns: Vec<_> = claims.iter().filter(about).filter_map(column).collect();
    let (names, measured) = lines.into_iter().map(|line| (line.name, line.measured)).unzip();
    (!columns.is_empty()).then(|| ClaimTable { row: row.name.clone(), lines: names, measured, columns })
}

fn lines<'a>(row: &Row, group: &'a Group) -> Vec<Line<'a>> {
    let psnr = |cells: Option<&Cells>| cells.and_then(|cells| cells.get(&Column::PSNR)).cloned();
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
        let judged = |published| (published, Verdict::new(published, &self.measured, differences, tolerance_db));
        if !self.is_mean {
            return claim.scenes.get(*self.scenes.first()?)?.psnr.map(judged);
        }
        let mean = claim.mean.as_ref()?;
        let published = mean.values.psnr?;
        let theirs: BTreeSet<&String> = mean.scenes.iter().collect();
        if theirs == self.scenes {
            return Some(judged(published));
        }
        let has_its_own = lines.iter().any(|line| line.is_mean && line.scenes == theirs);
        let is_whole = lines.iter().find(|line| line.is_mean).is_some_and(|whole| whole.scenes == self.scenes);
        (is_whole && !has_its_own).then_some((published, Verdict::NotComparable))
    }
}
