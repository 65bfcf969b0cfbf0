//! Arrays in the memory of a GPU.

use super::pool::{Buffer, Writer};
use super::{Gpu, GpuFailure, count, lock};

/// The largest array: kernels count elements in 32 bits.
const LARGEST_BYTES: u64 = 4 << 32;
/// The smallest buffer: zero bytes cannot be bound.
const MIN_BYTES: u64 = 256;

/// An array of 32-bit numbers in the memory of a GPU; its buffer returns to the pool when it is dropped.
///
/// Dropping is safe although recorded kernels may still use the buffer: the next user of the buffer runs after them.
#[derive(Debug)]
pub(crate) struct GpuArray {
    gpu: Gpu,
    /// `None` only during drop.
    buffer: Option<Buffer>,
    /// The first writer, which determines the pool that the buffer returns to.
    writer: Writer,
    len: usize,
}

impl GpuArray {
    /// An array with undefined content: the first kernel that uses it must write all of it.
    pub(crate) fn new(gpu: Gpu, len: usize) -> Self {
        Self::unwritten(gpu, len, Writer::Kernel)
    }

    fn unwritten(gpu: Gpu, len: usize, writer: Writer) -> Self {
        let size = gpu.checked_size(len);
        let pooled = lock(&gpu.0.arrays).take(writer, size);
        let buffer = pooled.unwrap_or_else(|| Buffer::new(gpu.create_buffer(size)));
        Self { gpu, buffer: Some(buffer), writer, len }
    }

    /// An array with these numbers, f32 or u32.
    pub(crate) fn upload<N: bytemuck::NoUninit>(gpu: Gpu, data: &[N]) -> Self {
        assert_eq!(size_of::<N>(), 4, "arrays hold 32-bit numbers");
        let array = Self::unwritten(gpu, data.len(), Writer::Host);
        let bytes: &[u8] = bytemuck::cast_slice(data);
        if !bytes.is_empty() {
            gpu.0.queue.write_buffer(array.buffer(), 0, bytes);
        }
        count(&gpu.0.counters.uploads, 1);
        count(&gpu.0.counters.bytes_uploaded, bytes.len() as u64);
        array
    }

    /// An array of zeros.
    pub(crate) fn zeros(gpu: Gpu, len: usize) -> Self {
        Self::upload(gpu, &vec![0_u32; len])
    }

    pub(crate) fn gpu(&self) -> Gpu {
        self.gpu
    }

    /// The number of elements.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.len == 0
    }

    pub(crate) fn buffer(&self) -> &wgpu::Buffer {
        &self.pooled().buffer
    }

    /// The id of its buffer.
    pub(super) fn buffer_id(&self) -> u64 {
        self.pooled().id
    }

    fn pooled(&self) -> &Buffer {
        self.buffer.as_ref().expect("there until it is dropped")
    }
}

impl Drop for GpuArray {
    fn drop(&mut self) {
        if let Some(buffer) = self.buffer.take() {
            lock(&self.gpu.0.arrays).put(self.writer, buffer);
        }
    }
}

impl Gpu {
    /// Bytes of the buffer for this many elements. Panics with a [`GpuFailure`] if the adapter does not allow that size.
    fn checked_size(self, len: usize) -> u64 {
        let (bytes, largest) = (4 * len as u64, self.0.limits.max_buffer_size.min(LARGEST_BYTES));
        if bytes > largest {
            let name = self.name();
            let message = format!("adapter {name:?} allows arrays of {largest} bytes, and {bytes} are needed");
            GpuFailure::OutOfMemory(message).raise();
        }
        rounded_size(bytes).min(largest & !3)
    }

    pub(super) fn create_buffer(self, size: u64) -> wgpu::Buffer {
        self.0.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size,
            usage: wgpu::BufferUsages::STORAGE
                | wgpu::BufferUsages::COPY_SRC
                | wgpu::BufferUsages::COPY_DST
                | wgpu::BufferUsages::INDIRECT,
            mapped_at_creation: false,
        })
    }
}

/// At least 256 bytes, rounded up to three significant bits: larger buffers exceed the request by at most a quarter,
/// and slowly growing sizes reuse the same buffers.
pub(super) fn rounded_size(bytes: u64) -> u64 {
    let bytes = bytes.max(MIN_BYTES);
    let step = 1 << (bytes.ilog2() - 2);
    bytes.next_multiple_of(step)
}

#[cfg(test)]
#[test]
fn sizes_round_up_a_little() {
    assert_eq!([0, 256, 257, 1000, 1024, 1025].map(rounded_size), [256, 256, 320, 1024, 1024, 1280]);
}
