//! Metrics that need more than pairs of images. Each module adds its values to the images for which it has inputs.

pub(crate) mod language;
pub(crate) mod masked;
pub(crate) mod perceptual;
pub(crate) mod surfaces;
#[cfg(test)]
mod tests;
pub(crate) mod trivial;
pub(crate) mod video;
