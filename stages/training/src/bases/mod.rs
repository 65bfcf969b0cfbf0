//! What methods are built from. Bases know the trainer's vocabulary and no method.

pub mod gaussians;
pub mod heads;
pub mod hexplane;
pub mod layers;
pub mod primitives4d;
