//! The outcome of a metric.

use serde::{Deserialize, Serialize};

/// The outcome of a metric: a finite number, or the reason why it is undefined.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Score {
    /// A finite number.
    Value(f64),
    /// The metric is undefined for this input.
    Undefined {
        /// The reason, e.g. `image smaller than 161 px`.
        undefined: String,
    },
}

impl Score {
    /// An undefined score with its reason.
    pub fn undefined(reason: impl Into<String>) -> Self {
        Self::Undefined { undefined: reason.into() }
    }

    /// The number, if there is one.
    pub fn value(&self) -> Option<f64> {
        match self {
            Self::Value(value) => Some(*value),
            Self::Undefined { .. } => None,
        }
    }
}
