//! Depth, optical flow, normals and velocity for the views of a capture, aligned with it and checked against it.
//!
//! [`formats`] decodes what estimators write, [`folder`] finds the files of a view, [`alignment`] fits scale and shift;
//! other stages that read files per view use them too.

pub mod alignment;
mod artifact;
pub mod depth;
mod facts;
pub mod flow;
pub mod folder;
pub mod formats;
mod from_capture;
mod from_files;
mod from_points;
mod normals;
pub mod params;
pub mod per_view;
pub mod raster;
mod run;
#[cfg(test)]
mod tests;
mod videos;

pub use artifact::{FlowPrior, FlowRecord, PriorView, Priors, ViewMaps};
pub use params::Params;
pub use run::{CaptureArtifact, DepthFlowImport};
pub use videos::Videos;
