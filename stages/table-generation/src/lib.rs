//! Stage `table-generation`: what was measured, beside what was published, in tables and curves.
//!
//! [`collect`] joins the inputs of a job to runs; [`Report::new`] groups the runs by protocol and aggregates them;
//! the rest is typesetting of that one structure.

mod ablation;
mod artifact;
mod claims;
mod collect;
mod column;
mod costs;
mod csv_file;
mod curves;
mod document;
mod format;
mod html;
mod latex;
mod markdown;
mod params;
mod report;
mod run;
mod statistics;
mod svg;
#[cfg(test)]
mod tests;
mod typeset;

pub use artifact::ReportFolder;
pub use claims::{Claim, ClaimColumn, ClaimTable, Verdict, built_in_claims};
pub use collect::{CurvePoint, Run, RunFailure};
pub use column::Column;
pub use params::TableGenerationParams;
pub use report::{Cell, Group, Report, Row};
pub use run::TableGeneration;
