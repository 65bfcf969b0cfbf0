//! Typed failures: every job that does not finish has a kind of failure.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// The kind of a failure. Tables and exit codes depend on it, never on messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FailureKind {
    /// The data that the job reads is not on this machine.
    MissingData,
    /// The data is invalid.
    BadInput,
    /// A value was not finite; the message names the tensor and the iteration.
    Diverged,
    /// The process ran out of memory.
    OutOfMemory,
    /// The job ran past its time limit.
    Timeout,
    /// The job was stopped on request, after it saved a checkpoint if it had anything to save.
    Interrupted,
    /// The GPU was lost.
    DeviceLost,
    /// The machine failed, e.g. a full disk or an unreadable file.
    World,
    /// A panic or a signal: a bug in this program.
    Crashed,
}

impl FailureKind {
    /// The kind in words, e.g. `out of memory`.
    pub fn words(self) -> &'static str {
        match self {
            Self::MissingData => "missing data",
            Self::BadInput => "invalid input",
            Self::Diverged => "diverged",
            Self::OutOfMemory => "out of memory",
            Self::Timeout => "time limit",
            Self::Interrupted => "interrupted",
            Self::DeviceLost => "device lost",
            Self::World => "machine failure",
            Self::Crashed => "crashed",
        }
    }
}

/// A failure: its kind, a message, and optionally a hint and a file.
#[derive(Clone, Debug, thiserror::Error, Serialize, Deserialize)]
#[error("{message}{}{}", .hint.as_ref().map(|hint| format!("; {hint}")).unwrap_or_default(), .path.as_ref().map(|path| format!(": {}", path.display())).unwrap_or_default())]
pub struct Failure {
    /// The kind of failure.
    pub kind: FailureKind,
    /// The problem, in lower case, without a full stop.
    pub message: String,
    /// Advice, if there is any.
    pub hint: Option<String>,
    /// The file that the failure is about; printed last.
    pub path: Option<PathBuf>,
}

impl Failure {
    /// Creates a failure of `kind` with a message.
    pub fn new(kind: FailureKind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into(), hint: None, path: None }
    }

    /// Adds advice.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Adds the file that the failure is about.
    pub fn at(mut self, path: impl Into<PathBuf>) -> Self {
        self.path = Some(path.into());
        self
    }
}
