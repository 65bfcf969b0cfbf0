//! Normalisation of time: [`TimeMap`] is the only place where it happens.

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Maps the seconds of a capture to the unit interval that models use.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TimeMap {
    /// The time that maps to 0, in seconds.
    pub start_secs: f64,
    /// The time that maps to 1, in seconds; equal to `start_secs` if the capture has one instant.
    pub end_secs: f64,
    /// Duration of one frame in seconds, for velocities and unit time steps.
    pub frame_secs: f64,
}

impl TimeMap {
    /// Maps seconds to [0, 1], extrapolating outside the capture; 0 if the capture has one instant.
    pub fn normalized(&self, time_secs: f64) -> f64 {
        let duration_secs = self.end_secs - self.start_secs;
        if duration_secs > 0.0 { (time_secs - self.start_secs) / duration_secs } else { 0.0 }
    }

    /// Checks that all values and the duration are finite, that the times are ordered, and that the frame duration is
    /// positive.
    pub fn check(&self) -> Result<()> {
        let Self { start_secs, end_secs, frame_secs } = *self;
        let is_ordered = end_secs >= start_secs && frame_secs > 0.0;
        // A finite difference implies finite times.
        if !(is_ordered && (end_secs - start_secs).is_finite() && frame_secs.is_finite()) {
            return Err(Error::new(format!(
                "times from {start_secs:e} s to {end_secs:e} s with {frame_secs:e} s per frame are not ordered and finite"
            )));
        }
        Ok(())
    }
}
