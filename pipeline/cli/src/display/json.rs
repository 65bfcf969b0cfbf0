//! Events as JSON lines on standard output.

use engine::event::{Event, json_line};

use super::Display;
use crate::error::CliError;
use crate::output::print_line;

pub(crate) struct JsonLines;

impl Display for JsonLines {
    fn show(&mut self, event: &Event) -> Result<(), CliError> {
        print_line(&json_line(event)?)
    }
}
