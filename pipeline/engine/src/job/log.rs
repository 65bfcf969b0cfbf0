//! The log files of a job.

use std::fs;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use anyhow::Context;
use tracing_subscriber::EnvFilter;

/// Directs this process's tracing output to the file `log` in `dir`.
pub(super) fn init(dir: &Path, filter: &str) -> anyhow::Result<()> {
    let file = fs_err::OpenOptions::new().create(true).append(true).open(dir.join("log"));
    let file = file.context("cannot open the log")?.into_parts().0;
    let filter = EnvFilter::try_new(filter).with_context(|| format!("invalid log filter: {filter}"))?;
    tracing_subscriber::fmt().with_env_filter(filter).with_ansi(false).with_writer(file).init();
    Ok(())
}

/// Checks the syntax of a log filter; the error is the parser's message.
pub fn check_filter(filter: &str) -> Result<(), String> {
    EnvFilter::builder().parse(filter).map(|_| ()).map_err(|error| error.to_string())
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
