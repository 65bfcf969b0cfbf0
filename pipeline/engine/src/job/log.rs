//! The log files of a job.

use std::fs;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use anyhow::Context;
use tracing::Dispatch;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::fmt;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

/// Crates whose warnings concern graphics drivers. They are not repeated to the user, because `doctor` checks the
/// GPUs.
const OF_DRIVERS: [&str; 2] = ["wgpu", "naga"];

/// Directs this process's tracing output to the file `log` in `dir`.
pub(super) fn init(dir: &Path, filter: &str) -> anyhow::Result<()> {
    subscriber(dir, filter)?.init();
    Ok(())
}

fn subscriber(dir: &Path, filter: &str) -> anyhow::Result<Dispatch> {
    let file = fs_err::OpenOptions::new().create(true).append(true).open(dir.join("log"));
    let file = file.context("cannot open the log")?.into_parts().0;
    let filter: Targets = filter.parse().with_context(|| format!("invalid log filter: {filter}"))?;
    let lines = fmt::layer().with_ansi(false).with_writer(file);
    Ok(Dispatch::new(tracing_subscriber::registry().with(filter).with(lines)))
}

/// The warnings in the log of the job's folder `dir`, in their order. A log that cannot be read has none.
pub fn warnings(dir: &Path) -> Vec<String> {
    let bytes = fs::read(dir.join("log")).unwrap_or_default();
    String::from_utf8_lossy(&bytes).lines().filter_map(warning).map(str::to_owned).collect()
}

/// The message of a line `TIME  WARN TARGET: MESSAGE`.
fn warning(line: &str) -> Option<&str> {
    let (time, rest) = line.split_once("  WARN ")?;
    let (target, message) = rest.split_once(": ")?;
    let is_of_driver = OF_DRIVERS.iter().any(|name| target.starts_with(name));
    (!time.contains(' ') && !is_of_driver).then_some(message)
}

/// Checks the syntax of a log filter; the error is the parser's message.
pub fn check_filter(filter: &str) -> Result<(), String> {
    filter.parse::<Targets>().map(|_| ()).map_err(|error| error.to_string())
}

/// The last lines of `log` and of `stderr` in `dir`.
pub(super) fn tail(dir: &Path) -> Vec<String> {
    ["log", "stderr"].iter().flat_map(|name| last_lines(&dir.join(name)).unwrap_or_default()).collect()
}

/// The last 20 lines of a file, of which at most 8 KiB are read.
fn last_lines(path: &Path) -> io::Result<Vec<String>> {
    let mut file = fs::File::open(path)?;
    let skipped = file.metadata()?.len().saturating_sub(8 << 10);
    file.seek(SeekFrom::Start(skipped))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes)?;
    let text = String::from_utf8_lossy(&bytes);
    let lines: Vec<&str> = text.lines().collect();
    Ok(lines[lines.len().saturating_sub(20)..].iter().map(|line| (*line).to_owned()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_are_read_from_the_log() {
        let dir = tempfile::tempdir().unwrap();
        tracing::dispatcher::with_default(&subscriber(dir.path(), "info").unwrap(), || {
            tracing::info!("a step:  WARN is no warning: here");
            tracing::warn!("the first: {}", 1);
            tracing::warn!(target: "wgpu_hal::vulkan", "a driver");
            tracing::warn!("the second");
        });
        assert_eq!(warnings(dir.path()), ["the first: 1", "the second"]);
        assert!(warnings(&dir.path().join("elsewhere")).is_empty());
    }
}
