//! Identities of processes, by which other processes on the same machine can check whether they are alive.

use rustix::io::Errno;
use rustix::process::{Pid, test_kill_process};
use serde::{Deserialize, Serialize};

/// A process of some machine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProcessId {
    /// The machine's name.
    pub host: String,
    /// The boot and the namespace in which `pid` is unique; empty if they are unknown.
    machine: String,
    /// The process id.
    pub pid: u32,
    /// The start of the process in ticks since boot, because ids are reused; 0 if it is unknown.
    started: u64,
}

impl ProcessId {
    /// This process.
    pub fn own() -> Self {
        Self::local(std::process::id())
    }

    /// A living process of this machine.
    pub fn local(pid: u32) -> Self {
        let started = if let Life::Since(started) = Life::of(pid) { started } else { 0 };
        Self { host: host_name(), machine: machine(), pid, started }
    }

    /// Whether the process has certainly ended. Always false for processes of other machines.
    pub fn has_ended(&self) -> bool {
        let is_here = self.host == host_name() && !self.machine.is_empty() && self.machine == machine();
        is_here
            && match Life::of(self.pid) {
                Life::Since(started) => started != self.started,
                life => life == Life::Ended,
            }
    }

    /// A short name, unique among the processes of all machines for all practical purposes.
    pub(crate) fn tag(&self) -> String {
        let machine = crate::Digest::of(format!("{} {}", self.host, self.machine).as_bytes());
        format!("{}-{}-{}", machine.short(), self.pid, self.started)
    }

    /// Whether a process with this tag has certainly ended.
    pub(crate) fn tag_has_ended(tag: &str) -> bool {
        let parts: Vec<&str> = tag.split('-').collect();
        let [machine_of_tag, pid, _] = parts[..] else { return false };
        let Ok(pid) = pid.parse::<u32>() else { return false };
        let now = Self::local(pid).tag();
        let is_here = !machine().is_empty() && now.starts_with(&format!("{machine_of_tag}-"));
        is_here && now != tag && Life::of(pid) != Life::Hidden
    }
}

/// The machine's name.
pub fn host_name() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

/// The boot and the namespace of process ids. Containers of one machine may share its name, but not the namespace.
fn machine() -> String {
    let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    let namespace = std::fs::read_link("/proc/self/ns/pid").unwrap_or_default();
    if boot.is_empty() { String::new() } else { format!("{} {}", boot.trim(), namespace.display()) }
}

/// The state of a process of this machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Life {
    /// It lives since this number of ticks after the boot.
    Since(u64),
    /// It exists, but `/proc` hides it: it is another user's, and the mount has `hidepid`.
    Hidden,
    /// There is none, or only its exit status is left.
    Ended,
}

impl Life {
    fn of(pid: u32) -> Self {
        match std::fs::read_to_string(format!("/proc/{pid}/stat")) {
            Ok(stat) => Self::from_stat(&stat).unwrap_or(Self::Ended),
            Err(_) if exists(pid) => Self::Hidden,
            Err(_) => Self::Ended,
        }
    }

    /// From the text of `/proc/PID/stat`.
    fn from_stat(stat: &str) -> Option<Self> {
        // The name in parentheses may contain anything; the state follows it, and a zombie has ended.
        let mut fields = stat.rsplit_once(')')?.1.split_whitespace();
        let state = fields.next()?;
        if state == "Z" { None } else { Some(Self::Since(fields.nth(18)?.parse().ok()?)) }
    }
}

/// Whether a process exists. It may be another user's, which this process may not signal.
fn exists(pid: u32) -> bool {
    let pid = i32::try_from(pid).ok().and_then(Pid::from_raw);
    pid.is_some_and(|pid| test_kill_process(pid) != Err(Errno::SRCH))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_that_proc_does_not_show_has_ended_only_if_it_cannot_be_signalled() {
        let mut child = std::process::Command::new("true").spawn().unwrap();
        assert!(
            exists(1) && exists(child.id()),
            "the first process is root's, and an exit status is left of the other"
        );
        child.wait().unwrap();
        assert!(!exists(child.id()));
    }

    #[test]
    fn only_a_process_of_this_machine_is_known_to_have_ended() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let process = ProcessId::local(child.id());
        let tag = process.tag();
        assert!(!process.has_ended() && !ProcessId::tag_has_ended(&tag));
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(process.has_ended(), cfg!(target_os = "linux"));
        assert_eq!(ProcessId::tag_has_ended(&tag), cfg!(target_os = "linux"));
        let elsewhere = ProcessId { host: "another".into(), ..process };
        assert!(!elsewhere.has_ended() && !ProcessId::tag_has_ended(&elsewhere.tag()));
        assert!(!ProcessId::tag_has_ended("anything"));
    }
}
