#![doc = include_str!("../README.md")]

mod artifact;
mod base;
mod cell;
mod claims;
mod collect;
mod column;
mod common_scenes;
mod comparison;
mod csv_file;
mod difference;
mod distinct;
mod document;
mod format;
mod grouping;
mod html;
mod influence;
mod influences;
mod latex;
mod library;
mod markdown;
mod pairs;
mod papers;
mod params;
mod pictures;
mod ranks;
mod report;
mod run;
mod sections;
mod statistics;
mod svg;
mod svg_file;
#[cfg(test)]
mod tests;

pub use artifact::ReportFolder;
pub use base::Base;
pub use collect::{
    Costs, CurvePoint, DEGENERATE, DegenerateRun, FrameScore, Job, LossShare, Machine, MovingShares, Run, RunFailure,
    TensorGradient,
};
pub use column::Column;
pub use difference::{Difference, RowDifference};
pub use distinct::distinct;
pub use format::{number, signed};
pub use influence::Influence;
pub use params::TableGenerationParams;
pub use run::TableGeneration;
pub use statistics::{half_width, sample_std};
