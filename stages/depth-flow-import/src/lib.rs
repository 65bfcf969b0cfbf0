//! Depth, optical flow, normals and velocity for the views of a capture, aligned with it and checked against it.

mod artifact;

pub use artifact::{FlowPrior, PriorView, Priors, ViewMaps};
