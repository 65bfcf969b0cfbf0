//! How images came to be what they are: numbers share a column only if their protocols are equal.

use serde::{Deserialize, Serialize};

/// The part of the evaluation protocol that the data fixes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Protocol {
    /// The benchmark or source, as `dnerf` or `synthetic`.
    pub dataset: String,
    /// Which files became which split, as `official` or `every 8th`.
    pub split: String,
    /// Pixels per row of the evaluated images.
    pub width: u32,
    /// Rows of the evaluated images.
    pub height: u32,
    /// How images got that size: `none`, `area`, `lanczos3`, `analytic`.
    pub resize: String,
    /// What transparent pixels were composited on, once: `white`, `black` or `none` (opaque).
    pub background: String,
    /// How time values became [0, 1], as `file time / max` or `index / (count - 1)`.
    pub time: String,
}

impl Protocol {
    /// One line that names every field; two protocols are equal exactly when their lines are.
    pub fn line(&self) -> String {
        let Self { dataset, split, width, height, resize, background, time } = self;
        format!(
            "{dataset} · {split} split · {width}×{height} · resize {resize} · {background} background · time {time}"
        )
    }
}
