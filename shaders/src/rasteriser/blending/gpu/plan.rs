//! The choice among the variants of the blending kernels.

use std::sync::Mutex;

use crate::gpu::{Gpu, lock};

/// The largest subgroup size for which each invocation handles one splat and pixels stream past it. A subgroup visits
/// the pixels of every cell that any of its splats meets: the larger it is, the more visits are wasted (measurements:
/// ARCHITECTURE, "Backward blending depends on the subgroup size").
const LARGEST_BY_SPLATS: u32 = 8;

/// The variants by which the backward pass of blending sums the gradients of a tile's pixels on a GPU. All give the
/// same gradients up to rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelSums {
    /// Each invocation handles one pixel, and subgroups reduce each splat's row by shuffles.
    InSubgroups,
    /// Each invocation handles one pixel, and rows are reduced in workgroup memory; the only variant without subgroups.
    InWorkgroups,
    /// Each invocation handles one splat, and the tile's pixels stream through its subgroup.
    BySplats,
}

/// The variant that [`PixelSums::choose`] has set.
static CHOSEN: Mutex<Option<PixelSums>> = Mutex::new(None);

impl PixelSums {
    /// Every way.
    pub const ALL: [Self; 3] = [Self::InSubgroups, Self::InWorkgroups, Self::BySplats];

    /// The default variant of an adapter.
    pub fn of(gpu: Gpu) -> Self {
        match gpu.subgroup_size() {
            None => Self::InWorkgroups,
            Some(size) if size <= LARGEST_BY_SPLATS => Self::BySplats,
            Some(_) => Self::InSubgroups,
        }
    }

    /// Whether an adapter supports this variant: all but [`PixelSums::InWorkgroups`] need subgroups of a fixed size.
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
    /// Whether an invocation of a subgroup handles a splat, not a pixel, in the backward pass, if rows are short enough.
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
        let chosen = lock(&CHOSEN).filter(|way| way.is_possible(gpu));
        let sums = chosen.unwrap_or_else(|| PixelSums::of(gpu));
        let subgroup = gpu.subgroup_size().filter(|_| sums != PixelSums::InWorkgroups);
        #[cfg_attr(not(test), expect(unused_mut))]
        let mut plan = Self { is_culled: true, subgroup, is_by_splats: sums == PixelSums::BySplats };
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
