//! The result of a training that has paused at a rung of a search, which continues only the best trainings.

use std::path::Path;

use anyhow::Context as _;
use scene::Split;
use serde::{Deserialize, Serialize};

use crate::trainer::Report;

/// File name, in the folder of the checkpoints.
const FILE: &str = "rung.json";

/// The state of a paused training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rung {
    /// Finished steps.
    pub steps: u64,
    /// All steps of the training.
    pub total_steps: u64,
    /// Seconds of training so far, evaluation excluded.
    pub training_secs: f64,
    /// PSNR in dB at the newest point of the quality curve; `None` before the first point.
    pub psnr_val: Option<f64>,
    /// The split whose views the curve is measured on.
    pub curve_split: Split,
}

impl Rung {
    /// The state of a training with this report after (finished, all) steps.
    pub(super) fn of(report: &Report, (steps, total_steps): (u64, u64)) -> Self {
        Self {
            steps,
            total_steps,
            training_secs: report.training_secs,
            psnr_val: report.curve.last().map(|point| point.psnr_val),
            curve_split: report.curve_split,
        }
    }

    /// Writes the state next to the checkpoints in `dir`.
    pub(super) fn save(&self, dir: &Path) -> anyhow::Result<()> {
        let mut file = tempfile::NamedTempFile::new_in(dir)?;
        serde_json::to_writer(&mut file, self)?;
        file.persist(dir.join(FILE)).context("cannot write the state of the paused training")?;
        Ok(())
    }

    /// The state of a training whose checkpoints are in `dir`, if it has paused.
    pub fn load(dir: &Path) -> Option<Self> {
        serde_json::from_slice(&std::fs::read(dir.join(FILE)).ok()?).ok()
    }
}
