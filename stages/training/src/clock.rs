//! Where the time of a training goes.

use std::collections::BTreeMap;
use std::time::Instant;

use serde::{Deserialize, Serialize};

/// Seconds spent per named activity; exactly one runs at any time.
#[derive(Debug)]
pub struct PhaseClock {
    current: &'static str,
    since: Instant,
    secs: BTreeMap<String, f64>,
}

/// What a checkpoint keeps of a clock.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ClockReading {
    /// Seconds by activity.
    pub secs: BTreeMap<String, f64>,
}

impl PhaseClock {
    /// Starts in an activity, with the seconds of an earlier reading.
    pub fn start(current: &'static str, earlier: ClockReading) -> Self {
        Self { current, since: Instant::now(), secs: earlier.secs }
    }

    /// Ends the running activity and starts another one.
    pub fn enter(&mut self, next: &'static str) {
        let now = Instant::now();
        *self.secs.entry(self.current.into()).or_default() += (now - self.since).as_secs_f64();
        (self.current, self.since) = (next, now);
    }

    /// Moves measured seconds from one activity to another (a render is split into its kernels afterwards).
    pub fn reassign(&mut self, from: &'static str, to: &'static str, secs: f64) {
        *self.secs.entry(from.into()).or_default() -= secs;
        *self.secs.entry(to.into()).or_default() += secs;
    }

    /// Everything so far.
    pub fn reading(&mut self) -> ClockReading {
        self.enter(self.current);
        ClockReading { secs: self.secs.clone() }
    }
}

impl ClockReading {
    /// Seconds of everything but the given activities.
    pub fn total_except(&self, left_out: &[&str]) -> f64 {
        self.secs.iter().filter(|(name, _)| !left_out.contains(&name.as_str())).map(|(_, secs)| secs).sum()
    }
}
