//! Copies of arrays to the host, which can be submitted before the host waits for them.

use std::ops::Range;
use std::sync::mpsc::Receiver;

use super::array::rounded_size;
use super::pool::Buffer;
use super::{Gpu, GpuArray, READBACKS, count, lock};

impl GpuArray {
    /// Waits for the kernels so far and copies one element to the host.
    pub(crate) fn read_one(&self, at: usize) -> u32 {
        assert!(at < self.len(), "element {at} of {}", self.len());
        let mut out = [0];
        self.read_part(at..at + 1, &mut out);
        out[0]
    }

    /// Submits everything recorded, and a copy of all elements of all arrays, which are on one GPU, to the host.
    pub(crate) fn start_reading(arrays: &[&Self]) -> ReadingArrays {
        let parts: Vec<(&Self, Range<usize>)> = arrays.iter().map(|array| (*array, 0..array.len())).collect();
        let first = arrays.iter().find(|array| !array.is_empty());
        ReadingArrays {
            lens: arrays.iter().map(|array| array.len()).collect(),
            reading: first.map(|first| first.gpu().start_reading(&parts)),
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
        assert_eq!((size_of::<N>(), out.len()), (4, self.len()), "arrays hold 32-bit numbers");
        self.read_part(0..self.len(), out);
    }

    fn read_part<N: bytemuck::AnyBitPattern + bytemuck::NoUninit>(&self, part: Range<usize>, out: &mut [N]) {
        if part.is_empty() {
            return;
        }
        let reading = self.gpu().start_reading(&[(self, part)]);
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
    /// Blocks until the copy has completed, so that [`ReadingArrays::finish`] returns without waiting.
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

impl Gpu {
    /// Waits for the submission that writes a buffer, and returns the bytes of the buffer.
    pub(super) fn map(self, buffer: &wgpu::Buffer, submission: wgpu::SubmissionIndex) -> wgpu::BufferView {
        let mapping = request(buffer);
        self.wait_for(Some(submission));
        self.mapped(buffer, &mapping)
    }

    /// The bytes of a buffer whose submission has finished.
    fn mapped(self, buffer: &wgpu::Buffer, mapping: &Receiver<MapResult>) -> wgpu::BufferView {
        let mapped = mapping.recv().expect("the callback ran while waiting");
        mapped.unwrap_or_else(|error| self.lost(&error));
        buffer.get_mapped_range(..).expect("mapped")
    }

    /// A buffer for a readback of this size; its memory is expensive to allocate.
    fn staging(self, size: u64) -> Buffer {
        let size = rounded_size(size);
        let pooled = lock(&self.0.staging).take(size);
        pooled.unwrap_or_else(|| {
            Buffer::new(self.0.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("readback"),
                size,
                usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            }))
        })
    }

    /// Submits everything recorded, and a copy of these elements of each array to the host.
    fn start_reading(self, parts: &[(&GpuArray, Range<usize>)]) -> Reading {
        let size = parts.iter().map(|(_, part)| 4 * part.len() as u64).sum();
        let staging = self.staging(size);
        let copy = |encoder: &mut wgpu::CommandEncoder| {
            let mut to = 0;
            for (array, part) in parts.iter().filter(|(_, part)| !part.is_empty()) {
                let bytes = 4 * part.len() as u64;
                encoder.copy_buffer_to_buffer(array.buffer(), 4 * part.start as u64, &staging.buffer, to, Some(bytes));
                to += bytes;
            }
        };
        let submission = lock(&self.0.recorder).submit_and(self.0, copy);
        let mapping = request(&staging.buffer);
        Reading { gpu: self, staging, size, submission, mapping }
    }
}

/// A copy to the host that has been submitted.
struct Reading {
    gpu: Gpu,
    staging: Buffer,
    /// Bytes.
    size: u64,
    submission: wgpu::SubmissionIndex,
    mapping: Receiver<MapResult>,
}

impl Reading {
    /// Blocks until this submission has completed, so that [`Reading::finish`] returns without waiting. Later
    /// submissions are not awaited: they may render further frames.
    fn wait(&self) {
        self.gpu.wait_for(Some(self.submission.clone()));
        READBACKS.set(READBACKS.get() + 1);
    }

    /// The elements of all arrays in turn, after [`Reading::wait`].
    fn finish<R>(self, used: impl FnOnce(&[u32]) -> R) -> R {
        let Self { gpu, staging, size, mapping, .. } = self;
        let mapped = gpu.mapped(&staging.buffer, &mapping);
        let result = used(bytemuck::cast_slice(&mapped[..size as usize]));
        drop(mapped);
        staging.buffer.unmap();
        lock(&gpu.0.staging).put(staging);
        count(&gpu.0.counters.readbacks, 1);
        count(&gpu.0.counters.bytes_read, size);
        result
    }
}

type MapResult = Result<(), wgpu::BufferAsyncError>;

/// Asks for a buffer to be mapped once its submission has finished.
fn request(buffer: &wgpu::Buffer) -> Receiver<MapResult> {
    let (sender, receiver) = std::sync::mpsc::channel();
    buffer.map_async(wgpu::MapMode::Read, .., move |result| drop(sender.send(result)));
    receiver
}
