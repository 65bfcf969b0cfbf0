//! The one place where time is normalised.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Seconds of the capture to the unit interval that models see.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimeMap {
    /// Maps to 0.
    pub start_secs: f64,
    /// Maps to 1 (equal to `start_secs` when the capture has one instant).
    pub end_secs: f64,
    /// Duration of one frame, for velocities and unit time steps.
    pub frame_secs: f64,
}

impl TimeMap {
    /// Seconds to [0, 1] (extrapolated outside of the capture); 0 for a single instant.
    pub fn normalized(&self, time_secs: f64) -> f64 {
        let duration_secs = self.end_secs - self.start_secs;
        if duration_secs > 0.0 { (time_secs - self.start_secs) / duration_secs } else { 0.0 }
    }

    /// [0, 1] back to seconds.
    pub fn seconds(&self, time_normalized: f64) -> f64 {
        self.start_secs + time_normalized * (self.end_secs - self.start_secs)
    }

    /// Finite and ordered.
    pub fn check(&self) -> Result<()> {
        let ordered = self.end_secs >= self.start_secs && self.frame_secs > 0.0;
        if !(ordered && self.start_secs.is_finite() && self.end_secs.is_finite() && self.frame_secs.is_finite()) {
            return Err(Error::new(format!("time map is not ordered and finite: {self:?}")));
        }
        Ok(())
    }
}
