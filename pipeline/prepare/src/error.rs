//! Errors of this crate.

use std::io;
use std::path::Path;

use engine::{Failure, FailureKind};

pub(crate) type Result<T> = std::result::Result<T, Failure>;

/// The input is invalid.
pub(crate) fn bad(message: impl Into<String>) -> Failure {
    Failure::new(FailureKind::BadInput, message)
}

/// The machine failed.
pub(crate) fn world(message: impl Into<String>) -> Failure {
    Failure::new(FailureKind::World, message)
}

/// The machine failed at `path`.
pub(crate) fn io(error: &io::Error, path: &Path) -> Failure {
    world(error.to_string()).at(path)
}
