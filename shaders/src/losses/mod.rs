//! Distances between images, and between distributions.

pub mod histogram;
pub mod l1;
pub mod ssim;
