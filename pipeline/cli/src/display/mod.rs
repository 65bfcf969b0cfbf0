//! Displays of a running run: progress bars, log lines or JSON. All of them show the same events.

mod bars;
mod eta;
mod json;
pub(crate) mod lines;
pub(crate) mod profile;
pub(crate) mod summary;

use std::io::IsTerminal;

use engine::event::Event;

use crate::error::CliError;

pub(crate) use eta::Eta;

/// Shows events as they happen.
pub(crate) trait Display {
    /// Shows one event. Errors if standard output is closed; failed writes to standard error are ignored.
    fn show(&mut self, event: &Event) -> Result<(), CliError>;
}

/// Chooses JSON if requested, bars if standard error is a terminal, and lines otherwise.
pub(crate) fn choose(json: bool, eta: Eta) -> Box<dyn Display> {
    if json {
        Box::new(json::JsonLines)
    } else if std::io::stderr().is_terminal() {
        Box::new(bars::Bars::new(eta))
    } else {
        Box::new(lines::Lines::new(eta))
    }
}
