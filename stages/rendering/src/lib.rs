//! Rendering: a trained model becomes images of a capture's views, with measured frame rates.

pub mod artifact;
pub mod export;
pub mod film;
pub mod frame_rate;
pub mod params;
pub mod run;
pub mod semantics;
pub mod surfaces;
#[cfg(test)]
mod tests;

pub use artifact::{RenderedView, Renders, SemanticMaps, SurfaceMaps};
pub use frame_rate::FrameRate;
pub use params::{Maps, RenderingParams};
pub use run::Rendering;
