use std::collections::BTreeMap;
use std::time::Duration;

/// The cost of one kind of operation in one direction.
#[derive(Copy, Clone, Debug, Default, PartialEq)]
pub struct Cost {
    /// The number of calls.
    pub calls: u64,
    /// Wall-clock seconds on the host.
    pub secs: f64,
}

impl Cost {
    pub(super) fn add(&mut self, elapsed: Duration) {
        self.calls += 1;
        self.secs += elapsed.as_secs_f64();
    }

    fn merge(&mut self, other: Cost) {
        self.calls += other.calls;
        self.secs += other.secs;
    }
}

/// Forward and backward cost of one kind of operation.
#[derive(Copy, Clone, Debug, Default, PartialEq)]
pub struct OpCost {
    /// The cost of the forward pass.
    pub forward: Cost,
    /// The cost of the backward pass.
    pub backward: Cost,
}

/// The profile of a tape: wall-clock seconds and calls per operation name, and events.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Profile {
    /// The cost of each kind of operation, by its name.
    pub ops: BTreeMap<&'static str, OpCost>,
    /// Counts of named events, e.g. values kept in range.
    pub events: BTreeMap<&'static str, u64>,
}

impl Profile {
    /// Adds the profile of another tape, so that a loop with one tape per iteration keeps one profile.
    pub fn merge(&mut self, other: &Profile) {
        for (name, cost) in &other.ops {
            let mine = self.ops.entry(name).or_default();
            mine.forward.merge(cost.forward);
            mine.backward.merge(cost.backward);
        }
        other.events.iter().for_each(|(what, count)| self.count(what, *count));
    }

    /// Adds to the count of an event.
    pub fn count(&mut self, what: &'static str, times: u64) {
        *self.events.entry(what).or_default() += times;
    }

    pub(super) fn entry(&mut self, name: &'static str) -> &mut OpCost {
        self.ops.entry(name).or_default()
    }
}
