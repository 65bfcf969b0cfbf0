//! Files: their hashes, durable writes, and moves between file systems.

use std::io::ErrorKind;
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

/// Makes all files of the file system of `path` durable, e.g. before a rename, which could otherwise survive a power cut that
/// their contents do not. One call, because a scene may have a hundred thousand files.
pub(crate) fn sync_file_system(path: &Path) -> Result<(), Failure> {
    #[cfg(target_os = "linux")]
    rustix::fs::syncfs(fs_err::File::open(path).map_err(io)?).map_err(|error| io(error.into()).at(path))?;
    #[cfg(not(target_os = "linux"))]
    rustix::fs::sync();
    Ok(())
}

/// Moves a file to `to`, where it appears whole and durable; `scratch` is a free name next to it, for a copy from another
/// file system.
pub(crate) fn move_file(from: &Path, to: &Path, scratch: &Path) -> Result<(), Failure> {
    fs_err::File::open(from).and_then(|file| file.sync_all()).map_err(io)?;
    match std::fs::rename(from, to) {
        Err(error) if error.kind() == ErrorKind::CrossesDevices => {
            fs_err::copy(from, scratch).map_err(io)?;
            fs_err::File::open(scratch).and_then(|file| file.sync_all()).map_err(io)?;
            fs_err::rename(scratch, to).map_err(io)?;
            fs_err::remove_file(from).map_err(io)
        }
        renamed => renamed.map_err(|error| io(error).at(to)),
    }
}
