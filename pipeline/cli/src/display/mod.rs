//! What the user sees of a run. Every display shows the same events.

mod bars;
mod json;
pub mod lines;
pub mod summary;

use std::io::IsTerminal;

use engine::event::Event;

/// Shows events as they happen.
pub trait Display {
    fn show(&mut self, event: &Event);
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
