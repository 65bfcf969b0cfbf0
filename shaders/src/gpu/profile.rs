//! The cost of every kernel: its launches and, with profiling on an adapter with timestamps, its time.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::launch::Pipeline;
use super::{Context, Counts, Gpu, count, lock};

/// The bytes of one time stamp.
const STAMP_BYTES: u64 = 8;

/// Counters of a GPU and the costs of its kernels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Usage {
    /// Launches, submissions and transfers.
    pub counts: Counts,
    /// The cost of each kernel, by name.
    pub kernels: BTreeMap<String, KernelCost>,
}

impl Usage {
    /// The difference to an earlier usage.
    pub fn since(mut self, earlier: &Self) -> Self {
        self.counts = self.counts.since(earlier.counts);
        for (name, before) in &earlier.kernels {
            let cost = self.kernels.entry(name.clone()).or_default();
            cost.launches -= before.launches;
            cost.secs -= before.secs;
        }
        self.kernels.retain(|_, cost| cost.launches > 0);
        self
    }
}

/// The cost of a kernel, all its specialisations together.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KernelCost {
    /// Times that the kernel was launched.
    pub launches: u64,
    /// Total time of all launches in seconds, on the GPU's clock; 0 unless [`Gpu::time_kernels`] is on.
    pub secs: f64,
}

impl Gpu {
    /// Times every later kernel, at the cost of one wait per submission. Returns `false`, and times none, if the
    /// adapter has no timestamps.
    pub fn time_kernels(self) -> bool {
        let can = self.0.device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        self.0.timed.store(can, Ordering::Relaxed);
        can
    }

    /// The usage of this GPU, over all threads.
    pub fn usage(self) -> Usage {
        Usage { counts: self.counts(), kernels: self.kernels() }
    }

    fn kernels(self) -> BTreeMap<String, KernelCost> {
        let mut costs: BTreeMap<String, KernelCost> = BTreeMap::new();
        for pipeline in lock(&self.0.pipelines).values() {
            let cost = costs.entry(pipeline.kernel.clone()).or_default();
            cost.launches += pipeline.launches.load(Ordering::Relaxed);
            cost.secs += 1e-9 * pipeline.nanoseconds.load(Ordering::Relaxed) as f64;
        }
        costs
    }
}

/// Two time stamps for each kernel of a submission.
pub(crate) struct Stamps {
    queries: wgpu::QuerySet,
    count: u32,
    resolved: wgpu::Buffer,
    readable: wgpu::Buffer,
}

impl Stamps {
    pub(super) fn new(context: &Context, kernels: usize) -> Self {
        let count = 2 * kernels as u32;
        let buffer = |usage| {
            let size = STAMP_BYTES * u64::from(count);
            let label = Some("time stamps");
            context.device.create_buffer(&wgpu::BufferDescriptor { label, size, usage, mapped_at_creation: false })
        };
        let queries = context.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("time stamps"),
            ty: wgpu::QueryType::Timestamp,
            count,
        });
        let resolved = buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC);
        let readable = buffer(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
        Self { queries, count, resolved, readable }
    }

    /// The stamps of the `index`-th kernel.
    pub(super) fn of(&self, index: usize) -> wgpu::ComputePassTimestampWrites<'_> {
        let first = 2 * index as u32;
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        }
    }

    pub(super) fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.resolve_query_set(&self.queries, 0..self.count, &self.resolved, 0);
        encoder.copy_buffer_to_buffer(&self.resolved, 0, &self.readable, 0, None);
    }

    /// Waits for the submission and adds the time of each kernel to its own.
    pub(super) fn collect(
        self,
        context: &'static Context,
        pipelines: &[Arc<Pipeline>],
        submission: wgpu::SubmissionIndex,
    ) {
        let bytes = Gpu(context).map(&self.readable, submission);
        let nanoseconds_per_tick = f64::from(context.queue.get_timestamp_period());
        let stamps: &[u64] = bytemuck::cast_slice(&bytes);
        for (pipeline, [begin, end]) in pipelines.iter().zip(stamps.as_chunks().0) {
            count(&pipeline.nanoseconds, (end.saturating_sub(*begin) as f64 * nanoseconds_per_tick) as u64);
        }
    }
}
