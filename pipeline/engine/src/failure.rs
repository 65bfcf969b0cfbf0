//! Failures as typed data: every job that does not finish says which kind of thing went wrong.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};

/// Why a job did not finish. Tables and exit codes are made from these, never from guesses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FailureKind {
    /// The data that the job reads is not on this machine.
    MissingData,
    /// The data is there and wrong.
    BadInput,
    /// A value that must be finite was not; the message names tensor and iteration.
    Diverged,
    /// The process ran out of memory.
    OutOfMemory,
    /// The job ran past its time limit.
    Timeout,
    /// The job was asked to stop; it saved a checkpoint if it had anything to save.
    Interrupted,
    /// The accelerator went away.
    DeviceLost,
    /// The machine failed the job: disk full, file not readable.
    World,
    /// A panic or a signal: a bug of ours.
    Crashed,
}

/// A failure with its kind, one message, and a hint when one is known.
#[derive(Clone, Debug, thiserror::Error, Serialize, Deserialize)]
#[error("{message}{}{}", .hint.as_ref().map(|hint| format!("; {hint}")).unwrap_or_default(), .path.as_ref().map(|path| format!(": {}", path.display())).unwrap_or_default())]
pub struct Failure {
    /// The kind of thing that went wrong.
    pub kind: FailureKind,
    /// What went wrong, lower case, without a full stop.
    pub message: String,
    /// What to do about it.
    pub hint: Option<String>,
    /// The file concerned; printed last.
    pub path: Option<PathBuf>,
}

impl Failure {
    /// A failure of `kind` with a message.
    pub fn new(kind: FailureKind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into(), hint: None, path: None }
    }

    /// The same failure with advice.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// The same failure about a file.
    pub fn at(mut self, path: impl Into<PathBuf>) -> Self {
        self.path = Some(path.into());
        self
    }
}
