//! What a paper's tables say about methods of this project, as claims.

use std::collections::{BTreeMap, BTreeSet};

use super::{Figure, Heading, Paper, PaperTable};
use crate::claims::{Claim, Published, PublishedMean};

impl Paper {
    /// One claim per table, method and set of scenes that a mean is over. Variants that lack a part claim nothing.
    pub fn claims(&self) -> Vec<Claim> {
        self.tables.iter().flat_map(|table| table.claims(&self.name)).collect()
    }
}

impl PaperTable {
    fn claims(&self, paper: &str) -> Vec<Claim> {
        let mut claims: Vec<Claim> = Vec::new();
        for row in &self.rows {
            for (column, text) in self.columns.iter().zip(row.cells()) {
                let place = self.place(row, column);
                let (Some(method), Some(figure)) = (place.method, place.figure) else { continue };
                let Some(value) = figure.value(text) else { continue };
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
                set(published, figure, value);
            }
        }
        claims.retain(|claim| {
            let mean = claim.mean.as_ref().map(|mean| &mean.values);
            claim.scenes.values().chain(mean).any(|printed| printed.named().next().is_some())
        });
        claims
    }

    /// What the table calls the method.
    fn label(&self, row: &Heading, column: &Heading) -> String {
        if row.method.is_some() { row.label.clone() } else { column.label.clone() }
    }
}

/// The claim that `blank` continues: of the same method under the same protocol, unless its mean is over other scenes.
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

fn set(published: &mut Published, figure: Figure, value: f64) {
    let field = match figure {
        Figure::Psnr => &mut published.psnr,
        Figure::Ssim => &mut published.ssim,
        Figure::Lpips => &mut published.lpips,
        Figure::TrainMin => &mut published.train_min,
        Figure::Fps => &mut published.fps,
        Figure::GaussiansK => &mut published.gaussians_k,
        _ => return,
    };
    *field = Some(value);
}
