//! Bindings of a launch: whole arrays or slices of them.

use super::{Gpu, GpuArray};

/// A part of an array begins at a multiple of this many elements: 256 bytes are the coarsest alignment of all adapters.
pub(crate) const ALIGNMENT: usize = 64;

/// How a kernel accesses an array.
#[derive(Clone, Copy)]
pub(crate) enum Binding<'a> {
    Read(&'a GpuArray),
    Write(&'a GpuArray),
    ReadPart(Part<'a>),
    WritePart(Part<'a>),
}

/// A contiguous slice of an array; index 0 in the kernel is the first element of the slice.
#[derive(Clone, Copy)]
pub(crate) struct Part<'a> {
    array: &'a GpuArray,
    first: usize,
    len: usize,
}

impl<'a> Part<'a> {
    /// The slice of `len` elements from `first` on, a multiple of [`ALIGNMENT`].
    pub(crate) fn new(array: &'a GpuArray, first: usize, len: usize) -> Self {
        assert!(first.is_multiple_of(ALIGNMENT), "a part that begins at element {first}");
        assert!(first + len <= array.len(), "{len} elements from {first} on of {}", array.len());
        Self { array, first, len }
    }
}

impl<'a> Binding<'a> {
    /// The GPU that holds the array.
    pub(super) fn gpu(self) -> Gpu {
        self.part().array.gpu()
    }

    fn part(self) -> Part<'a> {
        match self {
            Self::Read(array) | Self::Write(array) => Part { array, first: 0, len: array.len() },
            Self::ReadPart(part) | Self::WritePart(part) => part,
        }
    }

    pub(crate) fn is_read_only(self) -> bool {
        matches!(self, Self::Read(_) | Self::ReadPart(_))
    }

    fn with_part(self, part: Part<'a>) -> Self {
        if self.is_read_only() { Self::ReadPart(part) } else { Self::WritePart(part) }
    }

    /// The number of elements.
    pub(crate) fn len(self) -> usize {
        self.part().len
    }

    /// The sub-slice of `len` elements from `first` on, a multiple of [`ALIGNMENT`].
    pub(crate) fn within(self, first: usize, len: usize) -> Self {
        let part = self.part();
        self.with_part(Part::new(part.array, part.first + first, len))
    }

    /// Size of the binding; at least 16 bytes, because empty bindings are invalid.
    fn bytes(self) -> u64 {
        let Part { len, .. } = self.part();
        if len == 0 { 16 } else { 4 * len as u64 }
    }

    /// The key of the binding for the cache of bind groups: id of the buffer, first element, size in bytes.
    pub(super) fn identity(self) -> [u64; 3] {
        let Part { array, first, .. } = self.part();
        [array.buffer_id(), first as u64, self.bytes()]
    }

    pub(super) fn resource(self) -> wgpu::BindingResource<'a> {
        let Part { array, first, .. } = self.part();
        let size = std::num::NonZero::new(self.bytes());
        wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: array.buffer(), offset: 4 * first as u64, size })
    }
}

impl Gpu {
    /// Maximum number of bytes of an array that a kernel sees.
    pub(super) fn visible_bytes(self) -> u64 {
        self.0.limits.max_storage_buffer_binding_size.min(self.0.limits.max_buffer_size)
    }
}

#[cfg(test)]
#[test]
#[should_panic(expected = "begins at element 65")]
fn a_part_begins_where_adapters_let_it() {
    // The test needs an adapter that refuses the binding.
    let gpu = super::tests::test_gpu().unwrap_or_else(|| panic!("SKIPPED: no adapter; begins at element 65"));
    Part::new(&GpuArray::new(gpu, 100), 65, 3);
}
