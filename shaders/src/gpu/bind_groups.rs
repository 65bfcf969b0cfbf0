//! Bind groups, kept for later launches of the same kernel on the same buffers.
//!
//! Creating and destroying a bind group takes almost half of the host's time for a launch, and every step of a training
//! binds the buffers of earlier steps, because the [`pool`](super::pool) hands them out in a fixed order.

use std::collections::HashMap;

/// Entries used most recently; at most as many older ones are kept, too. The method with the most launches has 430 per step,
/// and some of their arrays alternate between several buffers.
const MOST_RECENT: usize = 4096;

/// A cache of bind groups. A key is the id of the pipeline, followed by `Binding::identity` of every array.
pub(super) struct BindGroups<G = wgpu::BindGroup> {
    recent: HashMap<Box<[u64]>, G>,
    /// Entries that have not been used since `recent` was last full.
    older: HashMap<Box<[u64]>, G>,
    /// Scratch memory for the key of a lookup, so that a hit allocates nothing.
    key: Vec<u64>,
}

impl<G> Default for BindGroups<G> {
    fn default() -> Self {
        Self { recent: HashMap::new(), older: HashMap::new(), key: Vec::new() }
    }
}

impl<G: Clone> BindGroups<G> {
    /// The kept bind group with this key, or a new one.
    pub(super) fn of(&mut self, key: impl IntoIterator<Item = u64>, create: impl FnOnce() -> G) -> G {
        self.key.clear();
        self.key.extend(key);
        if let Some(group) = self.recent.get(&self.key[..]) {
            return group.clone();
        }
        let group = self.older.remove(&self.key[..]).unwrap_or_else(create);
        if self.recent.len() == MOST_RECENT {
            self.older = std::mem::take(&mut self.recent);
        }
        self.recent.insert(self.key.as_slice().into(), group.clone());
        group
    }

    /// Drops all bind groups, because each keeps the buffers that it binds alive.
    pub(super) fn clear(&mut self) {
        self.recent.clear();
        self.older.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bind_group_in_use_is_created_once_and_an_unused_one_is_released() {
        let mut groups = BindGroups::default();
        let mut created = 0;
        let mut use_one = |key: u64| {
            groups.of([key, 7], || {
                created += 1;
                created
            })
        };
        let first = use_one(0);
        for other in 1..=3 * MOST_RECENT as u64 {
            use_one(other);
            assert_eq!(use_one(0), first, "after {other} others");
        }
        // Of the others, the last ones are kept.
        assert_eq!(use_one(3 * MOST_RECENT as u64), 1 + 3 * MOST_RECENT);
        assert_eq!(use_one(1), 2 + 3 * MOST_RECENT);
        groups.clear();
        assert_eq!(groups.of([0, 7], || 0), 0);
    }
}
