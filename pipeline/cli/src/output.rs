//! Standard output, and how numbers look for people.

use std::io::{self, Write};

use serde::Serialize;

use crate::error::CliError;

/// Writes text to standard output.
pub fn print(text: &str) -> Result<(), CliError> {
    let mut stdout = io::stdout().lock();
    stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()).map_err(CliError::Output)
}

/// Writes a line to standard error, if anybody can be told: a message that is lost changes nothing.
pub fn tell(line: &str) {
    // One write per line, so that lines of several programs do not mix.
    let _ = io::stderr().lock().write_all(format!("{line}\n").as_bytes());
}

/// Writes one line to standard output.
pub fn print_line(line: &str) -> Result<(), CliError> {
    print(&format!("{line}\n"))
}

/// Writes readable JSON to standard output.
pub fn print_json(value: &impl Serialize) -> Result<(), CliError> {
    print_line(&serde_json::to_string_pretty(value)?)
}

/// `0.4 s`, `12 s`, `3 min 20 s`, `2 h 5 min`.
pub fn duration(secs: f64) -> String {
    // Whole seconds are exact in f64 far beyond any run's length.
    let whole = secs.round() as u64;
    match whole {
        0..=9 => format!("{secs:.1} s"),
        10..=59 => format!("{whole} s"),
        60..=3599 => format!("{} min {} s", whole / 60, whole % 60),
        _ => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
    }
}

/// `512 B`, `3.20 MiB`.
pub fn bytes(size_bytes: u64) -> String {
    indicatif::HumanBytes(size_bytes).to_string()
}

/// `1 job`, `2 jobs`.
pub fn count(number: usize, thing: &str) -> String {
    format!("{number} {thing}{}", if number == 1 { "" } else { "s" })
}
