//! Faults that tests plant in the text of kernels: a comparison that does not detect them proves nothing.

use std::cell::Cell;

use super::lock;
use crate::check::conformance::Disagreement;
use crate::check::test_gpu;

/// `(kernel, part of its text, replacement)`.
pub(crate) type Fault = (&'static str, &'static str, &'static str);

thread_local! {
    /// Of this thread alone, because tests run in parallel.
    static PLANTED: Cell<Option<Fault>> = const { Cell::new(None) };
}

/// The result with a fault.
pub(crate) fn with_fault<R>(fault: Fault, result: impl FnOnce() -> R) -> R {
    PLANTED.set(Some(fault));
    let result = result();
    PLANTED.set(None);
    result
}

/// Asserts that a comparison passes without a fault, and fails with each of the faults.
pub(crate) fn assert_noticed(faults: &[Fault], compare: impl Fn() -> Result<usize, Disagreement>) {
    compare().unwrap_or_else(|error| panic!("{error}"));
    for &fault in faults {
        if let Some(gpu) = test_gpu() {
            lock(&gpu.0.arrays).release_written();
        }
        assert!(with_fault(fault, &compare).is_err(), "the fault {fault:?} goes unnoticed");
    }
}

/// The text of a kernel with the fault that is planted in it.
pub(crate) fn planted(kernel: &str, text: String) -> String {
    match PLANTED.get() {
        Some((faulty, right, wrong)) if faulty == kernel => {
            assert!(text.contains(right), "{kernel} has no {right:?}");
            text.replacen(right, wrong, 1)
        }
        _ => text,
    }
}

/// The name under which the pipeline of a kernel is kept: not that of the kernel without the fault.
pub(crate) fn marked(kernel: &str, name: String) -> String {
    match PLANTED.get() {
        Some((faulty, right, wrong)) if faulty == kernel => format!("{name}, {right:?} as {wrong:?}"),
        _ => name,
    }
}
