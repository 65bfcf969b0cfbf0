//! The scheduler's side of a job: starts the child process, forwards its progress, and determines how it ended.

use std::ffi::OsString;
use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::Context;
use fs_err as fs;
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process, kill_process_group, waitid};

use super::{JobSpec, JobStatus, Line, failure, log};
use crate::{Failure, FailureKind, Progress};

/// The environment variables that a job inherits: enough to find programs, drivers and temporary space, but none that
/// could change a result without changing its key.
const ENVIRONMENT: [&str; 16] = [
    "PATH",
    "HOME",
    "USER",
    "TMPDIR",
    "LANG",
    "LC_ALL",
    "TZ",
    "LD_LIBRARY_PATH",
    "DYLD_LIBRARY_PATH",
    "RUST_BACKTRACE",
    "XDG_RUNTIME_DIR",
    "XDG_DATA_DIRS",
    "CUDA_VISIBLE_DEVICES",
    "VK_ICD_FILENAMES",
    "VK_DRIVER_FILES",
    "WGPU_ADAPTER_NAME",
];

/// How a child ended.
#[derive(Debug)]
pub struct Ended {
    /// The status that the child left, or the failure derived from its death.
    pub status: JobStatus,
    /// The peak resident memory in bytes.
    pub peak_rss_bytes: Option<u64>,
    /// The last lines of the child's logs.
    pub log_tail: Vec<String>,
}

/// The urgency of a request to stop a child, in increasing order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stop {
    /// Save the progress, then stop.
    Save,
    /// Terminate the child and its descendants.
    Terminate,
    /// Kill the child and its descendants.
    Kill,
}

/// A handle with which other threads stop a child.
#[derive(Clone, Debug, Default)]
pub struct ProcessHandle {
    process: Arc<Mutex<Process>>,
    timed_out: Arc<AtomicBool>,
}

#[derive(Debug, Default)]
struct Process {
    pid: Option<Pid>,
    /// Stored, because the request may precede the process.
    stop: Option<Stop>,
}

impl Process {
    fn send(&self) {
        let (Some(pid), Some(stop)) = (self.pid, self.stop) else { return };
        // Fails only if the process has already ended, which is the goal.
        let _ = match stop {
            // Not INT: shells make background processes ignore it, so a job that has not yet installed its handler
            // would never stop.
            Stop::Save => kill_process(pid, Signal::USR1),
            Stop::Terminate => kill_process_group(pid, Signal::TERM),
            Stop::Kill => kill_process_group(pid, Signal::KILL),
        };
    }
}

impl ProcessHandle {
    /// Requests the child to stop, now or as soon as it has started.
    pub fn stop(&self, stop: Stop) {
        // The lock is held while sending, so that the process cannot be reaped and its id reused.
        let mut process = self.lock();
        process.stop = process.stop.max(Some(stop));
        process.send();
    }

    /// Marks the child as past its time limit.
    pub fn mark_timed_out(&self) {
        self.timed_out.store(true, Ordering::SeqCst);
    }

    /// Whether a stop was requested.
    pub fn stop_requested(&self) -> bool {
        self.lock().stop.is_some()
    }

    /// The id of the child's process while it runs.
    pub fn pid(&self) -> Option<u32> {
        self.lock().pid.and_then(|pid| u32::try_from(pid.as_raw_nonzero().get()).ok())
    }

    fn has_started(&self, pid: Pid) {
        let mut process = self.lock();
        process.pid = Some(pid);
        process.send();
    }

    fn has_ended(&self) {
        self.lock().pid = None;
    }

    fn lock(&self) -> MutexGuard<'_, Process> {
        self.process.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Runs one job in a child process and waits until it ends.
///
/// `command` is the program and its first arguments; the path of the job's specification is appended.
pub fn supervise(
    command: &[OsString],
    spec: &JobSpec,
    handle: &ProcessHandle,
    on_progress: &(dyn Fn(Progress) + Sync),
) -> anyhow::Result<Ended> {
    let spec_file = spec.dir.join("job.json");
    fs::write(&spec_file, serde_json::to_vec_pretty(spec)?).context("cannot write the job")?;
    let memory_kills = failure::kernel_memory_kills();
    let mut child = start(command, spec, &spec_file)?;
    let pid = Pid::from_child(&child);
    handle.has_started(pid);
    let stdout = child.stdout.take().context("the child has no output")?;
    let (exit, peak_rss_bytes) = std::thread::scope(|scope| {
        let reader = scope.spawn(|| forward_output(stdout, &spec.dir.join("stdout"), on_progress));
        let ended = reap(pid, handle);
        // Lost lines of a stage's own output do not fail the job.
        let _ = reader.join();
        ended
    })?;
    let log_tail = log::tail(&spec.dir);
    let death = failure::Death {
        signal: exit.signal(),
        code: exit.code(),
        timed_out: handle.timed_out.load(Ordering::SeqCst),
        stop_requested: handle.stop_requested(),
        kernel_killed_for_memory: failure::kernel_memory_kills() > memory_kills,
        log_tail: &log_tail,
    };
    let status = read_status(&spec.dir).unwrap_or_else(|| JobStatus::Failed(failure::of_death(&death)));
    Ok(Ended { status: apply_time_limit(status, death.timed_out), peak_rss_bytes, log_tail })
}

fn start(command: &[OsString], spec: &JobSpec, spec_file: &Path) -> anyhow::Result<std::process::Child> {
    let (program, arguments) = command.split_first().context("no command to run jobs with")?;
    let kept = ENVIRONMENT.iter().filter_map(|name| Some((name, std::env::var_os(name)?)));
    Command::new(program)
        .args(arguments)
        .arg(spec_file)
        .env_clear()
        .envs(kept)
        .env("RAYON_NUM_THREADS", spec.threads.to_string())
        .process_group(0)
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(fs::File::create(spec.dir.join("stderr"))?.into_parts().0)
        .spawn()
        .with_context(|| format!("cannot start {}", program.display()))
}

/// Waits for the child, kills its descendants, and reaps it. Returns the exit status and the peak memory in bytes.
fn reap(pid: Pid, handle: &ProcessHandle) -> io::Result<(ExitStatus, Option<u64>)> {
    // First wait without reaping, so that the id is not reused while the handle can still signal it.
    while let Err(error) = waitid(WaitId::Pid(pid), WaitIdOptions::EXITED | WaitIdOptions::NOWAIT) {
        if error != rustix::io::Errno::INTR {
            return Err(error.into());
        }
    }
    handle.has_ended();
    // Fails if the group is empty, which is the usual case.
    let _ = kill_process_group(pid, Signal::KILL);
    let mut status = 0;
    // SAFETY: an all-zero rusage is a valid value of this plain C struct, and both pointers outlive the call.
    let (reaped, usage) = unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        (libc::wait4(pid.as_raw_nonzero().get(), &mut status, 0, &mut usage), usage)
    };
    if reaped < 0 {
        return Err(io::Error::last_os_error());
    }
    // Linux reports KiB, macOS bytes.
    let unit = if cfg!(target_os = "macos") { 1 } else { 1024 };
    Ok((ExitStatus::from_raw(status), u64::try_from(usage.ru_maxrss).ok().map(|size| size * unit)))
}

/// Forwards progress. Any other line that the stage prints goes to a file.
fn forward_output(stdout: impl io::Read, file: &Path, on_progress: &(dyn Fn(Progress) + Sync)) -> io::Result<()> {
    let mut others = None;
    for line in BufReader::new(stdout).split(b'\n') {
        let line = line?;
        match serde_json::from_slice(&line) {
            Ok(Line::Progress(progress)) => on_progress(progress),
            Err(_) => {
                if others.is_none() {
                    others = Some(fs::File::create(file)?);
                }
                if let Some(others) = &mut others {
                    others.write_all(&line)?;
                    others.write_all(b"\n")?;
                }
            }
        }
    }
    Ok(())
}

fn read_status(dir: &Path) -> Option<JobStatus> {
    serde_json::from_slice(&fs::read(dir.join("status.json")).ok()?).ok()
}

/// A job that was interrupted because of its time limit has the failure of a timeout.
fn apply_time_limit(status: JobStatus, timed_out: bool) -> JobStatus {
    match status {
        JobStatus::Failed(failure) if timed_out && failure.kind == FailureKind::Interrupted => {
            let message = "exceeded its time limit; its progress is saved";
            JobStatus::Failed(Failure::new(FailureKind::Timeout, message).hint("run again to continue"))
        }
        other => other,
    }
}
