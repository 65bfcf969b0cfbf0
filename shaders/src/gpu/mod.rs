//! The second device: a context of an adapter, in which kernels are recorded and submitted in batches.
//!
//! A kernel is WGSL text (`Launch`); an operation binds the arrays of its tensors and a block of constants, or those of
//! many tensors at once (`grouped`). Arrays larger than a binding are bound in `parts`; where an adapter allows a kernel too
//! few arrays, its inputs are `joined`. Kernels run in the order in which they are recorded, and a readback submits them
//! first. No result depends on a race: kernels use no float atomics, and each element is written by one invocation of a
//! launch.

mod accessors;
mod adapter;
mod array;
mod bind_groups;
mod binding;
pub(crate) mod column_sums;
mod copy;
#[cfg(test)]
pub(crate) mod fault_tests;
mod fit;
pub(crate) mod grouped;
pub(crate) mod joined;
mod launch;
#[cfg(test)]
pub(crate) mod layout_tests;
pub(crate) mod length;
mod module;
pub(crate) mod parts;
mod pool;
mod profile;
mod rates;
mod readback;
mod recorder;
#[cfg(test)]
pub(crate) mod tests;
pub(crate) mod wgsl;

use std::cell::Cell;
use std::collections::HashMap;
use std::fmt;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

pub use adapter::{AdapterError, AdapterReport, adapters, choose};
pub(crate) use array::GpuArray;
pub(crate) use binding::{ALIGNMENT, Binding};
pub(crate) use launch::{Kernel, Launch, WORKGROUP_SIZE, columns_for, lanes_for, uniforms};
pub(crate) use length::{Groups, Length};
pub use profile::{KernelCost, Usage};
pub use rates::Rates;
pub(crate) use readback::ReadingArrays;

use launch::Pipeline;
use recorder::Recorder;

/// An adapter in use: a handle to its context. There is one per adapter and process, and several in tests.
#[derive(Clone, Copy)]
pub struct Gpu(&'static Context);

/// Counters of the work of a GPU.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Kernels started.
    pub launches: u64,
    /// Batches of kernels handed to the driver.
    pub submissions: u64,
    /// Readbacks, each of which waits for the GPU.
    pub readbacks: u64,
    /// Bytes copied to the host.
    pub bytes_read: u64,
    /// Arrays copied from the host.
    pub uploads: u64,
    /// Bytes copied from the host.
    pub bytes_uploaded: u64,
}

impl Counts {
    /// The difference to earlier counters.
    pub fn since(self, earlier: Self) -> Self {
        Self {
            launches: self.launches - earlier.launches,
            submissions: self.submissions - earlier.submissions,
            readbacks: self.readbacks - earlier.readbacks,
            bytes_read: self.bytes_read - earlier.bytes_read,
            uploads: self.uploads - earlier.uploads,
            bytes_uploaded: self.bytes_uploaded - earlier.bytes_uploaded,
        }
    }
}

struct Context {
    name: String,
    device: wgpu::Device,
    queue: wgpu::Queue,
    limits: wgpu::Limits,
    /// Whether the driver computes on the CPU.
    is_software: bool,
    subgroup_size: Option<u32>,
    /// By kernel and specialisation.
    pipelines: Mutex<HashMap<String, Arc<Pipeline>>>,
    /// Buffers that no array uses.
    arrays: Mutex<pool::ArrayPools>,
    /// Buffers for readbacks that no readback uses.
    staging: Mutex<pool::Pool>,
    recorder: Mutex<Recorder>,
    /// Whether every kernel is timed, which costs a wait per submission.
    timed: AtomicBool,
    counters: Counters,
}

thread_local! {
    static READBACKS: Cell<u64> = const { Cell::new(0) };
}

/// Times that this thread waited for an array of any GPU.
pub fn readbacks_of_this_thread() -> u64 {
    READBACKS.get()
}

#[derive(Default)]
struct Counters {
    launches: AtomicU64,
    submissions: AtomicU64,
    readbacks: AtomicU64,
    bytes_read: AtomicU64,
    uploads: AtomicU64,
    bytes_uploaded: AtomicU64,
}

impl Gpu {
    /// The adapter's name.
    pub fn name(self) -> &'static str {
        &self.0.name
    }

    /// Invocations per subgroup, if kernels can use subgroup operations.
    pub fn subgroup_size(self) -> Option<u32> {
        self.0.subgroup_size
    }

    /// The counters of this GPU, over all threads.
    pub fn counts(self) -> Counts {
        let Counters { launches, submissions, readbacks, bytes_read, uploads, bytes_uploaded } = &self.0.counters;
        let load = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Counts {
            launches: load(launches),
            submissions: load(submissions),
            readbacks: load(readbacks),
            bytes_read: load(bytes_read),
            uploads: load(uploads),
            bytes_uploaded: load(bytes_uploaded),
        }
    }
}

/// A failure of a GPU: the payload of the panic that unwinds the computation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GpuFailure {
    /// The device is lost: it was switched off or reset, or its driver crashed.
    Lost(String),
    /// The device has too little memory.
    OutOfMemory(String),
}

impl GpuFailure {
    /// Unwinds to the handler, without the message and backtrace of a panic: this is not a bug.
    fn raise(self) -> ! {
        std::panic::resume_unwind(Box::new(self))
    }
}

impl fmt::Display for GpuFailure {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lost(message) | Self::OutOfMemory(message) => formatter.write_str(message),
        }
    }
}

impl std::error::Error for GpuFailure {}

/// Handles are equal if they refer to the same context.
impl PartialEq for Gpu {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self.0, other.0)
    }
}

impl Eq for Gpu {}

impl fmt::Debug for Gpu {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Gpu({})", self.0.name)
    }
}

fn count(counter: &AtomicU64, amount: u64) {
    counter.fetch_add(amount, Ordering::Relaxed);
}

/// Locks a mutex and ignores poisoning: a thread that panicked while recording leaves no relevant partial state,
/// because its tape is gone.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}
