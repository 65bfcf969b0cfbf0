//! Runs an external program: its output goes to a log, and it ends with this process.

use std::fs::File;
use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use engine::{Failure, FailureKind};

use crate::error::{Result, io, world};

/// Time between two checks whether the program has ended.
const POLL: Duration = Duration::from_millis(20);
/// Time between two reports of progress.
const REPORT: Duration = Duration::from_millis(500);
/// Lines of the log that an error repeats.
const TAIL: usize = 5;
/// The code with which a shell ends whose command was killed, e.g. for lack of memory: 128 plus the number of KILL.
const KILLED_IN_SHELL: i32 = 128 + 9;

/// Runs `command` to its end with all output in the file `log`; `progress` gets the log at intervals.
pub(crate) fn run(mut command: Command, log: &Path, progress: &mut dyn FnMut(&str)) -> Result<()> {
    let name = command.get_program().to_string_lossy().into_owned();
    let file = File::create(log).map_err(|error| io(&error, log))?;
    let errors = file.try_clone().map_err(|error| io(&error, log))?;
    command.stdin(Stdio::null()).stdout(file).stderr(errors);
    end_with_this_process(&mut command);
    let mut child = command.spawn().map_err(|error| world(format!("{name} cannot be started: {error}")))?;
    let mut reported = Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().map_err(|error| io(&error, log))? {
            break status;
        }
        if reported.elapsed() >= REPORT {
            reported = Instant::now();
            progress(&text(log));
        }
        std::thread::sleep(POLL);
    };
    if status.success() { Ok(()) } else { Err(failure(&name, status, log)) }
}

/// The text of a log so far.
pub(crate) fn text(log: &Path) -> String {
    std::fs::read(log).map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).unwrap_or_default()
}

/// How the program failed, with the end of its log.
fn failure(name: &str, status: ExitStatus, log: &Path) -> Failure {
    let text = text(log);
    let lines: Vec<&str> = text.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let tail = lines[lines.len().saturating_sub(TAIL)..].join("\n  ");
    let end = if tail.is_empty() { String::new() } else { format!(":\n  {tail}") };
    Failure::new(kind_of_end(status, &tail), format!("{name} failed ({status}){end}\nlog")).at(log)
}

/// The kind of failure of a program that ended with this status and with this text: of the machine if a signal killed it,
/// e.g. for lack of memory, or if the disk was full; otherwise of its input.
pub(crate) fn kind_of_end(status: ExitStatus, text: &str) -> FailureKind {
    let is_killed = status.signal().is_some() || status.code() == Some(KILLED_IN_SHELL);
    if is_killed || text.contains("No space left") { FailureKind::World } else { FailureKind::BadInput }
}

/// Ends the program when this process is killed.
#[cfg(target_os = "linux")]
fn end_with_this_process(command: &mut Command) {
    use std::os::unix::process::CommandExt as _;
    let ask = || Ok(rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::TERM))?);
    // SAFETY: the closure makes one system call and allocates nothing.
    unsafe { command.pre_exec(ask) };
}

/// On other systems, the program survives if only this process is killed; the next run discards its result.
#[cfg(not(target_os = "linux"))]
fn end_with_this_process(_command: &mut Command) {}
