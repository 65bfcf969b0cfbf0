#![doc = include_str!("../README.md")]

mod artifact;
mod delivery;
pub mod export;
pub mod film;
mod frame_rate;
mod inputs;
mod params;
mod prompts;
mod quantize;
mod run;
mod semantics;
mod surfaces;
#[cfg(test)]
mod tests;

pub use artifact::{RenderedView, Renders, SemanticMaps, SurfaceMaps};
pub use params::{Maps, RenderingParams};
pub use prompts::{Selection, Show};
pub use run::Rendering;
