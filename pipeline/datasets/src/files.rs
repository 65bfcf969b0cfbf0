//! Files and their hashes.

use std::path::Path;

use engine::{Digest, Failure, FailureKind};

/// A failure of the machine or the network.
pub(crate) fn world(message: impl Into<String>) -> Failure {
    Failure::new(FailureKind::World, message)
}

/// A failure to access a file.
pub(crate) fn io(error: std::io::Error) -> Failure {
    world(error.to_string())
}

/// Size and SHA-256 of a file.
pub(crate) fn digest(path: &Path) -> Result<(u64, String), Failure> {
    let hash = Digest::of_file(path).map_err(io)?;
    Ok((fs_err::metadata(path).map_err(io)?.len(), hash.to_string()))
}
