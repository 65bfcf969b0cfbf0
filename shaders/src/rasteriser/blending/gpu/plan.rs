//! The choice among the variants of the blending kernels.

use std::sync::Mutex;

use crate::gpu::{Gpu, lock};

/// The variants by which the backward pass of blending sums the gradients of a tile's pixels on a GPU. All give the
/// same gradients up to rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelSums {
    /// Subgroups reduce each splat's row by shuffles.
    InSubgroups,
    /// Rows are reduced in workgroup memory; the only variant without subgroups.
    InWorkgroups,
}

/// The variant that [`PixelSums::choose`] has set.
static CHOSEN: Mutex<Option<PixelSums>> = Mutex::new(None);

impl PixelSums {
    /// Every variant.
    pub const ALL: [Self; 2] = [Self::InSubgroups, Self::InWorkgroups];

    /// The default variant of an adapter.
    pub fn of(gpu: Gpu) -> Self {
        if gpu.subgroup_size().is_some() { Self::InSubgroups } else { Self::InWorkgroups }
    }

    /// Whether an adapter supports this variant: [`PixelSums::InSubgroups`] needs subgroups of a fixed size.
    pub fn is_possible(self, gpu: Gpu) -> bool {
        self == Self::InWorkgroups || gpu.subgroup_size().is_some()
    }

    /// Uses this variant in all later backward passes of this process, if possible; `None`: the adapter's default. For
    /// benchmarks that compare the variants.
    pub fn choose(way: Option<Self>) {
        *lock(&CHOSEN) = way;
    }
}

/// Choices that change no image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Plan {
    /// Whether pixels skip the entries that do not meet their cell of the tile.
    pub(crate) is_culled: bool,
    /// The subgroup size with which the backward pass sums over pixels; `None` if it sums in workgroup memory.
    pub(crate) subgroup: Option<u32>,
}

#[cfg(test)]
thread_local! {
    /// A test's change of the plan, per thread because tests run in parallel.
    static CHANGE: std::cell::Cell<Option<fn(&mut Plan)>> = const { std::cell::Cell::new(None) };
}

impl Plan {
    /// The fastest variant on an adapter.
    pub(super) fn of(gpu: Gpu) -> Self {
        let chosen = lock(&CHOSEN).filter(|way| way.is_possible(gpu));
        let sums = chosen.unwrap_or_else(|| PixelSums::of(gpu));
        let subgroup = gpu.subgroup_size().filter(|_| sums != PixelSums::InWorkgroups);
        #[cfg_attr(not(test), expect(unused_mut))]
        let mut plan = Self { is_culled: true, subgroup };
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

    /// Runs kernels with a changed plan.
    #[cfg(test)]
    pub(super) fn changed<R>(change: fn(&mut Self), run: impl FnOnce() -> R) -> R {
        CHANGE.set(Some(change));
        let result = run();
        CHANGE.set(None);
        result
    }
}
