//! Advisory locks between the processes of one machine. They save work; correctness never depends on them, and none
//! outlives its process. A file system without locks counts as one that no other process uses.

use std::fs::{File, TryLockError};
use std::io::{self, ErrorKind};
use std::path::Path;

/// Opens the lock file at `path`, creating it if needed. An existing file that this process may only read can be
/// locked, too.
pub fn open(path: &Path) -> io::Result<File> {
    let file = match fs_err::OpenOptions::new().create(true).append(true).open(path) {
        Err(error) if matches!(error.kind(), ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem) => {
            fs_err::File::open(path).map_err(|_| error)?
        }
        opened => opened?,
    };
    Ok(file.into_parts().0)
}

/// Locks `file` exclusively; `false` if another process holds a lock.
pub fn try_exclusive(file: &File) -> io::Result<bool> {
    match file.try_lock() {
        Ok(()) => Ok(true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => if_supported(error).map(|()| true),
    }
}

/// Locks `file` together with others, waiting while another process holds it exclusively.
pub(crate) fn shared(file: &File) -> io::Result<()> {
    file.lock_shared().or_else(if_supported)
}

/// Ignores the error of a file system without locks.
pub fn if_supported(error: io::Error) -> io::Result<()> {
    let is_unsupported = error.kind() == ErrorKind::Unsupported || error.raw_os_error() == Some(libc::ENOLCK);
    if is_unsupported { Ok(()) } else { Err(error) }
}
