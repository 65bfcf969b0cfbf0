//! Derives typed failures from errors, panics and dead processes.

use std::any::Any;
use std::io;

use crate::{Failure, FailureKind, exit};

/// The failure of a stage's error: the first typed [`Failure`] in its chain, with the context above it; otherwise
/// `World` for an I/O error and `BadInput` for any other error.
pub(super) fn of_error(error: &anyhow::Error) -> Failure {
    let mut context = Vec::new();
    for cause in error.chain() {
        if let Some(failure) = cause.downcast_ref::<Failure>() {
            let mut failure = failure.clone();
            context.push(failure.message);
            failure.message = context.join(": ");
            return failure;
        }
        context.push(cause.to_string());
    }
    match error.chain().find_map(|cause| cause.downcast_ref::<io::Error>()) {
        Some(cause) => of_machine(context.join(": "), is_full(cause)),
        None => Failure::new(FailureKind::BadInput, context.join(": ")),
    }
}

/// A failure of the machine, with advice for a full disk.
fn of_machine(message: impl Into<String>, is_full: bool) -> Failure {
    let failure = Failure::new(FailureKind::World, message);
    if is_full { failure.hint("free space, or choose a folder on another disk with --store") } else { failure }
}

/// Whether the error means that nothing more fits on the disk.
fn is_full(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge)
}

/// The failure of a panic.
pub(super) fn of_panic(payload: &(dyn Any + Send)) -> Failure {
    let text = payload.downcast_ref::<&str>().copied();
    let text = text.or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("no message");
    Failure::new(FailureKind::Crashed, format!("panicked: {text}")).hint("this is a bug; the log has a backtrace")
}

/// The circumstances of a child's death without a status.
pub(super) struct Death<'a> {
    /// The signal that ended the child.
    pub(super) signal: Option<i32>,
    /// The exit code.
    pub(super) code: Option<i32>,
    /// Whether the child was past its time limit.
    pub(super) timed_out: bool,
    /// Whether the child was requested to stop.
    pub(super) stop_requested: bool,
    /// Whether the kernel killed any process for lack of memory while the child ran.
    pub(super) kernel_killed_for_memory: bool,
    /// The last lines of the child's logs.
    pub(super) log_tail: &'a [String],
}

/// The failure of a child that left no status.
pub(super) fn of_death(death: &Death<'_>) -> Failure {
    let out_of_memory =
        |message: &str| Failure::new(FailureKind::OutOfMemory, message).hint("run fewer jobs at once with --jobs 1");
    if death.timed_out {
        return Failure::new(FailureKind::Timeout, "exceeded its time limit and was stopped");
    }
    if death.stop_requested {
        return Failure::new(FailureKind::Interrupted, "stopped on request before it saved its progress");
    }
    if death.log_tail.iter().any(|line| line.starts_with("memory allocation of")) {
        return out_of_memory("an allocation failed");
    }
    match (death.signal, death.code) {
        (Some(libc::SIGKILL), _) if death.kernel_killed_for_memory => {
            out_of_memory("the kernel killed the process because memory ran out")
        }
        (Some(signal), _) => Failure::new(FailureKind::Crashed, format!("killed by {}", signal_name(signal))),
        (None, Some(code)) if code == i32::from(exit::INFRASTRUCTURE) => {
            let said = death.log_tail.last().map_or("the job could not write its status", String::as_str);
            let said = said.strip_prefix("error: ").unwrap_or(said);
            of_machine(said, said.contains("No space left") || said.contains("quota"))
        }
        (None, Some(code)) => {
            Failure::new(FailureKind::Crashed, format!("ended with exit code {code} and left no status"))
        }
        (None, None) => Failure::new(FailureKind::Crashed, "ended and left no status"),
    }
}

/// The number of processes that the kernel has killed for lack of memory since it booted; 0 if it is unknown.
pub(super) fn kernel_memory_kills() -> u64 {
    let vmstat = std::fs::read_to_string("/proc/vmstat").unwrap_or_default();
    let count = vmstat.lines().find_map(|line| line.strip_prefix("oom_kill "));
    count.and_then(|count| count.trim().parse().ok()).unwrap_or(0)
}

fn signal_name(signal: i32) -> String {
    signal_hook::low_level::signal_name(signal).map_or_else(|| format!("signal {signal}"), str::to_owned)
}

#[cfg(test)]
mod tests {
    use anyhow::Context;

    use super::*;

    #[test]
    fn a_typed_failure_keeps_the_context_above_it() {
        let failure = Failure::new(FailureKind::Diverged, "loss is NaN").hint("lower the rate");
        let error = Err::<(), _>(failure).context("iteration 7").context("fine stage").unwrap_err();
        let found = of_error(&error);
        assert_eq!(found.kind, FailureKind::Diverged);
        assert_eq!(found.to_string(), "fine stage: iteration 7: loss is NaN; lower the rate");
    }

    #[test]
    fn untyped_errors_are_bad_input_or_the_machine() {
        let full = anyhow::Error::from(io::Error::from(io::ErrorKind::StorageFull)).context("cannot write");
        let full = of_error(&full);
        assert_eq!((full.kind, full.hint.is_some()), (FailureKind::World, true));
        assert_eq!(of_error(&anyhow::anyhow!("two poses")).kind, FailureKind::BadInput);
    }

    #[test]
    fn deaths_have_distinct_kinds() {
        let death = Death {
            signal: Some(libc::SIGKILL),
            code: None,
            timed_out: false,
            stop_requested: false,
            kernel_killed_for_memory: false,
            log_tail: &[],
        };
        let kind = |death: Death<'_>| of_death(&death).kind;
        assert_eq!(kind(Death { kernel_killed_for_memory: true, ..death }), FailureKind::OutOfMemory);
        assert_eq!(kind(Death { timed_out: true, ..death }), FailureKind::Timeout);
        assert_eq!(kind(Death { stop_requested: true, ..death }), FailureKind::Interrupted);
        let aborted = ["memory allocation of 64 bytes failed".to_owned()];
        let abort = Death { signal: Some(libc::SIGABRT), log_tail: &aborted, ..death };
        assert_eq!(kind(abort), FailureKind::OutOfMemory);
        assert_eq!(of_death(&death).to_string(), "killed by SIGKILL");
        // A job that cannot write its status says so in a line and ends with the code of machine failures.
        let said = ["error: failed to write status.json: No space left on device (os error 28)".to_owned()];
        let unwritten = of_death(&Death { signal: None, code: Some(13), log_tail: &said, ..death });
        assert_eq!((unwritten.kind, unwritten.hint.is_some()), (FailureKind::World, true));
        assert_eq!(unwritten.message, "failed to write status.json: No space left on device (os error 28)");
    }
}
