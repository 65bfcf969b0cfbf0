//! How the kernels run.

use crate::gpu::Gpu;

/// Choices that change no image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Whether pixels skip the entries that do not meet their cell of the tile.
    pub is_culled: bool,
    /// The size of the subgroups in which the backward pass adds up pixels; `None` if it does so in workgroup memory.
    pub subgroup: Option<u32>,
}

#[cfg(test)]
thread_local! {
    /// What a test changes, on its own thread as tests run side by side.
    static CHANGE: std::cell::Cell<Option<fn(&mut Plan)>> = const { std::cell::Cell::new(None) };
}

impl Plan {
    /// What is fastest on an adapter.
    pub fn of(gpu: Gpu) -> Self {
        #[cfg_attr(not(test), expect(unused_mut))]
        let mut plan = Self { is_culled: true, subgroup: gpu.subgroup_size() };
        #[cfg(test)]
        if let Some(change) = CHANGE.get() {
            change(&mut plan);
        }
        plan
    }

    /// What a kernel that stages so many entries at once is specialised for.
    pub fn staging(self, batch: u32) -> [(&'static str, u32); 2] {
        [("CULLED", u32::from(self.is_culled)), ("BATCH", batch)]
    }

    /// Runs kernels by a changed plan.
    #[cfg(test)]
    pub fn changed<R>(change: fn(&mut Self), run: impl FnOnce() -> R) -> R {
        CHANGE.set(Some(change));
        let result = run();
        CHANGE.set(None);
        result
    }
}
