//! The device of a job, its failures, and the meter of its use.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use engine::{Failure, FailureKind};
use serde::Serialize;
use shaders::gpu::{Gpu, GpuFailure, KernelCost, Usage};
use shaders::tape::Device;

/// Opens a device by its id and runs `compute` on it. A GPU that fails meanwhile becomes a typed failure of the job.
pub fn compute_on<R>(id: &str, compute: impl FnOnce(Device) -> anyhow::Result<R>) -> anyhow::Result<R> {
    let device = Device::open(id).map_err(|error| Failure::new(FailureKind::World, error.to_string()))?;
    catch_unwind(AssertUnwindSafe(|| compute(device))).unwrap_or_else(|payload| {
        match payload.downcast::<GpuFailure>() {
            Ok(failure) => Err(of_gpu(&failure).into()),
            Err(bug) => resume_unwind(bug),
        }
    })
}

fn of_gpu(failure: &GpuFailure) -> Failure {
    let (kind, hint) = match failure {
        GpuFailure::Lost(_) => (FailureKind::DeviceLost, "run again to continue from the last checkpoint"),
        GpuFailure::OutOfMemory(_) => {
            (FailureKind::OutOfMemory, "lower density.max_count, or choose another device with --device")
        }
    };
    Failure::new(kind, failure.to_string()).hint(hint)
}

/// Measures how much the steps of a training use a GPU, excluding other work on it.
pub(crate) struct Meter {
    gpu: Gpu,
    /// Use to subtract: everything before the start, and other work since then.
    left_out: Usage,
    /// Steps completed before the start.
    steps_before: u64,
}

impl Meter {
    /// Starts counting, after `steps_before` completed steps.
    pub(crate) fn start(gpu: Gpu, steps_before: u64) -> Self {
        Self { gpu, left_out: gpu.usage(), steps_before }
    }

    /// Runs `work` without counting it.
    pub(crate) fn pause<R>(meter: &mut Option<Self>, work: impl FnOnce() -> R) -> R {
        let Some(meter) = meter else { return work() };
        let counted = meter.gpu.usage().since(&meter.left_out);
        let result = work();
        meter.left_out = meter.gpu.usage().since(&counted);
        result
    }

    /// The mean use per step, given the total number of completed steps.
    pub(crate) fn per_iteration(&self, steps: u64) -> GpuUse {
        let Usage { counts, kernels } = self.gpu.usage().since(&self.left_out);
        let steps = steps - self.steps_before;
        let per_iteration = |count: u64| count as f64 / steps.max(1) as f64;
        let kernel = |(name, cost): (String, KernelCost)| {
            let ms_per_launch = (cost.secs > 0.0).then(|| 1e3 * cost.secs / cost.launches as f64);
            (name, KernelUse { launches: per_iteration(cost.launches), ms_per_launch })
        };
        GpuUse {
            launches: per_iteration(counts.launches),
            submissions: per_iteration(counts.submissions),
            readbacks: per_iteration(counts.readbacks),
            bytes_read: per_iteration(counts.bytes_read),
            uploads: per_iteration(counts.uploads),
            bytes_uploaded: per_iteration(counts.bytes_uploaded),
            kernels: kernels.into_iter().map(kernel).collect(),
        }
    }
}

/// Mean use of a GPU per training step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GpuUse {
    /// Kernel launches.
    pub launches: f64,
    /// Batches of launches.
    pub submissions: f64,
    /// Times that the host waited for an array.
    pub readbacks: f64,
    /// Bytes read back by the host.
    pub bytes_read: f64,
    /// Arrays sent to the GPU.
    pub uploads: f64,
    /// Bytes sent to the GPU.
    pub bytes_uploaded: f64,
    /// Use by kernel name.
    pub kernels: BTreeMap<String, KernelUse>,
}

/// Mean use of one kernel per training step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KernelUse {
    /// Launches of the kernel.
    pub launches: f64,
    /// Milliseconds per launch on the GPU's clock, with a profile on an adapter that has timestamps.
    pub ms_per_launch: Option<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gpu_failures_are_typed_and_bugs_still_panic() {
        let kind_of = |failure: GpuFailure| {
            let result = compute_on::<()>("cpu", |_| std::panic::panic_any(failure));
            result.unwrap_err().downcast::<Failure>().unwrap().kind
        };
        assert_eq!(kind_of(GpuFailure::Lost("gone".into())), FailureKind::DeviceLost);
        assert_eq!(kind_of(GpuFailure::OutOfMemory("full".into())), FailureKind::OutOfMemory);
        let bug = catch_unwind(|| compute_on::<()>("cpu", |_| panic!("a bug")));
        assert_eq!(bug.unwrap_err().downcast_ref(), Some(&"a bug"));
        let unknown = compute_on("no such adapter", |_| Ok(())).unwrap_err().downcast::<Failure>().unwrap();
        assert_eq!(unknown.kind, FailureKind::World);
    }
}
