//! The input of all sections.

use super::traces::Traces;
use crate::params::TableGenerationParams;
use crate::report::Report;

/// Report, parameters and link targets.
pub(crate) struct Content<'a> {
    pub report: &'a Report,
    pub params: &'a TableGenerationParams,
    pub traces: Traces,
}
