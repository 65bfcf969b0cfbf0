//! Published values: what a source prints, under which protocol, and whether our measurement reproduces it.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Context as _, ensure};
use serde::{Deserialize, Serialize};

use crate::report::{Cell, Group, Row};
use crate::{Column, TableGenerationParams};

/// The claim files, by name.
const FILES: [(&str, &str); 3] = [
    ("dnerf_baselines.toml", include_str!("../claims/dnerf_baselines.toml")),
    ("dnerf_papers.toml", include_str!("../claims/dnerf_papers.toml")),
    ("dnerf_independent.toml", include_str!("../claims/dnerf_independent.toml")),
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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Printed by the method's authors, or copied by others without saying that they measured it.
    Quoted,
    /// Measured anew by somebody else than the method's authors.
    ReMeasured,
}

/// A source's protocol; what it does not state is absent and never taken for granted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClaimProtocol {
    /// As [`scene::Protocol::dataset`].
    pub dataset: String,
    /// As [`scene::Protocol::split`].
    pub split: String,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// As [`scene::Protocol::background`].
    pub background: Option<String>,
    /// Which iterate was scored.
    pub checkpoint: Option<Checkpoint>,
    /// Whether saved 8-bit images or float renders were scored.
    pub levels: Option<Levels>,
}

/// Which iterate a source scores; ours is always the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Checkpoint {
    /// The last one.
    Last,
    /// The one with the best value on the test images.
    BestOnTest,
}

/// What a source scores; ours are always saved 8-bit images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Levels {
    /// 8-bit files.
    #[serde(rename = "8-bit")]
    Eight,
    /// Float renders, which score about 0.01 dB higher at 35 dB.
    #[serde(rename = "float")]
    Float,
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

/// What our measurement says about a published PSNR.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "verdict", rename_all = "kebab-case")]
pub enum Verdict {
    /// Within the allowed difference.
    Reproduced {
        /// Measured minus published, dB.
        delta_db: f64,
    },
    /// Measured below by more than that.
    Below {
        /// Measured minus published, dB.
        delta_db: f64,
    },
    /// Measured above by more than that.
    Above {
        /// Measured minus published, dB.
        delta_db: f64,
    },
    /// The protocols differ, or the source does not state its own.
    NotComparable,
    /// We have no number.
    NotMeasured,
}

/// Published values beside one measured row: a line per scene, a column per source.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClaimTable {
    /// The measured row.
    pub row: String,
    /// Our PSNR per line, in the order of [`ClaimTable::lines`].
    pub measured: Vec<Cell>,
    /// Scenes, and `mean` last.
    pub lines: Vec<String>,
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

/// Every claim that is compiled in.
pub fn built_in_claims() -> anyhow::Result<Vec<Claim>> {
    let mut claims = Vec::new();
    for (name, text) in FILES {
        claims.extend(parse(text).with_context(|| format!("claim file {name}"))?);
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

impl ClaimProtocol {
    /// One line, with what is not stated.
    pub fn line(&self) -> String {
        let Self { dataset, split, width, height, background, checkpoint, levels } = self;
        let background = background.as_ref().map_or("background not stated".into(), |b| format!("{b} background"));
        let checkpoint = match checkpoint {
            None => "checkpoint rule not stated",
            Some(Checkpoint::Last) => "last iterate",
            Some(Checkpoint::BestOnTest) => "best iterate on the test images",
        };
        let levels = match levels {
            None => "8 bit or float not stated",
            Some(Levels::Eight) => "8-bit images",
            Some(Levels::Float) => "float renders",
        };
        format!("{dataset} · {split} split · {width}×{height} · {background} · {checkpoint} · {levels}")
    }

    /// Everything in which this protocol differs from a group's, or leaves open whether it does.
    fn differences(&self, group: &Group) -> Vec<String> {
        let ours = &group.protocol;
        let mut differences = Vec::new();
        if self.split != ours.split {
            differences.push(format!("split {} there, {} here", self.split, ours.split));
        }
        if (self.width, self.height) != (ours.width, ours.height) {
            let Self { width, height, .. } = self;
            differences.push(format!("resolution {width}×{height} there, {}×{} here", ours.width, ours.height));
        }
        match &self.background {
            None => differences.push("background not stated".into()),
            Some(theirs) if *theirs != ours.background => {
                differences.push(format!("{theirs} background there, {} here", ours.background));
            }
            Some(_) => {}
        }
        match self.checkpoint {
            None => differences.push("checkpoint rule not stated".into()),
            Some(Checkpoint::BestOnTest) => differences.push("best iterate on the test images there, last here".into()),
            Some(Checkpoint::Last) => {}
        }
        match self.levels {
            None => differences.push("8 bit or float not stated".into()),
            Some(Levels::Float) => differences.push("float renders there, 8-bit images here".into()),
            Some(Levels::Eight) => {}
        }
        if !group.judged_by.starts_with("test images") {
            differences.push(format!("test images there, {} here", group.judged_by));
        }
        differences
    }
}

impl ClaimTable {
    /// Looks up what was published about the method of `row` on the scenes of `group`.
    pub fn new(row: &Row, group: &Group, claims: &[Claim], params: &TableGenerationParams) -> Option<Self> {
        let about = |claim: &&Claim| claim.method == row.method && claim.protocol.dataset == group.protocol.dataset;
        let measured_in = |scene: &String| row.by_scene.get(scene)?.get(&Column::PSNR).cloned();
        let mut measured: Vec<Cell> = group.scenes.iter().map(|scene| measured_in(scene).unwrap_or_default()).collect();
        measured.push(row.headline.get(&Column::PSNR).cloned().unwrap_or_default());
        let column = |claim: &Claim| {
            let differences = claim.protocol.differences(group);
            let verdict = |published: f64, cell: &Cell, same_set: bool| match cell.mean {
                _ if !differences.is_empty() || !same_set => Verdict::NotComparable,
                None => Verdict::NotMeasured,
                Some(measured) => Verdict::of(measured - published, params.reproduced_within_db),
            };
            let printed = |scene: &String| claim.scenes.get(scene)?.psnr;
            let mut entries: Vec<_> = group
                .scenes
                .iter()
                .zip(&measured)
                .map(|(scene, cell)| printed(scene).map(|psnr| (psnr, verdict(psnr, cell, true))))
                .collect();
            entries.push(claim.mean.as_ref().and_then(|mean| {
                let same_set = mean.scenes.iter().eq(group.scenes.iter().collect::<BTreeSet<_>>());
                mean.values.psnr.zip(measured.last()).map(|(psnr, cell)| (psnr, verdict(psnr, cell, same_set)))
            }));
            let prints_any = entries.iter().any(Option::is_some);
            prints_any.then(|| ClaimColumn { claim: claim.clone(), differences: differences.clone(), entries })
        };
        let columns: Vec<_> = claims.iter().filter(about).filter_map(column).collect();
        let lines = group.scenes.iter().cloned().chain([format!("mean of {}", group.scenes.len())]).collect();
        (!columns.is_empty()).then(|| Self { row: row.name.clone(), measured, lines, columns })
    }
}

impl Verdict {
    /// The verdict on a difference in dB.
    fn of(delta_db: f64, tolerance_db: f64) -> Self {
        // Published values have two decimals: a difference is decided on as many, so that 0.30 is within 0.3.
        let rounded = (delta_db * 100.0).round() / 100.0;
        if rounded.abs() <= tolerance_db {
            Self::Reproduced { delta_db }
        } else if delta_db < 0.0 {
            Self::Below { delta_db }
        } else {
            Self::Above { delta_db }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn printed_means_are_means_of_printed_scenes_unless_a_note_says_otherwise() {
        for claim in built_in_claims().expect("valid claim files") {
            let Some(mean) = &claim.mean else { continue };
            let psnr = |scene: &String| claim.scenes.get(scene).and_then(|values| values.psnr);
            let printed: Option<Vec<f64>> = mean.scenes.iter().map(psnr).collect();
            let (Some(printed), Some(mean_psnr)) = (printed, mean.values.psnr) else { continue };
            let difference = printed.iter().sum::<f64>() / printed.len() as f64 - mean_psnr;
            let explained = claim.notes.iter().any(|note| note.contains("mean"));
            assert!(difference.abs() <= 0.0101 || explained, "{} {}: {difference}", claim.source, claim.label);
        }
    }

    #[test]
    fn faulty_claim_files_are_refused() {
        let good = r#"[[claim]]
            method = "m"
            label = "M"
            kind = "quoted"
            source = "Table 1"
            protocol = { dataset = "d", split = "s", width = 8, height = 8 }
            scenes = { a = { psnr = 30.0 } }"#;
        assert_eq!(parse(good).expect("valid").len(), 1);
        let planted = [
            ("psnr = 30.0", "psnr = nan"),
            ("psnr = 30.0", "psnr = -1.0"),
            ("psnr = 30.0", "pnsr = 30.0"),
            ("quoted", "guessed"),
            ("scenes = { a = { psnr = 30.0 } }", ""),
            ("width = 8, ", ""),
        ];
        for (from, to) in planted {
            assert!(parse(&good.replace(from, to)).is_err(), "{to} was accepted");
        }
    }

    #[test]
    fn verdicts_are_decided_on_two_decimals() {
        assert!(matches!(Verdict::of(0.3, 0.3), Verdict::Reproduced { .. }));
        assert!(matches!(Verdict::of(-0.304, 0.3), Verdict::Reproduced { .. }));
        assert!(matches!(Verdict::of(-0.306, 0.3), Verdict::Below { .. }));
        assert!(matches!(Verdict::of(0.306, 0.3), Verdict::Above { .. }));
    }
}
