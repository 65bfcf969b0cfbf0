//! Claims: the values that one table of one source prints about one method.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::ensure;
use serde::{Deserialize, Serialize};

use super::protocol::ClaimProtocol;

/// The values that one table of one source prints about one method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Claim {
    /// The method's id in this project.
    pub method: String,
    /// The source's name for the method.
    pub label: String,
    /// Who measured the values.
    pub kind: Kind,
    /// The table, e.g. `Table 6 of Phys4DGS`.
    pub source: String,
    /// Remarks: hardware, disputes, printing errors.
    #[serde(default)]
    pub notes: Vec<String>,
    /// The protocol, as far as the source states it.
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
pub(crate) enum Kind {
    /// Printed by the method's authors, or copied by others who do not claim to have measured it.
    #[default]
    Quoted,
    /// Measured again by a group other than the method's authors.
    ReMeasured,
}

/// Printed values. The variants of SSIM and LPIPS are those of the source, which often does not state them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct Published {
    /// PSNR in dB, mean over images.
    pub psnr: Option<f64>,
    /// SSIM of any variant.
    pub ssim: Option<f64>,
    /// LPIPS of any network and input range.
    pub lpips: Option<f64>,
    /// Minutes of training.
    pub train_min: Option<f64>,
    /// Frames per second, by the source's own definition.
    pub fps: Option<f64>,
    /// Thousands of Gaussians.
    pub gaussians_k: Option<f64>,
}

/// A printed mean with the scenes that it covers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PublishedMean {
    /// The scenes.
    pub scenes: BTreeSet<String>,
    /// The mean values.
    pub values: Published,
}

/// Parses and checks one file of claims.
pub(crate) fn parse(text: &str) -> anyhow::Result<Vec<Claim>> {
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
    /// Whether the claim is about this method on at least one of these scenes of a data set.
    pub(crate) fn is_about(&self, method: &str, dataset: &str, scenes: &[String]) -> bool {
        let printed = self.scenes.keys().chain(self.mean.iter().flat_map(|mean| &mean.scenes));
        self.method == method && self.protocol.is_of(dataset) && printed.into_iter().any(|scene| scenes.contains(scene))
    }
}

impl Published {
    /// The printed values with the names that tables show.
    pub(crate) fn named(&self) -> impl Iterator<Item = (&'static str, f64)> {
        let Self { psnr, ssim, lpips, train_min, fps, gaussians_k } = *self;
        let values = [
            ("PSNR", psnr),
            ("SSIM", ssim),
            ("LPIPS", lpips),
            ("minutes", train_min),
            ("FPS", fps),
            ("thousand Gaussians", gaussians_k),
        ];
        values.into_iter().filter_map(|(name, value)| Some((name, value?)))
    }
}
