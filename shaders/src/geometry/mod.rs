//! Cameras, rotations, neighbours and points in images.

pub(crate) mod algebra;
pub mod camera;
pub mod neighbor_blend;
pub mod point_lookup;
pub mod quaternion;
