//! Rendering: a trained model becomes images of a capture's views, with measured frame rates.

pub mod artifact;
pub mod export;
pub mod frame_rate;
pub mod params;
pub mod run;

pub use artifact::{RenderedView, Renders};
pub use params::RenderingParams;
pub use run::Rendering;
