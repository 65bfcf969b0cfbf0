use std::collections::BTreeMap;
use std::time::Duration;

/// What one kind of operation has cost in one direction.
#[derive(Copy, Clone, Debug, Default, PartialEq)]
pub struct Cost {
    pub calls: u64,
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
    pub forward: Cost,
    pub backward: Cost,
}

/// Wall-clock seconds and calls per operation name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Profile {
    pub ops: BTreeMap<&'static str, OpCost>,
}

impl Profile {
    /// Adds the figures of another tape, so that a loop with one tape per iteration keeps one profile.
    pub fn merge(&mut self, other: &Profile) {
        for (name, cost) in &other.ops {
            let mine = self.ops.entry(name).or_default();
            mine.forward.merge(cost.forward);
            mine.backward.merge(cost.backward);
        }
    }

    pub(super) fn entry(&mut self, name: &'static str) -> &mut OpCost {
        self.ops.entry(name).or_default()
    }
}
