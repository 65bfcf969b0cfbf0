//! The differentiable kernels, in layers: a module imports only modules of its own layer or below. Every kernel is one
//! folder with its equations, its readable reference, its fast body, its tests and its kernels for a GPU.
//!
//! | layer | modules | |
//! |---|---|---|
//! | 1 | [`gpu`] | the second device: adapters, arrays, kernels in WGSL, launches |
//! | 2 | [`tape`] | scalars, tensors and the tape that differentiates coarse operations |
//! | 3 | [`pointwise`](mod@pointwise) | operations written once as an expression: f32, f64, WGSL and their gradients |
//! | 4 | [`arrays`] | rows, sums, sorting, sampling: the operations between large kernels |
//! | 5 | [`geometry`] | cameras, quaternions, neighbours, points in images |
//! | 5 | [`networks`] | layers of neural networks and fields |
//! | 5 | [`losses`] | distances between images, histograms |
//! | 5 | [`adam`] | the optimiser |
//! | 6 | [`rasteriser`] | 3D Gaussians to images: sources of splats, projection, binning, blending |
//! | 7 | [`check`] | comparisons with finite differences and with the other device |

pub mod adam;
pub mod arrays;
pub mod check;
pub mod geometry;
pub mod gpu;
pub mod losses;
pub mod networks;
pub mod pointwise;
pub mod rasteriser;
pub mod tape;
