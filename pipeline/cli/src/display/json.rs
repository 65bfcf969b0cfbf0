//! Events as JSON lines on standard output.

use engine::event::{Event, json_line};

use super::Display;
use crate::output::print_line;

pub struct JsonLines;

impl Display for JsonLines {
    fn show(&mut self, event: &Event) {
        // Whoever reads these can do nothing about a line that could not be written, and the run goes on.
        if let Err(error) = json_line(event).map_err(Into::into).and_then(|line| print_line(&line)) {
            eprintln!("warning: cannot print an event ({error})");
        }
    }
}
