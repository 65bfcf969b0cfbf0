//! The choice among the variants of the blending kernels.

use crate::gpu::Gpu;

/// The largest subgroup size for which an invocation is a splat and pixels stream past it. A subgroup visits the pixels of
/// every cell that any of its splats meets: the larger it is, the more visits are wasted (measurements: ARCHITECTURE,
/// "Backward blending depends on the subgroup size").
const LARGEST_BY_SPLATS: u32 = 8;

/// Choices that change no image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Plan {
    /// Whether pixels skip the entries that do not meet their cell of the tile.
    pub(crate) is_culled: bool,
    /// The subgroup size with which the backward pass sums over pixels; `None` if it sums in workgroup memory.
    pub(crate) subgroup: Option<u32>,
    /// Whether an invocation of a subgroup is a splat and not a pixel in the backward pass, where rows are short enough.
    pub(crate) is_by_splats: bool,
}

#[cfg(test)]
thread_local! {
    /// A test's change of the plan, per thread because tests run in parallel.
    static CHANGE: std::cell::Cell<Option<fn(&mut Plan)>> = const { std::cell::Cell::new(None) };
}

impl Plan {
    /// The fastest variant on an adapter.
    pub(super) fn of(gpu: Gpu) -> Self {
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

    /// The specialisation of a kernel that stages `batch` entries at once.
    pub(crate) fn staging(self, batch: u32) -> [(&'static str, u32); 2] {
        [("CULLED", u32::from(self.is_culled)), ("BATCH", batch)]
    }

    /// Runs kernels by a changed plan.
    #[cfg(test)]
    pub(super) fn changed<R>(change: fn(&mut Self), run: impl FnOnce() -> R) -> R {
        CHANGE.set(Some(change));
        let result = run();
        CHANGE.set(None);
        result
    }
}
