//! Parameters of the stage.

use serde::{Deserialize, Serialize};

/// How the report looks and when a published value counts as reproduced.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TableGenerationParams {
    /// The report's title.
    pub title: String,
    /// Whether the seconds of the curves are on a logarithmic axis.
    pub log_time: bool,
    /// Largest difference in dB at which a published PSNR counts as reproduced; independent groups that re-ran the
    /// 4DGaussians code on D-NeRF came within 0.3 dB of its paper on every scene.
    pub reproduced_within_db: f64,
}

impl Default for TableGenerationParams {
    fn default() -> Self {
        Self { title: "Results".into(), log_time: false, reproduced_within_db: 0.3 }
    }
}
