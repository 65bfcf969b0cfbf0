//! Kernels that were launched and have not been submitted to the driver yet.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::bind_groups::BindGroups;
use super::launch::{Launch, Pipeline, folded};
use super::profile::Stamps;
use super::{Context, Gpu, GpuFailure, Groups, count, lock};

/// Size of the constants buffer in bytes. It limits a submission to 256 launches at the usual alignment.
const CONSTANT_BYTES: usize = 64 * 1024;

struct Dispatch {
    pipeline: Arc<Pipeline>,
    bind_group: wgpu::BindGroup,
    /// Byte offset of the constants in the constants buffer.
    constants_at: u32,
    groups: Workgroups,
}

enum Workgroups {
    Direct([u32; 2]),
    /// The buffer that holds the three workgroup counts, and their byte offset.
    Indirect(wgpu::Buffer, u64),
}

impl Workgroups {
    fn new(groups: Groups, pipeline: &Pipeline) -> Self {
        match groups {
            Groups::Count(count) => Self::Direct(folded(count)),
            Groups::Over(elements) => {
                let size = pipeline.workgroup_size.expect("a kernel over elements states its workgroup size");
                Self::Direct(folded(elements.div_ceil(size)))
            }
            Groups::Indirect(array, at) => Self::Indirect(array.buffer().clone(), 4 * at as u64),
        }
    }
}

/// Launches of the next submission.
pub(crate) struct Recorder {
    dispatches: Vec<Dispatch>,
    /// The constants of all of them, each aligned.
    constants: Vec<u8>,
    /// The buffer of the constants, written once before each submission.
    constants_buffer: wgpu::Buffer,
    alignment: usize,
    bind_groups: BindGroups,
}

impl Recorder {
    pub(super) fn new(device: &wgpu::Device, alignment: u32) -> Self {
        let constants_buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("constants"),
            size: CONSTANT_BYTES as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        Self {
            dispatches: Vec::new(),
            constants: Vec::new(),
            constants_buffer,
            alignment: alignment as usize,
            bind_groups: BindGroups::default(),
        }
    }

    /// Whether this many bytes of constants no longer fit.
    pub(super) fn is_full(&self, bytes: usize) -> bool {
        self.constants.len() + bytes > CONSTANT_BYTES
    }

    pub(super) fn record(&mut self, context: &Context, pipeline: &Arc<Pipeline>, launch: &Launch) {
        let constants_at = self.constants.len() as u32;
        self.constants.extend_from_slice(launch.constants);
        self.constants.resize(self.constants.len().next_multiple_of(self.alignment), 0);
        let arrays = launch.arrays.iter().flat_map(|array| array.identity());
        let create = || context.bind_group(pipeline, launch, &self.constants_buffer);
        self.dispatches.push(Dispatch {
            pipeline: pipeline.clone(),
            bind_group: self.bind_groups.of(std::iter::once(pipeline.id).chain(arrays), create),
            constants_at,
            groups: Workgroups::new(launch.groups, pipeline),
        });
    }

    /// Submits everything to the driver, in order.
    pub(super) fn submit(&mut self, context: &'static Context) {
        self.submit_and(context, |_| {});
    }

    pub(super) fn submit_and(
        &mut self,
        context: &'static Context,
        then: impl FnOnce(&mut wgpu::CommandEncoder),
    ) -> wgpu::SubmissionIndex {
        let mut encoder = context.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let is_timed = context.timed.load(Ordering::Relaxed) && !self.dispatches.is_empty();
        let stamps = is_timed.then(|| Stamps::new(context, self.dispatches.len()));
        match &stamps {
            None => encode(&mut encoder, &self.dispatches, None),
            // Time stamps are written per pass, so every kernel needs a separate pass.
            Some(stamps) => {
                let kernels = self.dispatches.chunks(1).enumerate();
                kernels.for_each(|(index, kernel)| encode(&mut encoder, kernel, Some(stamps.of(index))));
                stamps.resolve(&mut encoder);
            }
        }
        then(&mut encoder);
        // A write to a buffer comes after all earlier submissions and before this one.
        context.queue.write_buffer(&self.constants_buffer, 0, &self.constants);
        self.constants.clear();
        let submission = context.queue.submit([encoder.finish()]);
        if lock(&context.arrays).submitted() {
            self.bind_groups.clear();
        }
        count(&context.counters.submissions, 1);
        let pipelines: Vec<_> = self.dispatches.drain(..).map(|dispatch| dispatch.pipeline).collect();
        if let Some(stamps) = stamps {
            stamps.collect(context, &pipelines, submission.clone());
        }
        submission
    }
}

/// One pass with these kernels, in order.
fn encode(
    encoder: &mut wgpu::CommandEncoder,
    dispatches: &[Dispatch],
    timestamp_writes: Option<wgpu::ComputePassTimestampWrites<'_>>,
) {
    if dispatches.is_empty() {
        return;
    }
    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: None, timestamp_writes });
    for Dispatch { pipeline, bind_group, constants_at, groups } in dispatches {
        pass.set_pipeline(&pipeline.compute);
        pass.set_bind_group(0, bind_group, &[*constants_at]);
        match groups {
            Workgroups::Direct([columns, rows]) => pass.dispatch_workgroups(*columns, *rows, 1),
            Workgroups::Indirect(buffer, offset) => pass.dispatch_workgroups_indirect(buffer, *offset),
        }
    }
}

impl Gpu {
    pub(super) fn lost(self, error: &dyn std::error::Error) -> ! {
        GpuFailure::Lost(format!("adapter {:?} stopped: {error}", self.0.name)).raise()
    }

    /// Submits the recorded kernels without waiting.
    pub fn submit(self) {
        lock(&self.0.recorder).submit(self.0);
    }

    /// Submits the recorded kernels and waits for them to finish.
    pub fn wait(self) {
        lock(&self.0.recorder).submit(self.0);
        self.wait_for(None);
    }

    /// Waits for a submission and all earlier ones; without one, for everything submitted.
    pub(super) fn wait_for(self, submission: Option<wgpu::SubmissionIndex>) {
        let waited = self.0.device.poll(wgpu::PollType::Wait { submission_index: submission, timeout: None });
        waited.unwrap_or_else(|error| self.lost(&error));
    }
}
