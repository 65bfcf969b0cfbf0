//! How the kernels run.

use crate::gpu::Gpu;

/// The largest subgroups of splats past which pixels stream. A bucket visits the pixels of every cell that one of its splats
/// meets: the larger it is, the more of them the others visit in vain (figures: ARCHITECTURE, "A splat or a pixel per
/// invocation").
const LARGEST_BY_SPLATS: u32 = 8;

/// Choices that change no image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Whether pixels skip the entries that do not meet their cell of the tile.
    pub is_culled: bool,
    /// The size of the subgroups in which the backward pass adds up pixels; `None` if it does so in workgroup memory.
    pub subgroup: Option<u32>,
    /// Whether an invocation of a subgroup is a splat and not a pixel in the backward pass, where rows are short enough.
    pub is_by_splats: bool,
}

#[cfg(test)]
thread_local! {
    /// What a test changes, on its own thread as tests run side by side.
    static CHANGE: std::cell::Cell<Option<fn(&mut Plan)>> = const { std::cell::Cell::new(None) };
}

impl Plan {
    /// What is fastest on an adapter.
    pub fn of(gpu: Gpu) -> Self {
        let subgroup = gpu.subgroup_size();
        let is_by_splats = subgroup.is_some_and(|size| size <= LARGEST_BY_SPLATS);
        #[cfg_attr(not(test), expect(unused_mut))]
        let mut plan = Self { is_culled: true, subgroup, is_by_splats };
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
