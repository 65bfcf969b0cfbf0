//! Arrays in the memory of a GPU.

use std::ops::Range;

use super::pool::{Buffer, Writer};
use super::{Gpu, GpuFailure, Reading, count, lock};

/// The largest array: kernels count elements in 32 bits.
const LARGEST_BYTES: u64 = 4 << 32;
/// The smallest buffer: zero bytes cannot be bound.
const MIN_BYTES: u64 = 256;

/// An array of 32-bit numbers in the memory of a GPU; its buffer returns to the pool when it is dropped.
///
/// That is safe while kernels that use it are still to run, because whatever uses the buffer next runs after them.
#[derive(Debug)]
pub(crate) struct GpuArray {
    gpu: Gpu,
    /// `None` only during drop.
    buffer: Option<Buffer>,
    /// Decides the pool.
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

    /// Waits for the kernels so far and copies one element to the host.
    pub(crate) fn read_one(&self, at: usize) -> u32 {
        assert!(at < self.len, "element {at} of {}", self.len);
        let mut out = [0];
        self.read_part(at..at + 1, &mut out);
        out[0]
    }

    /// Submits everything recorded, and a copy of all elements of all arrays, which are on one GPU, to the host.
    pub(crate) fn start_reading(arrays: &[&Self]) -> ReadingArrays {
        let parts: Vec<(&Self, Range<usize>)> = arrays.iter().map(|array| (*array, 0..array.len)).collect();
        let first = arrays.iter().find(|array| !array.is_empty());
        ReadingArrays {
            lens: arrays.iter().map(|array| array.len).collect(),
            reading: first.map(|first| first.gpu.start_reading(&parts)),
        }
    }

    /// Waits once for the kernels so far and copies all elements of all arrays, which are on one GPU, to the host.
    pub(crate) fn read_all(arrays: &[&Self]) -> Vec<Vec<u32>> {
        let reading = Self::start_reading(arrays);
        reading.wait();
        reading.finish()
    }

    /// Waits for the kernels so far and copies the elements, f32 or u32, to the host.
    pub(crate) fn read_into<N: bytemuck::AnyBitPattern + bytemuck::NoUninit>(&self, out: &mut [N]) {
        assert_eq!((size_of::<N>(), out.len()), (4, self.len), "arrays hold 32-bit numbers");
        self.read_part(0..self.len, out);
    }

    fn read_part<N: bytemuck::AnyBitPattern + bytemuck::NoUninit>(&self, part: Range<usize>, out: &mut [N]) {
        if part.is_empty() {
            return;
        }
        let reading = self.gpu.start_reading(&[(self, part)]);
        reading.wait();
        reading.finish(|elements| out.copy_from_slice(bytemuck::cast_slice(elements)));
    }
}

/// A copy of arrays to the host that has been submitted.
pub(crate) struct ReadingArrays {
    lens: Vec<usize>,
    /// `None` if all arrays are empty.
    reading: Option<Reading>,
}

impl ReadingArrays {
    /// Waits until [`ReadingArrays::finish`] does not wait.
    pub(crate) fn wait(&self) {
        self.reading.as_ref().inspect(|reading| reading.wait());
    }

    /// The elements of each array, after [`ReadingArrays::wait`].
    pub(crate) fn finish(self) -> Vec<Vec<u32>> {
        let split = |mut elements: &[u32]| {
            let next = |&len: &usize| elements.split_off(..len).expect("as many as the lengths say").to_vec();
            self.lens.iter().map(next).collect()
        };
        self.reading.map_or_else(|| split(&[]), |reading| reading.finish(split))
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

/// Rounded up to three significant bits: at most a seventh is wasted, and slowly growing sizes reuse the same buffers.
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
