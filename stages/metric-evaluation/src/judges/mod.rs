//! What is judged beyond pairs of images; each judge adds its figures to the images that it can say something about.

pub mod language;
pub mod masked;
pub mod perceptual;
pub mod surfaces;
#[cfg(test)]
mod tests;
pub mod video;
