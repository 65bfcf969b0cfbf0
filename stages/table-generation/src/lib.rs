//! Stage `table-generation`: what was measured, beside what was published, in tables, curves and one page.
//!
//! [`Inputs::runs`](collect::Inputs::runs) joins the inputs of a job to runs; [`Report::new`] groups the runs by
//! protocol and aggregates them; `sections` says what the report says; the rest is typesetting.

mod anytime;
mod artifact;
mod claims;
mod collect;
mod column;
mod csv_file;
mod document;
mod format;
mod grouping;
mod html;
mod latex;
mod markdown;
mod papers;
mod params;
mod pictures;
mod ranks;
mod report;
mod run;
mod sections;
mod statistics;
mod svg;
#[cfg(test)]
mod tests;

pub use artifact::ReportFolder;
pub use claims::{Claim, ClaimColumn, ClaimTable, Verdict, built_in_claims};
pub use collect::{CurvePoint, FrameScore, Job, Machine, Run, RunFailure, TensorGradient};
pub use column::Column;
pub use format::{number, signed};
pub use params::TableGenerationParams;
pub use report::{Cell, Group, Report, Row};
pub use run::TableGeneration;
