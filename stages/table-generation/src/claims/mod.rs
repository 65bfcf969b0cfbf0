//! Published values: what a source prints, under which protocol, and whether our measurement reproduces it.

mod beside;
pub mod curves;
mod protocol;
#[cfg(test)]
mod tests;
mod verdict;

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context as _, ensure};
use serde::{Deserialize, Serialize};

pub use beside::{ClaimColumn, ClaimTable};
pub use protocol::ClaimProtocol;
pub use verdict::Verdict;

use crate::papers;

/// The claim files, by name.
const FILES: [(&str, &str); 3] = [
    ("dnerf_baselines.toml", include_str!("../../claims/dnerf_baselines.toml")),
    ("dnerf_independent.toml", include_str!("../../claims/dnerf_independent.toml")),
    ("other_data_sets.toml", include_str!("../../claims/other_data_sets.toml")),
];

/// What one table of one source prints about one method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Claim {
    /// The method's id here.
    pub method: String,
    /// What the source calls it.
    pub label: String,
    /// Who measured.
    pub kind: Kind,
    /// The table, as `Table 6 of Phys4DGS`.
    pub source: String,
    /// What a reader should know: hardware, disputes, printing errors.
    #[serde(default)]
    pub notes: Vec<String>,
    /// How the numbers came to be, as far as the source states it.
    pub protocol: ClaimProtocol,
    /// The printed mean.
    pub mean: Option<PublishedMean>,
    /// The printed values per scene.
    #[serde(default)]
    pub scenes: BTreeMap<String, Published>,
}

/// Who measured a published value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Printed by the method's authors, or copied by others without saying that they measured it.
    #[default]
    Quoted,
    /// Measured anew by somebody else than the method's authors.
    ReMeasured,
}

/// Printed figures; the variants of SSIM and LPIPS are as unknown as the source leaves them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Published {
    /// Mean over images, dB.
    pub psnr: Option<f64>,
    /// Of any variant.
    pub ssim: Option<f64>,
    /// Of any network and input range.
    pub lpips: Option<f64>,
    /// Minutes of training.
    pub train_min: Option<f64>,
    /// Frames per second, by the source's own definition.
    pub fps: Option<f64>,
    /// Thousands of Gaussians.
    pub gaussians_k: Option<f64>,
}

/// A printed mean and the scenes that it is over.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedMean {
    /// The scenes.
    pub scenes: BTreeSet<String>,
    /// The means.
    pub values: Published,
}

/// Every claim that is compiled in: those of claim files, and what the papers' tables say about methods of this project.
pub fn built_in_claims() -> anyhow::Result<Vec<Claim>> {
    let mut claims = Vec::new();
    for (name, text) in FILES {
        claims.extend(parse(text).with_context(|| format!("claim file {name}"))?);
    }
    for paper in papers::built_in()? {
        claims.extend(paper.claims());
    }
    Ok(claims)
}

/// Reads and checks one claim file.
fn parse(text: &str) -> anyhow::Result<Vec<Claim>> {
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct File {
        claim: Vec<Claim>,
    }
    let file: File = toml::from_str(text)?;
    for claim in &file.claim {
        let printed = claim.scenes.values().chain(claim.mean.as_ref().map(|mean| &mean.values));
        ensure!(printed.clone().next().is_some(), "{} prints nothing about {}", claim.source, claim.label);
        for (name, value) in printed.flat_map(Published::named) {
            ensure!(value.is_finite() && value > 0.0, "{name} of {} in {} is {value}", claim.label, claim.source);
        }
    }
    Ok(file.claim)
}

impl Claim {
    /// Whether the claim is about this method on any of these scenes of a data set.
    pub fn is_about(&self, method: &str, dataset: &str, scenes: &[String]) -> bool {
        let printed = self.scenes.keys().chain(self.mean.iter().flat_map(|mean| &mean.scenes));
        self.method == method && self.protocol.is_of(dataset) && printed.into_iter().any(|scene| scenes.contains(scene))
    }
}

impl Published {
    /// The printed figures by name, with the unit that tables show.
    pub fn named(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let Self { psnr, ssim, lpips, train_min, fps, gaussians_k } = *self;
        let figures = [
            ("PSNR", psnr),
            ("SSIM", ssim),
            ("LPIPS", lpips),
            ("minutes", train_min),
            ("FPS", fps),
            ("thousand Gaussians", gaussians_k),
        ];
        figures.into_iter().filter_map(|(name, value)| Some((name, value?)))
    }
}
