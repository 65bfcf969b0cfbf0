//! The scheduler's side: start the child, pass on its progress, and say how it ended.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use anyhow::Context;
use rustix::process::{Pid, Signal, WaitId, WaitIdOptions, kill_process, kill_process_group, waitid};

use super::{JobSpec, JobStatus, Line, failure, log};
use crate::store::naming;
use crate::{Failure, FailureKind, Progress};

/// What a job may see of the user's environment: enough to find programs, drivers and temporary space, and nothing
/// that could change a result behind the key's back.
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
    /// What it left, or what its death means.
    pub status: JobStatus,
    /// Its largest resident memory.
    pub peak_rss_bytes: Option<u64>,
    /// The last lines of its log.
    pub log_tail: Vec<String>,
}

/// How urgently a child should end; later ones outdo earlier ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stop {
    /// Save the progress and stop.
    Save,
    /// End at once, with everything it started.
    Terminate,
    /// Be ended.
    Kill,
}

/// A running child, for whoever wants to stop it.
#[derive(Clone, Debug, Default)]
pub struct ProcessHandle {
    process: Arc<Mutex<Process>>,
    timed_out: Arc<AtomicBool>,
}

#[derive(Debug, Default)]
struct Process {
    pid: Option<Pid>,
    /// Kept, since it may be asked for before the process is there.
    stop: Option<Stop>,
}

impl Process {
    fn send(&self) {
        let (Some(pid), Some(stop)) = (self.pid, self.stop) else { return };
        // Fails only if the process has ended already, which is what was wanted.
        let _ = match stop {
            // Not INT, which a shell has processes in the background ignore: a job that does not listen yet would never stop.
            Stop::Save => kill_process(pid, Signal::USR1),
            Stop::Terminate => kill_process_group(pid, Signal::TERM),
            Stop::Kill => kill_process_group(pid, Signal::KILL),
        };
    }
}

impl ProcessHandle {
    /// Asks the child to stop, now or as soon as it is there.
    pub fn stop(&self, stop: Stop) {
        // The lock is held while sending: the id cannot be reaped and given to another process meanwhile.
        let mut process = self.lock();
        process.stop = process.stop.max(Some(stop));
        process.send();
    }

    /// Notes that what follows is due to the time limit.
    pub fn mark_timed_out(&self) {
        self.timed_out.store(true, Ordering::SeqCst);
    }

    /// Whether it was asked to stop.
    pub fn told_to_stop(&self) -> bool {
        self.lock().stop.is_some()
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

/// Runs one job in a child process and waits for it.
///
/// `command` is the program and its first arguments; the path of the job's specification is appended. `lock` becomes
/// the child's standard input: the lock then lives as long as the child, even if this process dies first.
pub fn supervise(
    command: &[OsString],
    spec: &JobSpec,
    lock: &File,
    handle: &ProcessHandle,
    on_progress: &(dyn Fn(Progress) + Sync),
) -> anyhow::Result<Ended> {
    fs::create_dir_all(&spec.dir).map_err(naming(&spec.dir)).context("cannot make the job's folder")?;
    let spec_file = spec.dir.join("job.json");
    fs::write(&spec_file, serde_json::to_vec_pretty(spec)?)
        .map_err(naming(&spec_file))
        .context("cannot write the job")?;
    let memory_kills = failure::kernel_memory_kills();
    let mut child = start(command, spec, &spec_file, lock)?;
    let pid = Pid::from_child(&child);
    handle.has_started(pid);
    let stdout = child.stdout.take().context("the child has no output")?;
    let (exit, peak_rss_bytes) = std::thread::scope(|scope| {
        let reader = scope.spawn(|| pass_on(stdout, &spec.dir.join("stdout"), on_progress));
        let ended = reap(pid, handle);
        // Losing lines of a stage's own output is no reason to fail its job.
        let _ = reader.join();
        ended
    })?;
    let log_tail = log::tail(&spec.dir);
    let death = failure::Death {
        signal: exit.signal(),
        code: exit.code(),
        timed_out: handle.timed_out.load(Ordering::SeqCst),
        told_to_stop: handle.told_to_stop(),
        kernel_killed_for_memory: failure::kernel_memory_kills() > memory_kills,
        log_tail: &log_tail,
    };
    let status = read_status(&spec.dir).unwrap_or_else(|| JobStatus::Failed(failure::of_death(&death)));
    Ok(Ended { status: blame_limit(status, death.timed_out), peak_rss_bytes, log_tail })
}

fn start(command: &[OsString], spec: &JobSpec, spec_file: &Path, lock: &File) -> anyhow::Result<std::process::Child> {
    let (program, arguments) = command.split_first().context("no command to run jobs with")?;
    let kept = ENVIRONMENT.iter().filter_map(|name| Some((name, std::env::var_os(name)?)));
    Command::new(program)
        .args(arguments)
        .arg(spec_file)
        .env_clear()
        .envs(kept)
        .env("RAYON_NUM_THREADS", spec.threads.to_string())
        .process_group(0)
        .stdin(lock.try_clone()?)
        .stdout(Stdio::piped())
        .stderr(File::create(spec.dir.join("stderr"))?)
        .spawn()
        .with_context(|| format!("cannot start {}", program.display()))
}

/// Waits for the child's end, ends whatever it started, and reaps it: exit status and peak memory in bytes.
fn reap(pid: Pid, handle: &ProcessHandle) -> io::Result<(ExitStatus, Option<u64>)> {
    // First wait without reaping, so that the id stays ours until nobody can signal it any more.
    while let Err(error) = waitid(WaitId::Pid(pid), WaitIdOptions::EXITED | WaitIdOptions::NOWAIT) {
        if error != rustix::io::Errno::INTR {
            return Err(error.into());
        }
    }
    handle.has_ended();
    // Fails if the group is empty, as it usually is.
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
    // Linux counts in KiB, macOS in bytes.
    let unit = if cfg!(target_os = "macos") { 1 } else { 1024 };
    Ok((ExitStatus::from_raw(status), u64::try_from(usage.ru_maxrss).ok().map(|size| size * unit)))
}

/// Passes on progress; any other line that the stage prints goes to a file.
fn pass_on(stdout: impl io::Read, file: &Path, on_progress: &(dyn Fn(Progress) + Sync)) -> io::Result<()> {
    let mut others = None;
    for line in BufReader::new(stdout).split(b'\n') {
        let line = line?;
        match serde_json::from_slice(&line) {
            Ok(Line::Progress(progress)) => on_progress(progress),
            Err(_) => {
                if others.is_none() {
                    others = Some(File::create(file)?);
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

/// A job that stopped because its time was up did not stop on request.
fn blame_limit(status: JobStatus, timed_out: bool) -> JobStatus {
    match status {
        JobStatus::Failed(failure) if timed_out && failure.kind == FailureKind::Interrupted => {
            let message = "ran past its time limit; its progress is saved";
            JobStatus::Failed(Failure::new(FailureKind::Timeout, message).hint("run again to continue"))
        }
        other => other,
    }
}
