//! Slurm's commands. Their answers are hints: results and failures are read from the store.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::OsStrExt;
use std::process::{Command, Output, Stdio};
use std::time::Duration;

use anyhow::{Context, anyhow};
use engine::{Failure, FailureKind};

/// Attempts to reach the controller, which may be restarting.
const TRIES: u32 = 6;
/// The pause after the first attempt; it doubles with every attempt, to about a minute in total.
const FIRST_PAUSE: Duration = Duration::from_secs(1);

/// The state of an array or job, as Slurm names it, e.g. `PENDING`, with the reason for it.
pub type States = BTreeMap<u64, BTreeSet<(String, String)>>;

/// States in which a job may still be active.
const ALIVE: [&str; 12] = [
    "PENDING",
    "RUNNING",
    "SUSPENDED",
    "COMPLETING",
    "CONFIGURING",
    "REQUEUED",
    "REQUEUE_HOLD",
    "REQUEUE_FED",
    "RESIZING",
    "SIGNALING",
    "STAGE_OUT",
    "STOPPED",
];

/// Whether a job in one of these states may still be active.
pub fn is_alive(states: &BTreeSet<(String, String)>) -> bool {
    states.iter().any(|(state, _)| ALIVE.contains(&state.as_str()))
}

/// Submits a job or array and returns its id. `script` is the text of a shell script.
pub fn submit(options: &[String], script: &std::path::Path) -> anyhow::Result<u64> {
    let mut arguments: Vec<&OsStr> = vec!["--parsable".as_ref()];
    arguments.extend(options.iter().map(OsStr::new));
    arguments.push(script.as_os_str());
    let text = patiently("sbatch", &arguments)?;
    let id = text.trim().split(';').next().unwrap_or_default();
    id.parse().with_context(|| format!("sbatch printed {text:?} instead of a job id"))
}

/// The states of these jobs, without those that Slurm does not know; `None` if the query failed.
pub fn states(ids: &[u64]) -> Option<States> {
    let output = call("squeue", ["-h", "-t", "all", "--me", "-o", "%F|%T|%r"].map(OsStr::new)).ok()?;
    if !output.status.success() {
        return None;
    }
    let mut states = States::new();
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let mut parts = line.split('|').map(str::trim);
        let (Some(id), Some(state), Some(reason)) = (parts.next(), parts.next(), parts.next()) else { continue };
        let Some(id) = id.parse().ok().filter(|id| ids.contains(id)) else { continue };
        states.entry(id).or_default().insert((state.into(), reason.into()));
    }
    Some(states)
}

/// Whether the controller knows a job; `None` if it does not say. A list of jobs may lack one that is alive, e.g. while the
/// controller starts.
pub fn knows(id: u64) -> Option<bool> {
    let output = call("scontrol", ["show", "job", &id.to_string()].map(OsStr::new)).ok()?;
    let is_unknown = String::from_utf8_lossy(&output.stderr).contains("Invalid job id");
    if output.status.success() { Some(true) } else { is_unknown.then_some(false) }
}

/// Cancels jobs. Those that have ended cause no error.
pub fn cancel(ids: &[u64]) -> anyhow::Result<()> {
    let ids: Vec<String> = ids.iter().map(u64::to_string).collect();
    patiently("scancel", &ids.iter().map(OsStr::new).collect::<Vec<_>>()).map(drop)
}

/// Requeues the job of this process.
pub fn requeue_own() -> anyhow::Result<()> {
    let variable = |name| std::env::var(name).ok();
    // The id of an array's last element is that of the whole array.
    let element =
        variable("SLURM_ARRAY_JOB_ID").zip(variable("SLURM_ARRAY_TASK_ID")).map(|(job, task)| format!("{job}_{task}"));
    let id = element.or_else(|| variable("SLURM_JOB_ID")).context("this process is not a Slurm job")?;
    patiently("scontrol", &["requeue".as_ref(), OsStr::new(&id)]).map(drop)
}

/// The nodes that Slurm knows.
pub fn nodes() -> anyhow::Result<BTreeSet<String>> {
    let text = patiently("sinfo", &["-h", "-N", "-o", "%N"].map(OsStr::new))?;
    Ok(text.split_whitespace().map(str::to_owned).collect())
}

/// A value of Slurm's configuration, e.g. of `MaxArraySize`.
pub fn config(key: &str) -> anyhow::Result<Option<String>> {
    let text = patiently("scontrol", &["show", "config"].map(OsStr::new))?;
    let pairs = text.lines().filter_map(|line| line.split_once('='));
    Ok(pairs.into_iter().find(|(name, _)| name.trim() == key).map(|(_, value)| value.trim().to_owned()))
}

/// Runs a command and returns its output. While the controller does not answer, tries again.
fn patiently(program: &str, arguments: &[&OsStr]) -> anyhow::Result<String> {
    let mut pause = FIRST_PAUSE;
    for attempt in 1.. {
        let output = call(program, arguments.iter().copied())?;
        if output.status.success() {
            return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
        }
        let message = String::from_utf8_lossy(&output.stderr).trim().to_owned();
        if attempt == TRIES || !is_away(&message) {
            return Err(refused(program, &message));
        }
        std::thread::sleep(pause);
        pause *= 2;
    }
    unreachable!("the last attempt returns")
}

/// Whether a command failed because the controller does not answer.
fn is_away(message: &str) -> bool {
    let texts = ["Unable to contact", "timed out", "Connection refused", "not responding", "temporarily"];
    texts.iter().any(|text| message.contains(text))
}

/// The error of a command that printed this message.
fn refused(program: &str, message: &str) -> anyhow::Error {
    if !is_away(message) {
        return anyhow!("{program} failed: {message}");
    }
    let last = message.lines().last().unwrap_or_default();
    Failure::new(FailureKind::World, format!("Slurm's controller does not answer ({last})"))
        .hint("ask `scontrol ping`; this must be a machine of the cluster, with its slurm.conf")
        .into()
}

fn call<'a>(program: &str, arguments: impl IntoIterator<Item = &'a OsStr>) -> anyhow::Result<Output> {
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null());
    // A job that submits others must not pass on its own allocation.
    let of_job = |name: &OsString| name.as_bytes().starts_with(b"SLURM_") && name != "SLURM_CONF";
    std::env::vars_os().map(|(name, _)| name).filter(of_job).for_each(|name| _ = command.env_remove(name));
    command.output().with_context(|| format!("cannot start {program}; is Slurm installed on this machine?"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fakes::has_fakes;

    #[test]
    fn commands_get_any_environment_but_no_allocation() {
        let sinfo = "echo ${SLURM_JOB_ID:-none} $SLURM_CONF";
        let environment = |command: &mut Command| {
            command.env("SLURM_JOB_ID", "7").env("SLURM_CONF", "conf").env("NOT_UTF8", OsStr::from_bytes(b"\xff"));
        };
        let test = "slurm::tests::commands_get_any_environment_but_no_allocation";
        if has_fakes(test, &[("sinfo", sinfo)], environment) {
            assert_eq!(nodes().unwrap(), BTreeSet::from(["none".to_owned(), "conf".to_owned()]));
        }
    }

    #[test]
    fn a_silent_controller_is_named_with_what_to_do() {
        let line = "slurm_load_ctl_conf error: Unable to contact slurm controller (connect failure)";
        let error = refused("scontrol", &format!("scontrol: error: resolve_ctls_from_dns_srv: Unknown host\n{line}"));
        let failure = error.downcast_ref::<Failure>().expect("a failure");
        assert_eq!(failure.message, format!("Slurm's controller does not answer ({line})"));
        assert!(failure.hint.as_ref().is_some_and(|hint| hint.contains("scontrol ping")));
        assert_eq!(refused("sbatch", "invalid partition").to_string(), "sbatch failed: invalid partition");
    }
}
