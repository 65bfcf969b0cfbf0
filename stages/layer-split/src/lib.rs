//! The split of every view into what moves and what does not.

mod artifact;
pub mod mask;
pub mod params;
pub mod residual;
mod run;
#[cfg(test)]
mod tests;

pub use artifact::{LayerView, Layers};
pub use mask::Mask;
pub use params::Params;
pub use run::{CaptureArtifact, LayerSplit};
