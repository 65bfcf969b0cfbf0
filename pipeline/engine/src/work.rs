//! The expected work of a job, as its stage states it while planning.

use serde::{Deserialize, Serialize};

use crate::PlanContext;

/// The expected work of a job. Never part of a key: it only predicts the job's time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Work {
    /// Jobs of one stage and kind take similar times for similar amounts, e.g. the trainings of one method.
    pub kind: String,
    /// Two amounts that the time grows with, in the stage's own units, weighted to cost about the same per unit; e.g.
    /// pixels that are drawn, and 4 × Gaussians that are moved. Not negative, and not both 0.
    pub amounts: [f64; 2],
}

impl Work {
    /// Work that one amount describes; `None` unless the amount is positive.
    pub fn of(kind: impl Into<String>, amount: f64) -> Option<Self> {
        Self::of_both(kind, [amount, 0.0])
    }

    /// Work that two amounts describe; `None` unless they are finite and one is positive.
    pub fn of_both(kind: impl Into<String>, amounts: [f64; 2]) -> Option<Self> {
        let is_usable = amounts.iter().all(|amount| amount.is_finite() && *amount >= 0.0);
        (is_usable && amounts.iter().sum::<f64>() > 0.0).then(|| Self { kind: kind.into(), amounts })
    }

    /// Work that grows with the number of artifacts that the job reads.
    pub fn of_inputs(context: &PlanContext<'_>) -> Option<Self> {
        let count: usize = context.inputs.values().map(Vec::len).sum();
        Self::of("", count.max(1) as f64)
    }
}
