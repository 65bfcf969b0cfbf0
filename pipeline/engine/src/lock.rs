//! Advisory locks on files. They save work; correctness never depends on them, and none outlives its process.

use std::fs::{File, TryLockError};
use std::io;
use std::path::Path;
use std::time::Duration;

/// Time between two attempts of a waiting process: short beside a job, and rare enough to cost nothing.
const RETRY: Duration = Duration::from_millis(50);

/// Opens the lock file at `path`, creating it if needed.
pub(crate) fn open(path: &Path) -> io::Result<File> {
    Ok(fs_err::OpenOptions::new().create(true).append(true).open(path)?.into_parts().0)
}

/// Locks `file` exclusively; `false` if another process holds a lock.
pub(crate) fn try_exclusive(file: &File) -> io::Result<bool> {
    match file.try_lock() {
        Ok(()) => Ok(true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Locks `file` exclusively, waiting until it is free or `give_up` returns true. Returns whether the lock is held.
pub(crate) fn wait_exclusive(file: &File, give_up: impl Fn() -> bool) -> io::Result<bool> {
    while !try_exclusive(file)? {
        if give_up() {
            return Ok(false);
        }
        std::thread::sleep(RETRY);
    }
    Ok(true)
}
