//! Advisory locks on files. They save work; nothing's correctness depends on one, and none outlives its process.

use std::fs::{File, TryLockError};
use std::io;
use std::path::Path;
use std::time::Duration;

/// How often a waiting process looks again: unnoticeable beside a job, cheap beside a poll.
const RETRY: Duration = Duration::from_millis(50);

/// Opens the lock file at `path`, making it if needed.
pub fn open(path: &Path) -> io::Result<File> {
    File::options().create(true).append(true).open(path)
}

/// Locks `file` for this process alone; `false` if somebody else holds it.
pub fn try_exclusive(file: &File) -> io::Result<bool> {
    match file.try_lock() {
        Ok(()) => Ok(true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Locks `file`, waiting until it is free or `give_up` says so; whether it is locked now.
pub fn wait_exclusive(file: &File, give_up: impl Fn() -> bool) -> io::Result<bool> {
    while !try_exclusive(file)? {
        if give_up() {
            return Ok(false);
        }
        std::thread::sleep(RETRY);
    }
    Ok(true)
}
