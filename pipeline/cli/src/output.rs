//! Writes to standard output and standard error, and formats numbers.

use std::io::{self, Write};

pub(crate) use engine::count;
use serde::Serialize;

use crate::error::CliError;

/// Names that one line lists; the others are counted.
const MAX_NAMES: usize = 3;

/// Writes text to standard output.
pub(crate) fn print(text: &str) -> Result<(), CliError> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()).map_err(CliError::Output)
}

/// Writes a line to standard output.
pub(crate) fn print_line(line: &str) -> Result<(), CliError> {
    print(&format!("{line}\n"))
}

/// Writes indented JSON to standard output.
pub(crate) fn print_json(value: &impl Serialize) -> Result<(), CliError> {
    print_line(&serde_json::to_string_pretty(value)?)
}

/// Writes a message to standard error. A failed write is ignored: losing a message must not fail a run.
pub(crate) fn note(line: &str) {
    // One write per line, so that lines of several programs do not mix.
    let _ = io::stderr().lock().write_all(format!("{line}\n").as_bytes());
}

/// Formats a duration: `0.4 s`, `12 s`, `3 min 20 s`, `2 h 5 min`, `3 d 4 h`.
pub(crate) fn duration(secs: f64) -> String {
    let whole = secs.round() as u64;
    match whole {
        0..=9 => format!("{secs:.1} s"),
        10..=59 => format!("{whole} s"),
        60..=3599 => format!("{} min {} s", whole / 60, whole % 60),
        3600..=172_799 => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
        _ => format!("{} d {} h", whole / 86_400, whole % 86_400 / 3600),
    }
}

/// Formats a size: `512 B`, `3.20 MiB`.
pub(crate) fn bytes(size_bytes: u64) -> String {
    indicatif::HumanBytes(size_bytes).to_string()
}

/// An argument as one word of a POSIX shell.
pub(crate) fn quoted(argument: &str) -> String {
    let is_plain = |symbol: char| symbol.is_alphanumeric() || "-_./:=,+@%".contains(symbol);
    match !argument.is_empty() && argument.chars().all(is_plain) {
        true => argument.into(),
        false => format!("'{}'", argument.replace('\'', r"'\''")),
    }
}

/// Formats names: `a, b, c and 4 more`.
pub(crate) fn names<'a>(names: impl ExactSizeIterator<Item = &'a str>) -> String {
    let all = names.len();
    let shown: Vec<&str> = names.take(MAX_NAMES).collect();
    let more = if all > MAX_NAMES { format!(" and {} more", all - MAX_NAMES) } else { String::new() };
    format!("{}{more}", shown.join(", "))
}
