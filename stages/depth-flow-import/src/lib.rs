#![doc = include_str!("../README.md")]

mod artifact;
mod depth;
mod facts;
mod flow;
mod from_capture;
mod from_files;
mod from_points;
mod normals;
mod offset;
mod params;
mod run;
#[cfg(test)]
mod tests;
mod tracks;

pub use artifact::{FlowPrior, PriorView, Priors, ViewMaps};
pub use params::Params;
pub use run::DepthFlowImport;
