//! Published values next to one measured row, as data.

use serde::{Deserialize, Serialize};

use super::claim::Claim;
use super::verdict::Verdict;
use crate::cell::Cell;

/// Published values next to one measured row: a line per scene, a column per source.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ClaimTable {
    /// The measured row.
    pub row: String,
    /// Subject of each line: a scene, or a mean; means come last.
    pub lines: Vec<String>,
    /// The measured PSNR per line.
    pub measured: Vec<Cell>,
    /// One column per source.
    pub columns: Vec<ClaimColumn>,
}

/// One source next to one measured row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ClaimColumn {
    /// The claim.
    pub claim: Claim,
    /// Differences between the protocols; empty where they agree.
    pub differences: Vec<String>,
    /// Published PSNR (dB) and verdict per line, where the source prints a value.
    pub entries: Vec<Option<(f64, Verdict)>>,
}
