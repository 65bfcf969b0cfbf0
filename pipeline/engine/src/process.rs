//! Identities of processes, by which other processes on the same machine can check whether they are alive.

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
        Self { host: host_name(), machine: machine(), pid, started: start_of(pid).unwrap_or(0) }
    }

    /// Whether the process has certainly ended. Always false for processes of other machines.
    pub fn has_ended(&self) -> bool {
        let is_here = self.host == host_name() && !self.machine.is_empty() && self.machine == machine();
        is_here && start_of(self.pid) != Some(self.started)
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
        !machine().is_empty() && now.starts_with(&format!("{machine_of_tag}-")) && now != tag
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

/// The start of a living process in ticks since boot.
fn start_of(pid: u32) -> Option<u64> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name in parentheses may contain anything; the state follows it, and a zombie has ended.
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace();
    (fields.next()? != "Z").then(|| fields.nth(18)?.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;

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
