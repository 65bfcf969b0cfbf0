//! The time of a training by phase and activity.

use std::collections::BTreeMap;
use std::time::Instant;

use serde::{Deserialize, Serialize};

/// Name of the time before the first phase, in which data is read and tensors are initialised.
pub(crate) const PREPARATION: &str = "preparation";

/// The activity of evaluating losses, as far as the time is not charged to single ones.
pub(crate) const LOSSES: &str = "losses";

/// The activity of evaluating one loss.
pub(crate) fn of_loss(name: &str) -> String {
    format!("loss {name}")
}

/// Seconds spent per training phase and named activity; exactly one activity runs at any time.
#[derive(Debug)]
pub(crate) struct PhaseClock {
    phase: String,
    current: &'static str,
    since: Instant,
    reading: ClockReading,
}

/// Seconds by training phase and activity, as checkpoints and reports store them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ClockReading {
    /// Seconds by training phase, then by activity.
    pub secs: BTreeMap<String, BTreeMap<String, f64>>,
}

impl PhaseClock {
    /// Starts in an activity, before the first phase, with the seconds of an earlier reading.
    pub(crate) fn start(current: &'static str, earlier: ClockReading) -> Self {
        Self { phase: PREPARATION.into(), current, since: Instant::now(), reading: earlier }
    }

    /// Ends the running activity and starts another one.
    pub(crate) fn enter(&mut self, next: &'static str) {
        let now = Instant::now();
        self.reading.add(&self.phase, self.current, (now - self.since).as_secs_f64());
        (self.current, self.since) = (next, now);
    }

    /// Charges the time since the last change to losses that were evaluated together, in equal parts. Only the time of
    /// [`LOSSES`] is charged; that activity goes on.
    pub(crate) fn charge(&mut self, losses: &[&str]) {
        if self.current != LOSSES {
            return;
        }
        let now = Instant::now();
        let secs = (now - self.since).as_secs_f64() / losses.len() as f64;
        losses.iter().for_each(|loss| self.reading.add(&self.phase, &of_loss(loss), secs));
        self.since = now;
    }

    /// Counts all further time towards this phase of the training.
    pub(crate) fn enter_phase(&mut self, phase: &str) {
        self.enter(self.current);
        self.phase = phase.into();
    }

    /// Moves measured seconds from one activity to another (a render is split into its kernels afterwards).
    pub(crate) fn reassign(&mut self, from: &str, to: &str, secs: f64) {
        self.reading.add(&self.phase, from, -secs);
        self.reading.add(&self.phase, to, secs);
    }

    /// The seconds so far, including the running activity.
    pub(crate) fn reading(&mut self) -> ClockReading {
        self.enter(self.current);
        self.reading.clone()
    }
}

impl ClockReading {
    fn add(&mut self, phase: &str, activity: &str, secs: f64) {
        let known = self.secs.get_mut(phase).and_then(|activities| activities.get_mut(activity));
        match known {
            Some(known) => *known += secs,
            None => {
                self.secs.entry(phase.into()).or_default().insert(activity.into(), secs);
            }
        }
    }

    /// Total seconds without the given activities.
    pub(crate) fn total_except(&self, left_out: &[&str]) -> f64 {
        self.by_activity().iter().filter(|(name, _)| !left_out.contains(&name.as_str())).map(|(_, secs)| secs).sum()
    }

    /// Seconds by activity, over all phases.
    pub(crate) fn by_activity(&self) -> BTreeMap<String, f64> {
        let mut sums = BTreeMap::new();
        for (activity, secs) in self.secs.values().flatten() {
            *sums.entry(activity.clone()).or_default() += secs;
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn seconds_count_towards_the_running_phase_and_activity() {
        let earlier = ClockReading { secs: [("coarse".into(), [("render".into(), 2.0)].into())].into() };
        let mut clock = PhaseClock::start("load", earlier);
        clock.enter_phase("coarse");
        clock.enter("render");
        clock.reassign("render", "sort", 0.5);
        clock.enter_phase("fine");
        clock.enter("backward");
        let reading = clock.reading();
        let phases: Vec<&str> = reading.secs.keys().map(String::as_str).collect();
        assert_eq!(phases, ["coarse", "fine", PREPARATION]);
        assert_eq!(reading.secs["coarse"]["sort"], 0.5);
        assert!((1.5..1.6).contains(&reading.secs["coarse"]["render"]));
        let total: f64 = reading.by_activity().values().sum();
        assert!((total - reading.total_except(&[])).abs() <= 1e-12);
        assert!((total - 0.5 - reading.total_except(&["sort"])).abs() <= 1e-12);
    }

    #[test]
    fn losses_that_are_evaluated_together_share_their_time() {
        let mut clock = PhaseClock::start("motion", ClockReading::default());
        clock.charge(&["flow"]);
        clock.enter(LOSSES);
        std::thread::sleep(Duration::from_millis(2));
        clock.charge(&["smoothness", "distance"]);
        clock.charge(&["flow"]);
        let secs = clock.reading().by_activity();
        let [smoothness, distance, flow] = ["smoothness", "distance", "flow"].map(|loss| secs[&of_loss(loss)]);
        assert_eq!(smoothness, distance);
        assert!(smoothness >= 1e-3 && flow < smoothness, "motion and the time of others are not charged: {secs:?}");
    }
}
