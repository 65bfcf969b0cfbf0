//! Helpers that the tests of several crates share: skipping a test whose requirements this machine lacks, and damaging
//! files. No product code may depend on this crate, and its sources are not part of the code fingerprint.

pub mod fakes;
pub mod mangle;
pub mod server;

use std::io::Write;
use std::path::PathBuf;

/// Reports that the test on this thread is skipped, and why: one line `SKIPPED TEST: REASON` on standard error.
///
/// The test runner knows no third outcome, so the test itself must return and pass.
pub fn skip(reason: &str) {
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    // Not `eprintln!`, which the test runner captures. A failed write is harmless: standard error is closed.
    let _ = writeln!(std::io::stderr(), "SKIPPED {test}: {reason}");
}

/// The path of a file or folder below the folder of real data that `PIPELINE_DATA` names. If it is missing, reports the
/// test as skipped and returns `None`.
pub fn data(name: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("PIPELINE_DATA") else {
        skip("PIPELINE_DATA is not set");
        return None;
    };
    let path = PathBuf::from(root).join(name);
    if !path.exists() {
        skip(&format!("PIPELINE_DATA has no {name}"));
        return None;
    }
    Some(path)
}
