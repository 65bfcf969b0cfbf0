//! Array lengths that only the GPU knows, and dispatches over that many elements without a readback.

use super::{Gpu, GpuArray};

/// The number of elements in use of an array with a larger capacity.
#[derive(Debug)]
pub(crate) struct Length {
    /// The used and the requested length, then the arguments of the two dispatches.
    array: GpuArray,
}

/// Workgroups of a launch.
#[derive(Clone, Copy)]
pub(crate) enum Groups<'a> {
    /// This number of workgroups.
    Count(usize),
    /// One invocation per element, for this many elements, in workgroups of the kernel's own size.
    Over(usize),
    /// An indirect dispatch: a kernel has written the three workgroup counts to the array, starting at this element.
    Indirect(&'a GpuArray, usize),
}

impl From<usize> for Groups<'_> {
    fn from(count: usize) -> Self {
        Self::Count(count)
    }
}

impl Groups<'_> {
    /// Whether no invocation runs, as far as the host knows.
    pub(super) fn is_empty(self) -> bool {
        matches!(self, Self::Count(0) | Self::Over(0))
    }
}

impl Length {
    /// Elements per workgroup of [`Length::blocks`].
    pub(crate) const BLOCK: usize = 1024;

    /// A length that a kernel will write.
    pub(crate) fn new(gpu: Gpu) -> Self {
        Self { array: GpuArray::new(gpu, 8) }
    }

    /// An array whose first element is the used length and whose second is the requested length.
    pub(crate) fn array(&self) -> &GpuArray {
        &self.array
    }

    /// One invocation per element, [`WORKGROUP_SIZE`](super::WORKGROUP_SIZE) to a workgroup, and one workgroup at least.
    pub(crate) fn groups(&self) -> Groups<'_> {
        Groups::Indirect(&self.array, 2)
    }

    /// [`Length::BLOCK`] elements per workgroup.
    pub(crate) fn blocks(&self) -> Groups<'_> {
        Groups::Indirect(&self.array, 5)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::gpu::tests::test_gpu;
    use crate::gpu::{Binding, Kernel, uniforms};

    uniforms! {
        struct WantedBlock as "Wanted" { count: u32, capacity: u32 }
    }

    const WRITE: Kernel = Kernel {
        name: "test of lengths",
        text: "#import gpu::length_write
             struct Wanted { count: u32, capacity: u32 }
             @group(0) @binding(0) var<uniform> wanted: Wanted;
             @group(0) @binding(1) var<storage, read_write> length: array<u32>;
             @compute @workgroup_size(1) fn main() { write_length(wanted.count, wanted.capacity); }",
    };

    /// A length written on a GPU.
    pub(crate) fn length_of(gpu: Gpu, count: usize, capacity: usize) -> Length {
        let length = Length::new(gpu);
        let constants = WantedBlock { count: count as u32, capacity: capacity as u32 };
        WRITE.launch(gpu, &[], &constants, &[Binding::Write(length.array())], 1);
        length
    }

    #[test]
    fn lengths_stop_at_the_capacity_and_dispatches_fold() {
        crate::gpu::layout_tests::assert_valid::<WantedBlock>(&WRITE, &[]);
        let Some(gpu) = test_gpu() else { return };
        let read = |count, capacity| {
            let mut out = [0_u32; 8];
            length_of(gpu, count, capacity).array.read_into(&mut out);
            out
        };
        assert_eq!(read(0, 10), [0, 0, 1, 1, 1, 1, 1, 1]);
        assert_eq!(read(1025, 4000), [1025, 1025, 5, 1, 1, 2, 1, 1]);
        assert_eq!(read(5000, 4000), [4000, 5000, 16, 1, 1, 4, 1, 1]);
        assert_eq!(read(65_536 * 256, 1 << 25), [65_536 * 256, 65_536 * 256, 65_535, 2, 1, 16_384, 1, 1]);
    }
}
