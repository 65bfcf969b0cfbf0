//! What tests need and not every machine has. A test that lacks it is skipped: it passes for the test runner, which knows no
//! third way, and is told by a line that begins with `SKIPPED`, which the runner does not hide.

use std::io::Write;
use std::path::PathBuf;

/// Tells that the test of this thread is skipped, and why.
pub fn skip(reason: &str) {
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    // Not a print, which the runner of tests would keep to itself. Where nobody listens there is nobody to tell.
    let _ = writeln!(std::io::stderr(), "SKIPPED {test}: {reason}");
}

/// A file or folder of the real data that `PIPELINE_DATA` names; skips the test where it is not there.
pub fn data(name: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("PIPELINE_DATA") else {
        skip("PIPELINE_DATA names no folder of real data");
        return None;
    };
    let path = PathBuf::from(root).join(name);
    if !path.exists() {
        skip(&format!("PIPELINE_DATA has no {name}"));
        return None;
    }
    Some(path)
}
