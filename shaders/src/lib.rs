//! The differentiable kernels: a tape of coarse operations ([`tape`]) and one folder per kernel with its equations, its
//! readable reference, its fast body, its tests and, where it has them, its kernels for a GPU ([`gpu`]).

pub mod adam;
pub(crate) mod algebra;
pub mod attention;
pub mod binning;
pub mod blending;
pub mod check;
pub mod convolution;
pub mod gpu;
pub mod group_norm;
pub mod hexplane;
pub mod histogram;
pub mod layer_norm;
pub mod linear;
pub mod losses;
pub mod magnitude;
pub mod neighbor_blend;
pub mod neural_gaussians;
pub mod point_lookup;
pub mod pointwise;
pub mod pooling;
pub mod positional_encoding;
pub mod projection;
pub mod quaternion;
pub mod rows;
pub mod sample;
pub mod screen;
pub mod slicing4d;
mod sort;
pub mod splat;
pub mod ssim;
mod sums;
pub mod tape;
pub mod temporal_harmonics;
