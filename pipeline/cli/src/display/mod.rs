//! What the user sees of a run. Every display shows the same events.

mod bars;
mod json;
pub mod lines;
pub mod profile;
pub mod summary;

use std::io::IsTerminal;

use engine::event::Event;

use crate::error::CliError;

/// Shows events as they happen.
pub trait Display {
    /// An error if nobody will see any event any more; for standard error, where messages may get lost, there is none.
    fn show(&mut self, event: &Event) -> Result<(), CliError>;
}

/// JSON if asked for; bars on a terminal; lines otherwise.
pub fn choose(json: bool) -> Box<dyn Display> {
    if json {
        Box::new(json::JsonLines)
    } else if std::io::stderr().is_terminal() {
        Box::new(bars::Bars::new())
    } else {
        Box::<lines::Lines>::default()
    }
}
