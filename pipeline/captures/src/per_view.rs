//! Parallel work on the views of a capture.

use std::sync::atomic::{AtomicUsize, Ordering};

use engine::{Failure, FailureKind, JobContext, Progress};
use rayon::prelude::*;

/// Calls `work` for every view index below `count` on the job's threads, reports progress, and fails as interrupted
/// when a stop of the job is requested. The results are in index order, for any number of threads.
pub fn per_view<T: Send>(
    context: &JobContext,
    count: usize,
    work: impl Fn(usize) -> anyhow::Result<T> + Sync,
) -> anyhow::Result<Vec<T>> {
    // The context itself cannot be shared between threads.
    let (on_progress, stop) = (&context.on_progress, &context.stop);
    let done = AtomicUsize::new(0);
    let step = |index: usize| {
        if stop.load(Ordering::Relaxed) {
            return Err(Failure::new(FailureKind::Interrupted, "stopped on request").into());
        }
        let result = work(index)?;
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        on_progress(Progress { done: done as u64, total: count as u64, message: "views".into() });
        Ok(result)
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(context.threads).build()?;
    pool.install(|| (0..count).into_par_iter().map(step).collect())
}
