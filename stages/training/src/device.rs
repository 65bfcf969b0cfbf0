//! The device that a job computes on, and what becomes of the job when it fails.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use engine::{Failure, FailureKind};
use shaders::gpu::GpuFailure;
use shaders::tape::Device;

/// Opens the device that a job was given and computes on it; a GPU that fails meanwhile is a failure of the job by kind.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gpu_that_fails_is_a_failure_by_kind_and_a_bug_stays_one() {
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
