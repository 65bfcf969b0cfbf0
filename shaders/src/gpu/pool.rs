//! Buffers that no array uses: every training step allocates and frees the same sizes.
//!
//! Of several buffers of one size, the oldest is used first, so that equal steps use equal buffers.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};

/// Maximum number of bytes in a pool: the rest is returned to the driver.
const POOL_BYTES: u64 = 1 << 30;

/// A buffer of the driver with an id that no other buffer of the process ever has.
#[derive(Debug)]
pub(super) struct Buffer {
    pub(super) id: u64,
    pub(super) buffer: wgpu::Buffer,
}

impl Buffer {
    pub(super) fn new(buffer: wgpu::Buffer) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        Self { id: NEXT.fetch_add(1, Ordering::Relaxed), buffer }
    }
}

/// Unused buffers of one kind, by size and id.
#[derive(Default)]
pub(super) struct Pool {
    buffers: BTreeMap<(u64, u64), Buffer>,
    bytes: u64,
}

impl Pool {
    pub(super) fn take(&mut self, size: u64) -> Option<Buffer> {
        let (&key, _) = self.buffers.range((size, 0)..=(size, u64::MAX)).next()?;
        self.bytes -= size;
        self.buffers.remove(&key)
    }

    /// Keeps a buffer; `false` if the pool is full, and the buffer is released.
    pub(super) fn put(&mut self, buffer: Buffer) -> bool {
        let size = buffer.buffer.size();
        let fits = self.bytes + size <= POOL_BYTES;
        if fits {
            self.bytes += size;
            self.buffers.insert((size, buffer.id), buffer);
        }
        fits
    }
}

/// The unused buffers of arrays.
#[derive(Default)]
pub(super) struct ArrayPools {
    /// Buffers of arrays that a kernel writes first. They are reusable at once, because kernels run in the order in
    /// which they are recorded.
    written: Pool,
    /// Buffers of arrays that the host writes first. Such a write precedes all recorded kernels, so a buffer is
    /// reusable only after the kernels that read it have been submitted.
    uploaded: Pool,
    /// Uploaded buffers that recorded, unsubmitted kernels may still use.
    recorded: Vec<Buffer>,
    /// Whether a buffer was released since the last submission.
    has_released: bool,
}

/// The first writer of an array; it determines the pool of the array's buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Writer {
    Kernel,
    Host,
}

impl ArrayPools {
    /// A buffer that this writer may write now.
    pub(super) fn take(&mut self, writer: Writer, size: u64) -> Option<Buffer> {
        match writer {
            Writer::Kernel => self.written.take(size),
            Writer::Host => self.uploaded.take(size),
        }
    }

    /// Keeps the buffer of an array that is no longer used.
    pub(super) fn put(&mut self, writer: Writer, buffer: Buffer) {
        match writer {
            Writer::Kernel => self.has_released |= !self.written.put(buffer),
            Writer::Host => self.recorded.push(buffer),
        }
    }

    /// Releases the unused buffers that kernels wrote: a kernel that writes too little cannot find earlier results there.
    #[cfg(test)]
    pub(super) fn release_written(&mut self) {
        self.written = Pool::default();
        self.has_released = true;
    }

    /// Makes the recorded buffers reusable; to be called after a submission. Returns whether a buffer was released to
    /// the driver since the last call.
    pub(super) fn submitted(&mut self) -> bool {
        for buffer in std::mem::take(&mut self.recorded) {
            self.has_released |= !self.uploaded.put(buffer);
        }
        std::mem::take(&mut self.has_released)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::tests::test_gpu;

    #[test]
    fn the_oldest_buffer_of_a_size_is_used_first() {
        let Some(gpu) = test_gpu() else { return };
        let mut pools = ArrayPools::default();
        let [a, b, c] = [256, 256, 512].map(|size| Buffer::new(gpu.create_buffer(size)));
        let ids = [a.id, b.id, c.id];
        [c, b, a].into_iter().for_each(|buffer| pools.put(Writer::Kernel, buffer));
        let mut take = |size| pools.take(Writer::Kernel, size).map(|buffer| buffer.id);
        assert_eq!([256, 512, 256, 256].map(&mut take), [Some(ids[0]), Some(ids[2]), Some(ids[1]), None]);
    }

    #[test]
    fn the_host_writes_no_buffer_that_a_recorded_kernel_may_use() {
        let Some(gpu) = test_gpu() else { return };
        let mut pools = ArrayPools::default();
        let [uploaded, written] = [(); 2].map(|()| Buffer::new(gpu.create_buffer(256)));
        let id = uploaded.id;
        pools.put(Writer::Host, uploaded);
        pools.put(Writer::Kernel, written);
        assert!(pools.take(Writer::Host, 256).is_none());
        assert!(!pools.submitted(), "nothing was released");
        assert_eq!(pools.take(Writer::Host, 256).map(|buffer| buffer.id), Some(id));
    }
}
