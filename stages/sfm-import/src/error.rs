//! The error type of this crate.

use engine::{Failure, FailureKind};

/// A result whose error has a kind, a message, a hint and a file.
pub(crate) type Result<T> = std::result::Result<T, Failure>;

/// An error about data that another crate found to be wrong; the caller adds the file.
pub(crate) fn invalid(error: scene::Error) -> Failure {
    Failure { hint: error.hint, ..bad(error.message) }
}

/// A failure that is about a part of its file, e.g. a view, whose name precedes the message.
pub(crate) fn about(name: &str, failure: Failure) -> Failure {
    Failure { message: format!("{name}: {}", failure.message), ..failure }
}

/// An error about bad input.
pub(crate) fn bad(message: impl Into<String>) -> Failure {
    Failure::new(FailureKind::BadInput, message)
}
