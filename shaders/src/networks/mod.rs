//! Layers of neural networks, encodings and fields.

pub mod attention;
pub mod convolution;
pub mod group_norm;
pub mod hexplane;
pub mod layer_norm;
pub mod linear;
pub mod pooling;
pub mod positional_encoding;
pub mod temporal_harmonics;
