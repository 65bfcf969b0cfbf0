//! Converts a paper's tables to claims about methods of this project.

use std::collections::{BTreeMap, BTreeSet};

use super::quantity::Quantity;
use super::table::{Heading, Paper, PaperTable};
use crate::claims::{Claim, Published, PublishedMean};

impl Paper {
    /// One claim per table, method and set of scenes of a mean. Variants that lack a part of the method are skipped.
    pub(crate) fn claims(&self) -> Vec<Claim> {
        self.tables.iter().flat_map(|table| table.claims(&self.name)).collect()
    }
}

impl PaperTable {
    fn claims(&self, paper: &str) -> Vec<Claim> {
        let mut claims: Vec<Claim> = Vec::new();
        for row in &self.rows {
            for (column, text) in self.columns.iter().zip(row.cells()) {
                let place = self.place(row, column);
                let (Some(method), Some(quantity)) = (place.method, place.quantity) else { continue };
                let Some(value) = quantity.value(text) else { continue };
                if (place.variant.is_some() && !place.full) || place.scenes.is_empty() {
                    continue;
                }
                let blank = Claim {
                    method: method.into(),
                    label: self.label(row, column),
                    kind: if row.method.is_some() { row.kind } else { column.kind },
                    source: format!("{} of {paper}", self.number),
                    notes: self.notes.iter().chain(&row.notes).chain(&column.notes).cloned().collect(),
                    protocol: place.protocol.clone(),
                    mean: None,
                    scenes: BTreeMap::new(),
                };
                let scenes: BTreeSet<String> = place.scenes.iter().cloned().collect();
                let mean_of = place.is_mean.then_some(&scenes);
                let claim = matching(&mut claims, blank, mean_of);
                let published = match (mean_of, place.scenes) {
                    (None, [scene, ..]) => claim.scenes.entry(scene.clone()).or_default(),
                    _ => {
                        let mean = PublishedMean { scenes: scenes.clone(), values: Published::default() };
                        &mut claim.mean.get_or_insert(mean).values
                    }
                };
                set(published, quantity, value);
            }
        }
        claims.retain(|claim| {
            let mean = claim.mean.as_ref().map(|mean| &mean.values);
            claim.scenes.values().chain(mean).any(|printed| printed.named().next().is_some())
        });
        claims
    }

    /// The table's name for the method: the label of the heading that names it.
    fn label(&self, row: &Heading, column: &Heading) -> String {
        if row.method.is_some() { row.label.clone() } else { column.label.clone() }
    }
}

/// The claim to extend: one of the same method and label under the same protocol whose mean is over the same scenes.
/// Appends `blank` if there is none.
fn matching<'a>(claims: &'a mut Vec<Claim>, blank: Claim, mean_of: Option<&BTreeSet<String>>) -> &'a mut Claim {
    let same = |claim: &Claim| {
        let mean_fits = match (&claim.mean, mean_of) {
            (Some(mean), Some(wanted)) => mean.scenes == *wanted,
            _ => true,
        };
        mean_fits && (&claim.method, &claim.label, &claim.protocol) == (&blank.method, &blank.label, &blank.protocol)
    };
    let at = claims.iter().position(same).unwrap_or_else(|| {
        claims.push(blank);
        claims.len() - 1
    });
    &mut claims[at]
}

fn set(published: &mut Published, quantity: Quantity, value: f64) {
    let field = match quantity {
        Quantity::Psnr => &mut published.psnr,
        Quantity::Ssim => &mut published.ssim,
        Quantity::Lpips => &mut published.lpips,
        Quantity::TrainMin => &mut published.train_min,
        Quantity::Fps => &mut published.fps,
        Quantity::GaussiansK => &mut published.gaussians_k,
        _ => return,
    };
    *field = Some(value);
}
