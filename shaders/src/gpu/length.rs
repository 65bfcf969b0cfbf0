//! Numbers of elements that only the GPU knows, and dispatches over so many: nobody waits to learn them.

use super::{Binding, Gpu, GpuArray, Kernel, uniforms};

const LENGTH: Kernel = Kernel { name: "length", text: &[include_str!("length.wgsl")] };

uniforms! {
    struct PlaceBlock as "Place" { at: u32, capacity: u32 }
}

/// How many elements of an array with room for more are used.
#[derive(Debug)]
pub struct Length {
    /// Used, wanted, and the two dispatches.
    array: GpuArray,
}

/// Workgroups of a launch.
#[derive(Clone, Copy)]
pub enum Groups<'a> {
    /// So many.
    Count(usize),
    /// As a kernel wrote them: three numbers from this element of the array on.
    Indirect(&'a GpuArray, usize),
}

impl From<usize> for Groups<'_> {
    fn from(count: usize) -> Self {
        Self::Count(count)
    }
}

impl Length {
    /// Elements per workgroup of [`Length::groups`] and of [`Length::blocks`].
    pub const GROUP: usize = 256;
    pub const BLOCK: usize = 1024;

    /// As many as element `at` of `counts` says, and no more than there is room for.
    pub fn of(gpu: Gpu, counts: &GpuArray, at: usize, capacity: usize) -> Self {
        let array = GpuArray::new(gpu, 8);
        let constants = PlaceBlock { at: at as u32, capacity: capacity as u32 };
        LENGTH.launch(gpu, &[], &constants, &[Binding::Read(counts), Binding::Write(&array)], 1);
        Self { array }
    }

    /// Its first element is the number used, its second the number wanted.
    pub fn array(&self) -> &GpuArray {
        &self.array
    }

    /// One invocation per element, [`Length::GROUP`] to a workgroup, and one workgroup at least.
    pub fn groups(&self) -> Groups<'_> {
        Groups::Indirect(&self.array, 2)
    }

    /// [`Length::BLOCK`] elements per workgroup.
    pub fn blocks(&self) -> Groups<'_> {
        Groups::Indirect(&self.array, 5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::tests::test_gpu;

    #[test]
    fn the_kernel_is_valid() {
        crate::gpu::layout::assert_valid::<PlaceBlock>(&LENGTH, &[]);
    }

    #[test]
    fn lengths_stop_at_the_capacity_and_dispatches_are_folded() {
        let Some(gpu) = test_gpu() else { return };
        let read = |count: u32, capacity| {
            let mut out = [0_u32; 8];
            Length::of(gpu, &GpuArray::upload(gpu, &[9, count]), 1, capacity).array.read_into(&mut out);
            out
        };
        assert_eq!(read(0, 10), [0, 0, 1, 1, 1, 1, 1, 1]);
        assert_eq!(read(1025, 4000), [1025, 1025, 5, 1, 1, 2, 1, 1]);
        assert_eq!(read(5000, 4000), [4000, 5000, 16, 1, 1, 4, 1, 1]);
        assert_eq!(read(65_536 * 256, 1 << 25), [65_536 * 256, 65_536 * 256, 65_535, 2, 1, 16_384, 1, 1]);
    }
}
