//! COLMAP sparse models: cameras, registered images and points, binary or text.
//!
//! `rigs.bin` and `frames.bin` (COLMAP ≥ 3.12) are not needed: `images.*` holds every pose. Pixel centres lie at
//! (i + 0.5, j + 0.5), poses map world to camera with OpenCV axes: both as everywhere in this project.

mod binary;
mod capture;
pub mod layout;
pub mod model;
mod text;
#[cfg(test)]
pub mod write;

pub use capture::read;
pub use model::Model;
