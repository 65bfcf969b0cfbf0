//! Analytic dynamic scenes: ray-cast images of bodies in closed-form motion, with exact depth, optical flow, instance
//! labels and 3D velocity. The embedded default of the pipeline and the oracle of its tests.

mod artifact;
mod params;
mod placement;
mod render;
mod run;
mod scenes;
mod shape;
mod shots;
mod texture;
mod wave;
mod world;

#[cfg(test)]
mod tests;

pub use artifact::CaptureArtifact;
pub use params::{Background, CameraPath, Params, SceneKind, Truth};
pub use run::{SceneSynthesis, synthesize};
