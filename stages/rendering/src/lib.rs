//! Rendering: a trained model becomes images of a capture's views, with measured frame rates.

pub mod artifact;

pub use artifact::{RenderedView, Renders};
